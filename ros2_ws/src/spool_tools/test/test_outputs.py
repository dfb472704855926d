"""One rule for every file that a command writes."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_report import outputs
from spool_tools.cli import main
from spool_tools.command import command_modules


@pytest.fixture(name="bag", scope="module")
def _bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("made") / "bag"
    assert main(["simulate", "--seconds", "12", "--excitation", "multisine", "--out", str(bag)]) == 0
    return bag


#: Every option that names a file, with the command that has it; BAG stands for a bag.
WRITING = (
    "info BAG --json",
    "replay BAG --json",
    "fit BAG --json",
    "fit BAG --report",
    "fit BAG --save-model",
    "compare BAG --models fluid --json",
    "compare BAG --models fluid --report",
    "gap BAG --json",
    "gap BAG --report",
    "gap BAG --save-model",
    "bench estimate --json",
    "export BAG --out",
    "simulate --seconds 1 --out",
    "recover BAG --out",
    "trend valve_1 --out",
)


@pytest.mark.parametrize("words", [words for words in WRITING if words.split()[0] in command_modules()])
def test_what_is_there_is_left_alone_and_links_are_not_followed(
    words: str, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is refused before any work is done, so each of these is quick."""
    mine, link = tmp_path / "mine.csv", tmp_path / "link.csv"
    if "trend" in words:
        mine, link = tmp_path / "mine.html", tmp_path / "link.html"
    mine.write_text("mine", "utf-8")
    link.symlink_to(tmp_path / "elsewhere")
    command = [str(bag) if word == "BAG" else word for word in words.split()]
    for path, force, said in (
        (mine, [], "--force"),
        (link, [], "it is a link"),
        (link, ["--force"], "it is a link"),
    ):
        assert main([*command, str(path), *force]) == 2
        shown = capsys.readouterr()
        assert said in shown.err
        assert len(shown.err.splitlines()) == 1
    assert mine.read_text("utf-8") == "mine"
    assert not (tmp_path / "elsewhere").exists()
    assert sorted(tmp_path.iterdir()) == sorted([mine, link])


@pytest.mark.parametrize("command", ["replay BAG --json", "export BAG --out", "simulate --seconds 1 --out"])
def test_force_replaces(command: str, bag: Path, tmp_path: Path) -> None:
    path = tmp_path / "result.csv"
    words = [str(bag) if word == "BAG" else word for word in command.split()]
    assert main([*words, str(path)]) == 0
    first = path.stat().st_ino
    assert main([*words, str(path), "--force"]) == 0
    assert path.stat().st_ino != first
    assert list(tmp_path.iterdir()) == [path]


def test_force_does_not_remove_a_folder_that_is_no_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letter").write_text("mine", "utf-8")
    assert main(["simulate", "--seconds", "1", "--out", str(tmp_path / "home"), "--force"]) == 2
    assert "no bag" in capsys.readouterr().err
    assert (tmp_path / "home" / "letter").read_text("utf-8") == "mine"


def test_a_folder_with_something_in_it_is_not_filled(tmp_path: Path) -> None:
    (tmp_path / "paper").mkdir()
    (tmp_path / "paper" / "letter").write_text("mine", "utf-8")
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    for name, said in (("paper", "it is not empty"), ("link", "it is a link")):
        with pytest.raises(InputError, match=said):
            outputs.check_folder(tmp_path / name)
    assert outputs.check_folder(tmp_path / "new") == tmp_path / "new"


def test_a_bag_comes_back_where_its_replacement_fails(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    assert main(["recover", str(bag), "--out", str(out)]) == 0
    before = sorted(path.name for path in out.iterdir())
    bad = tmp_path / "bad.csv"
    bad.write_text("time_s,body_m_s2\n0,1\n", "utf-8")
    assert main(["import", str(bad), "--out", str(out), "--force"]) == 2
    assert sorted(path.name for path in out.iterdir()) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.csv", "bag"]


def test_json_on_standard_output_is_nothing_but_json(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for command in ("replay", "info"):
        assert main([command, str(bag), "--json", "-"]) == 0
        shown = capsys.readouterr()
        assert "valve_1" in json.loads(shown.out)["valves"]
        assert "blocks" in shown.err
    assert list(tmp_path.iterdir()) == []


def test_a_pipe_takes_what_is_written(tmp_path: Path) -> None:
    """As `--json >(jq ...)` hands one over."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text("utf-8")))
    reader.start()
    outputs.write_file(pipe, "content")
    reader.join(timeout=180)
    assert read == ["content"]


def test_nothing_is_left_of_a_file_that_could_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"result\.json: cannot be written: No space left on device"):
        outputs.write_file(tmp_path / "result.json", "{}")
    assert list(tmp_path.iterdir()) == []


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_every_digit(value: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("number") / "number.json"
    outputs.write_json(path, [value])
    assert json.loads(path.read_text("utf-8")) == [value]


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "result.json"
    with pytest.raises(InputError, match=r"result\.json: missing folder .*missing: make it first"):
        outputs.write_json(path, {})


@pytest.mark.parametrize("words", [["--out", "~/made"], ["--out=~/made"]])
def test_a_path_below_the_home_folder_needs_no_shell(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    valve = "id: mine\nmoving_mass: 0.18\nspring_stiffness: 1632.0\nland_diameter: 0.02\nland_length: 0.032\n"
    oil = "radial_clearance: 15.0e-6\ndynamic_viscosity: 0.0612\n"
    (tmp_path / "mine.yaml").write_text(valve + oil, "utf-8")
    assert main(["simulate", "--valve", "~/mine.yaml", "--seconds", "1", *words]) == 0
    assert list((tmp_path / "made").glob("*.mcap"))
