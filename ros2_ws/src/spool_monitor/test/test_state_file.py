"""What is kept survives whatever happens between two instructions."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import sqlite3
import stat
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_monitor.journal import Journal, JournalEntry, entries_in
from spool_monitor.state_database import FILE
from spool_monitor.state_file import LAST, StateFile, StateTable, default_folder, lock_folder, valve_folder
from spool_monitor.trend import TrendStore


def saved(folder: Path, *contents: object) -> list[str]:
    """Save ``contents`` after each other; return the warnings."""
    said: list[str] = []
    file = StateFile(folder, said.append)
    file.load(["a"])
    for content in contents:
        file.save("a", content)
    file.close()
    return said


def loaded(folder: Path) -> tuple[Any, list[str]]:
    said: list[str] = []
    return StateFile(folder, said.append).load(["a"]).get("a"), said


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    assert loaded(tmp_path) == (None, [])
    saved(tmp_path, {"a": [1, 2.5, "ü", None]})
    assert loaded(tmp_path) == ({"a": [1, 2.5, "ü", None]}, [])


def test_the_state_shares_one_file_with_journal_and_trends(tmp_path: Path) -> None:
    saved(tmp_path, 1)
    assert entries_in(tmp_path / FILE) == []
    journal = Journal(tmp_path / FILE)
    journal.write([JournalEntry(1, "raise", "resonance")])
    journal.close()
    TrendStore(tmp_path / FILE).close()
    saved(tmp_path, 2)
    assert names(tmp_path) == {FILE, LAST}
    assert loaded(tmp_path) == (2, [])
    assert [one.stamp for one in entries_in(tmp_path / FILE)] == [1]


@pytest.mark.parametrize(("kept", "gone"), [(FILE, LAST), (LAST, FILE)])
def test_the_file_or_its_copy_is_enough(tmp_path: Path, kept: str, gone: str) -> None:
    saved(tmp_path, 1, 2)
    (tmp_path / gone).unlink()
    assert loaded(tmp_path) == (2, [])
    saved(tmp_path, 3)
    (tmp_path / kept).unlink()
    assert loaded(tmp_path) == (3, [])


@pytest.fixture(scope="module", name="whole")
def _whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which a state was saved twice; nobody may change it."""
    folder = tmp_path_factory.mktemp("whole")
    saved(folder, {"value": 1}, {"value": 2})
    return folder


@settings(deadline=None)
@given(position=st.integers(0, 100_000), flip=st.integers(1, 255), place=st.sampled_from([FILE, LAST]))
def test_any_damaged_byte_costs_no_state(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, position: int, flip: int, place: str
) -> None:
    folder = Path(shutil.copytree(whole, tmp_path_factory.mktemp("state") / "damaged"))
    data = bytearray((folder / place).read_bytes())
    data[position % len(data)] ^= flip
    (folder / place).write_bytes(data)
    assert loaded(folder)[0] == {"value": 2}
    file = StateFile(folder, lambda _: None)
    file.load(["a"])
    for value in (3, 4):
        try:
            file.save("a", value)
        except (InputError, OSError):  # said by the monitor, which tries again
            continue
    file.close()
    assert loaded(folder)[0] == 4


def test_a_changed_value_is_seen_by_its_checksum(tmp_path: Path) -> None:
    saved(tmp_path, {"stiffness": 5847.0})
    for name in (FILE, LAST):
        with closing(sqlite3.connect(tmp_path / name)) as base, base:
            base.execute("UPDATE state SET whole = CAST(replace(whole, '5847', '5947') AS BLOB)")
    content, said = loaded(tmp_path)
    assert content is None
    assert [line.partition(": ")[2] for line in said] == [
        f"{name}: damaged: its checksum does not fit" for name in (FILE, LAST)
    ]


@pytest.mark.parametrize("data", [b"", b"perhaps somebody can still read this" * 500])
def test_a_damaged_file_is_kept_aside_and_the_copy_used(tmp_path: Path, data: bytes) -> None:
    saved(tmp_path, 1)
    (tmp_path / FILE).write_bytes(data)
    content, said = loaded(tmp_path)
    assert content == 1
    assert bool(said) == bool(data)
    warnings = saved(tmp_path, 2)
    if data:
        assert (tmp_path / f"{FILE}.damaged").read_bytes() == data
        assert "it is damaged" in said[0]
        assert "renames it to trends.sqlite.damaged" in warnings[-1]
    (tmp_path / LAST).unlink()
    assert loaded(tmp_path) == (2, [])


def test_a_later_version_s_state_is_read_and_left_alone_on_a_downgrade(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved(tmp_path, "before")
    for name in (FILE, LAST):
        with closing(sqlite3.connect(tmp_path / name)) as base:
            base.execute("PRAGMA user_version=2")
    later = (tmp_path / FILE).read_bytes()
    content, said = loaded(tmp_path)
    assert content == "before"
    assert "a later version of the suite wrote trends.sqlite (format 2, this version writes 1)" in said[0]
    saved(tmp_path, "during")
    assert loaded(tmp_path)[0] == "during"
    assert (tmp_path / FILE).read_bytes() == later
    assert "trends.format1.sqlite" in names(tmp_path)
    for module in ("state_database", "state_file"):
        monkeypatch.setattr(f"spool_monitor.{module}.VERSION", 2)
    assert loaded(tmp_path) == ("during", [])
    saved(tmp_path, "after")
    assert loaded(tmp_path) == ("after", [])


def json_state(path: Path, sequence: int, content: object, **changes: object) -> None:
    """Write a state as the versions before the database did."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(f"{sequence}\n{text}".encode()).hexdigest()
    whole = {"format": 1, "sequence": sequence, "sha256": digest, "content": content, **changes}
    path.write_text(json.dumps(whole), "utf-8")


def test_the_json_of_a_version_before_is_taken_over_once(tmp_path: Path) -> None:
    json_state(tmp_path / "a.json", 8, "newest")
    json_state(tmp_path / "a.json.last", 7, "before")
    assert loaded(tmp_path) == ("newest", [])
    saved(tmp_path, "next")
    json_state(tmp_path / "a.json", 9, "of an older version afterwards")
    assert loaded(tmp_path) == ("next", [])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "Expecting value"),
        ("[]", "indices must be"),
        ('{"content": ' + "[" * 20_000 + "]" * 20_000 + "}", "recursion"),
        (json.dumps({"format": 1, "sequence": 1, "sha256": "0", "content": 1}), "checksum does not fit"),
        (json.dumps({"format": 1, "sequence": "1", "sha256": "0", "content": 1}), "checksum does not fit"),
    ],
)
def test_damaged_json_is_said_and_its_copy_taken_over(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "a.json").write_text(text, "utf-8")
    json_state(tmp_path / "a.json.last", 7, "before")
    content, said = loaded(tmp_path)
    assert content == "before"
    assert reason in said[0]
    assert "a.json: damaged" in said[0]


def test_half_a_new_json_file_is_what_a_power_loss_leaves(tmp_path: Path) -> None:
    json_state(tmp_path / "a.json", 7, "whole")
    (tmp_path / "a.json.new").write_text('{"format": 1, "sequ', "utf-8")
    assert loaded(tmp_path) == ("whole", [])


def test_only_the_owner_may_read_the_state(tmp_path: Path) -> None:
    folder = tmp_path / "valve_1" / "monitor"
    folder.mkdir(parents=True, mode=0o755)
    (folder / FILE).touch(0o644)
    before = os.umask(0o022)
    try:
        lock_folder(folder).close()
        saved(folder, 1)
    finally:
        os.umask(before)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}


def test_opening_a_file_again_keeps_the_locks_of_those_who_have_it_open(tmp_path: Path) -> None:
    """POSIX drops a process's locks of a file when any of its descriptors is closed."""
    held = StateTable(tmp_path / FILE)
    held.base.execute("BEGIN IMMEDIATE")
    held.base.execute("INSERT INTO state VALUES ('a', x'00')")

    def locks() -> int:
        inode = f":{(tmp_path / FILE).stat().st_ino} "
        return sum(inode in line for line in Path("/proc/locks").read_text("ascii").splitlines())

    before = locks()
    assert before > 0
    StateTable(tmp_path / FILE).close()
    assert locks() == before
    held.close()


def test_what_json_cannot_hold_leaves_the_state_as_it_was(tmp_path: Path) -> None:
    saved(tmp_path, 1)
    with pytest.raises(ValueError, match="JSON"):
        saved(tmp_path, float("nan"))
    assert loaded(tmp_path) == (1, [])


WRITER = """
import sys
from pathlib import Path
from spool_monitor.state_file import StateFile
file = StateFile(Path(sys.argv[1]), print)
first = file.load(["a"]).get("a", {"count": 0})["count"]
for count in range(first + 1, first + 1000000):
    file.save("a", {"count": count, "ballast": "x" * (count % 7000)})
    print(count, flush=True)
"""


def test_killed_at_random_moments_it_keeps_the_last_state_that_was_reported(
    tmp_path: Path, killed: Callable[[str, list[str], int], list[str]]
) -> None:
    """What was reported as saved is there after every kill, and nothing is ever torn."""
    chance = random.Random(1)
    for _ in range(12):
        told = killed(WRITER, [str(tmp_path)], chance.randrange(1, 60))
        content, said = loaded(tmp_path)
        assert said == []
        assert content["ballast"] == "x" * (content["count"] % 7000)
        assert content["count"] in (int(told[-1]), int(told[-1]) + 1)


@pytest.mark.parametrize("step", [1, 2])
def test_interrupted_at_either_transaction_one_whole_state_is_there(
    tmp_path: Path, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved(tmp_path, "old")
    calls, write = 0, StateTable.write

    def counted(*arguments: Any) -> None:
        nonlocal calls
        calls += 1
        if calls == step:
            raise KeyboardInterrupt
        write(*arguments)

    monkeypatch.setattr(StateTable, "write", counted)
    with pytest.raises(KeyboardInterrupt):
        saved(tmp_path, "new")
    monkeypatch.undo()
    assert loaded(tmp_path)[0] == ("old" if step == 1 else "new")
    saved(tmp_path, "newer")
    assert loaded(tmp_path)[0] == "newer"


def test_only_one_process_writes_in_a_folder(tmp_path: Path) -> None:
    held = lock_folder(tmp_path / "made")
    with pytest.raises(BlockingIOError):
        lock_folder(tmp_path / "made")
    held.close()
    lock_folder(tmp_path / "made").close()


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
