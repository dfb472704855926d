"""Who is at fault when a program fails: the input, the machine, or the suite."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from spool_bag.importing.formats import format as reading
from spool_bag.mcap_record import Definitions
from spool_report.evidence.exhibit import LeftOut, made
from spool_report.runs import record_quality
from spool_tools.cli import FAULT, main

FAULTS = (AttributeError, TypeError, KeyError, NameError, AssertionError, RuntimeError, IndexError)


def faulty(kind: type[Exception]) -> Any:
    def work(*_given: object, **_named: object) -> None:
        raise kind("no such thing")

    return work


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize("name", ["press.csv", "press.tdms", "press.xlsx"])
def test_a_fault_of_a_reader_is_not_called_a_damaged_file(
    name: str, kind: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    file = tmp_path / name
    file.write_text("time_s,body_m_s2,spool_m_s2\n0,1,2\n", "utf-8")
    broken = tuple(replace(form, opened=faulty(kind), begins=()) for form in reading.formats())
    monkeypatch.setattr(reading, "formats", lambda: broken)
    assert main(["import", str(file), "--out", str(tmp_path / "bag")]) == FAULT
    said = capsys.readouterr().err
    assert f"internal error ({kind.__name__}: " in said
    assert "a fault of the suite, not of your input" in said
    assert "damaged" not in said
    assert said.count("\n") == 1


def test_what_a_library_meets_in_a_cut_file_is_the_files_fault(tmp_path: Path, capsys: Any) -> None:
    file = tmp_path / "cut.xlsx"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types>")
    assert main(["import", str(file), "--out", str(tmp_path / "bag")]) == 2
    assert "cannot be read as Excel" in capsys.readouterr().err


@pytest.mark.parametrize("wanted", ["1", "0"])
def test_the_traceback_is_shown_where_it_is_asked_for(
    wanted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setenv("SPOOL_TRACEBACK", wanted)
    monkeypatch.setattr(record_quality, "quality_of_record", faulty(TypeError))
    file = tmp_path / "record.csv"
    file.write_text("time_s,body_m_s2,spool_m_s2\n0,1,2\n", "utf-8")
    assert main(["check", str(file)]) == FAULT
    assert ("Traceback" in capsys.readouterr().err) == (wanted == "1")


def test_the_traceback_of_a_fault_is_kept_in_the_file_that_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(record_quality, "quality_of_record", faulty(TypeError))
    file = tmp_path / "record.csv"
    file.write_text("time_s,body_m_s2,spool_m_s2\n0,1,2\n", "utf-8")
    assert main(["check", str(file)]) == FAULT
    log = Path(capsys.readouterr().err.partition("the traceback in ")[2].partition(" (SPOOL")[0])
    assert "Traceback" in log.read_text("utf-8")
    assert "TypeError: no such thing" in log.read_text("utf-8")


def test_a_picture_left_out_by_a_fault_is_not_blamed_on_the_numbers() -> None:
    left = made("noise", faulty(KeyError))
    assert isinstance(left, LeftOut)
    assert "a fault of the suite" in left.reason
    assert "numbers" not in left.reason


@pytest.mark.parametrize("kind", [AttributeError, TypeError, KeyError])
def test_a_fault_while_a_bag_is_read_is_not_counted_as_damage_of_the_bag(
    kind: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    bag = tmp_path / "bag"
    assert main(["simulate", "--seconds", "1", "--out", str(bag)]) == 0
    monkeypatch.setattr(Definitions, "take", faulty(kind))
    assert main(["info", str(bag)]) == FAULT
    assert "damage" not in "".join(capsys.readouterr()).replace("simulate", "")


def program(*words: str, variables: dict[str, str] | None = None, **how: Any) -> Any:
    path = os.pathsep.join(entry for entry in sys.path if entry)
    environment = {**os.environ, "PYTHONPATH": path, **(variables or {})}
    command = [sys.executable, *words]
    return subprocess.run(command, env=environment, stderr=subprocess.PIPE, text=True, check=False, **how)


SPOOL = ("-m", "spool_bringup.program")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "utf-8"])
def test_output_that_cannot_be_encoded_is_printed_with_marks(encoding: str, tmp_path: Path) -> None:
    output, text = tmp_path / "output", "4 \N{PLUS-MINUS SIGN} 1 \N{BOX DRAWINGS LIGHT HORIZONTAL} \udcff"
    printing = f"from spool_core.text import keep_standard_streams as keep; keep(); print({text!a})"
    variables = {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}
    with output.open("wb") as stream:
        done = program("-c", printing, stdout=stream, variables=variables)
    assert (done.returncode, done.stderr) == (0, "")
    assert output.read_text(encoding=encoding) == text.encode(encoding, "replace").decode(encoding) + "\n"


def test_a_full_disk_behind_standard_output_is_named() -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = program(*SPOOL, "valve", "check", "4weh10_soft", stdout=full)
    assert done.stderr == "spool: standard output (/dev/full): No space left on device\n"
    assert done.returncode == 2


def test_a_removed_working_folder_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    before = Path.cwd()
    try:
        os.chdir(folder)
        folder.rmdir()
        done = program(*SPOOL, "check", "record.csv", stdout=subprocess.PIPE)
    finally:
        os.chdir(before)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "the working folder was removed: change to another one (cd)" in done.stderr
