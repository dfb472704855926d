"""A run of many workers: each file is read by one of them, the one that took longest is begun first."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
#: A file that says who read it, and has a test that is not wanted.
FILE = """
import pytest
print(__name__, file=open("read", "a"))
def test_passes(): pass
@pytest.mark.slow
def test_is_slow(): assert False
"""


def run(folder: Path, *words: str, workers: str = "2") -> tuple[int, str]:
    options = ["-p", "conftest", "-n", workers, "--dist", "loadfile", "--no-loadscope-reorder"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), *sys.path]))}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "-m", "not slow", *words],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\naddopts = --import-mode=importlib\nmarkers = slow: x\n", "utf-8"
    )
    for name in "abcd":
        (tmp_path / f"test_{name}.py").write_text(FILE, "utf-8")
    return tmp_path


def test_each_file_is_read_once_and_the_slowest_of_the_last_run_first(folder: Path) -> None:
    assert "4 passed" in run(folder)[1]
    assert sorted((folder / "read").read_text("utf-8").split()) == ["test_a", "test_b", "test_c", "test_d"]
    times = folder / ".pytest_cache/v/spool/times"
    times.write_text(
        json.dumps({**json.loads(times.read_text("utf-8")), "test_d.py": 9.0, "test_c.py": 8.0}), "utf-8"
    )
    (folder / "read").unlink()
    assert "4 passed" in run(folder, workers="1")[1]
    assert (folder / "read").read_text("utf-8").split() == ["test_d", "test_c", "test_a", "test_b"]


def test_a_file_that_cannot_be_read_and_a_choice_of_no_test_fail_the_run(folder: Path) -> None:
    assert run(folder, "-k", "nowhere")[0] == pytest.ExitCode.NO_TESTS_COLLECTED
    (folder / "test_b.py").write_text("import nowhere\n", "utf-8")
    code, said = run(folder)
    assert (code, "3 passed, 1 error" in said) == (pytest.ExitCode.TESTS_FAILED, True), said
