"""What is kept survives whatever happens between two instructions."""

from __future__ import annotations

import json
import os
import random
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_monitor.state_file import FolderLock, StateFile, default_folder, valve_folder


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    assert StateFile(tmp_path / "a.json").load() is None
    StateFile(tmp_path / "a.json").save({"a": [1, 2.5, "ü", None]})
    assert StateFile(tmp_path / "a.json").load() == {"a": [1, 2.5, "ü", None]}


def test_the_copy_before_is_kept(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "a.json")
    file.save(1)
    file.save(2)
    assert names(tmp_path) == {"a.json", "a.json.last"}
    (tmp_path / "a.json").unlink()
    assert StateFile(tmp_path / "a.json").load() == 1


@settings(deadline=None)
@given(position=st.integers(0, 10_000), flip=st.integers(1, 255))
def test_any_damaged_byte_is_seen_and_the_last_good_copy_used(
    tmp_path_factory: pytest.TempPathFactory, position: int, flip: int
) -> None:
    folder = tmp_path_factory.mktemp("state")
    file = StateFile(folder / "a.json")
    file.save({"value": 1})
    file.save({"value": 2})
    data = bytearray((folder / "a.json").read_bytes())
    data[position % len(data)] ^= flip
    (folder / "a.json").write_bytes(data)
    again = StateFile(folder / "a.json")
    loaded = again.load()
    # White space carries nothing, so a change there may pass; a changed value never does. A format that looks
    # like a later version's is read with a warning.
    later = any("a later version" in warning for warning in again.warnings)
    assert loaded == {"value": 2 if not again.warnings or later else 1}
    if again.warnings and not later:
        assert "a.json.last is used" in again.warnings[0]


def test_a_damaged_file_does_not_push_the_good_copy_out(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "a.json")
    file.save(1)
    file.save(2)
    (tmp_path / "a.json").write_text("{", "utf-8")
    again = StateFile(tmp_path / "a.json")
    assert again.load() == 1
    again.save(3)
    (tmp_path / "a.json").unlink()
    assert StateFile(tmp_path / "a.json").load() == 1


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "Expecting value"),
        ("[]", "not a state file"),
        (json.dumps({"format": 9, "sequence": 1, "sha256": "", "content": 1}), "format 9, this version"),
        (json.dumps({"format": 0, "sequence": 1, "sha256": "", "content": 1}), "its format is 0"),
        ('{"content": ' + "[" * 20_000 + "]" * 20_000 + "}", "nested too deeply"),
        ("[" * 20_000, "nested too deeply"),
        (json.dumps({"format": 1, "sequence": 1, "sha256": "0", "content": 1}), "checksum does not fit"),
        (json.dumps({"format": 1, "sequence": "1", "sha256": "0", "content": 1}), "checksum does not fit"),
    ],
)
def test_what_is_no_state_is_said_and_not_used(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "a.json").write_text(text, "utf-8")
    file = StateFile(tmp_path / "a.json")
    assert file.load() is None
    assert reason in file.warnings[0]


def written_by_a_later_version(path: Path, content: object, **changes: object) -> bytes:
    """Write a state as a version with format 2 would; return the file's bytes."""
    file = StateFile(path)
    file.save(content)
    whole = {**json.loads(path.read_text("utf-8")), "format": 2, **changes}
    path.write_text(json.dumps(whole), "utf-8")
    return path.read_bytes()


def test_a_later_version_s_state_is_read_and_left_alone_on_a_downgrade(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    later = written_by_a_later_version(path, {"latched": True})
    for expected in ({"latched": True}, "of this version"):
        file = StateFile(path)
        assert file.load() == expected
        assert "a later version of the suite wrote it (format 2" in file.warnings[0]
        file.save("of this version")
    assert path.read_bytes() == later
    assert {"a.json", "a.json.format1"} <= names(tmp_path)


def test_what_was_kept_during_a_downgrade_is_taken_up_by_the_later_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.json"
    written_by_a_later_version(path, "before")
    older = StateFile(path)
    older.load()
    older.save("during")
    monkeypatch.setattr("spool_monitor.state_file.FORMAT", 2)
    upgraded = StateFile(path)
    assert upgraded.load() == "during"
    assert upgraded.warnings == []
    upgraded.save("after")
    assert StateFile(path).load() == "after"


def test_a_later_version_s_unknown_checksum_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    later = written_by_a_later_version(path, "x", sha256="another law")
    file = StateFile(path)
    assert file.load() is None
    file.save("mine")
    assert path.read_bytes() == later
    assert StateFile(path).load() == "mine"


def test_a_damaged_file_is_kept_aside(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("perhaps somebody can still read this", "utf-8")
    file = StateFile(path)
    assert file.load() is None
    file.save(1)
    assert (tmp_path / "a.json.damaged").read_text("utf-8") == "perhaps somebody can still read this"


def test_only_the_owner_may_read_the_state(tmp_path: Path) -> None:
    folder = tmp_path / "valve_1" / "monitor"
    folder.mkdir(parents=True, mode=0o755)
    (folder / "a.json").write_text("{}", "utf-8")
    (folder / "a.json").chmod(0o644)
    before = os.umask(0o022)
    try:
        FolderLock(folder).release()
        for _ in range(2):
            StateFile(folder / "a.json").save(1)
    finally:
        os.umask(before)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}


def test_a_folder_that_may_not_be_read_holds_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal is made up: the owner of the tests may read everything."""

    def refused(path: Path) -> list[str]:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(os, "listdir", refused)
    assert StateFile(tmp_path / "state").load() is None


def test_what_json_cannot_hold_leaves_the_state_as_it_was(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "a.json")
    file.save(1)
    with pytest.raises(ValueError, match="JSON"):
        file.save(float("nan"))
    assert StateFile(tmp_path / "a.json").load() == 1


WRITER = """
import sys
from pathlib import Path
from spool_monitor.state_file import StateFile
file = StateFile(Path(sys.argv[1]))
first = (file.load() or {"count": 0})["count"]
for count in range(first + 1, first + 1000000):
    file.save({"count": count, "ballast": "x" * (count % 7000)})
    print(count, flush=True)
"""


def test_killed_at_random_moments_it_keeps_the_last_state_that_was_reported(
    tmp_path: Path, killed: Callable[[str, list[str], int], list[str]]
) -> None:
    """What was reported as saved is there after every kill, and nothing is ever torn."""
    path = tmp_path / "a.json"
    chance = random.Random(1)
    for _ in range(12):
        told = killed(WRITER, [str(path)], chance.randrange(1, 60))
        file = StateFile(path)
        content: Any = file.load()
        assert file.warnings == []
        assert content["ballast"] == "x" * (content["count"] % 7000)
        assert content["count"] in (int(told[-1]), int(told[-1]) + 1)


@pytest.mark.parametrize("step", range(1, 5))
def test_interrupted_at_any_step_one_whole_state_is_there(
    tmp_path: Path, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The steps that a power loss can fall between: write, sync, and two renames."""
    file = StateFile(tmp_path / "a.json")
    file.save("old")
    calls = 0
    fsync, replace = os.fsync, Path.replace

    def counted(real: Any) -> Any:
        def call(*arguments: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == step:
                raise KeyboardInterrupt
            return real(*arguments)

        return call

    monkeypatch.setattr(os, "fsync", counted(fsync))
    monkeypatch.setattr(Path, "replace", counted(replace))
    with pytest.raises(KeyboardInterrupt):
        file.save("new")
    monkeypatch.undo()
    again = StateFile(tmp_path / "a.json")
    assert again.load() in (("old", "new") if step == 1 else ("new",))
    again.save("newer")
    assert StateFile(tmp_path / "a.json").load() == "newer"


def test_only_one_process_writes_in_a_folder(tmp_path: Path) -> None:
    held = FolderLock(tmp_path / "made")
    with pytest.raises(BlockingIOError):
        FolderLock(tmp_path / "made")
    held.release()
    FolderLock(tmp_path / "made").release()


def test_state_is_kept_where_the_user_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "spool"
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_folder() == tmp_path / ".local/state/spool"


@pytest.mark.parametrize(
    ("namespace", "below"),
    [
        ("/valve_1", "valve_1"),
        ("valve_1", "valve_1"),
        ("/press/left", "press/left"),
        ("/press//left/", "press/left"),
        ("/", ""),
        ("", ""),
        ("/../../etc/./x", "etc/x"),
    ],
)
def test_each_valve_has_a_folder_of_its_own_that_never_leads_out(
    tmp_path: Path, namespace: str, below: str
) -> None:
    assert valve_folder(tmp_path, namespace) == tmp_path / below / "monitor"
