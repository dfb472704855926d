from __future__ import annotations

import fnmatch
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_evaluation.changed_tests import ABOUT, Repository

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = "ros2_ws/src/spool_a/spool_a"
TESTS = "ros2_ws/src/spool_a/test"
LAWS = """
LIMIT = 2


def force(z):
    return min(z, LIMIT)


def other():
    return 1
"""
VALVE = """
from . import laws


class Valve:
    def pull(self):
        return laws.force(3)
"""
FIXTURES = """
import pytest
from spool_a.valve import Valve


@pytest.fixture(name="valve")
def _valve():
    return Valve()
"""
TEST = """
from spool_a.laws import other


def test_of_a_fixture(valve):
    assert valve


def test_of_a_function():
    assert other()


def test_of_a_file():
    assert "table.csv"


def test_of_a_command():
    assert main(["pull", "x"])
"""
FILES = {
    f"{PACKAGE}/laws.py": LAWS,
    f"{PACKAGE}/valve.py": VALVE,
    f"{PACKAGE}/commands/pull_command.py": "def pull():\n    return 1\n",
    f"{TESTS}/conftest.py": FIXTURES,
    f"{TESTS}/test_a.py": TEST,
    "table.csv": "1\n",
}


@pytest.fixture(name="repository")
def _repository(tmp_path: Path) -> Path:
    """Return a repository of one package whose files are all committed."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    commit(tmp_path)
    return tmp_path


def commit(repository: Path) -> None:
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.org"]
    for words in (["add", "."], [*who, "commit", "-q", "-m", "all"]):
        subprocess.run(["git", *words], cwd=repository, check=True)


@pytest.mark.parametrize(
    ("file", "old", "new", "reached"),
    [
        (f"{PACKAGE}/laws.py", "LIMIT = 2", "LIMIT = 3", {"fixture"}),
        (f"{PACKAGE}/laws.py", "return 1", "return 2", {"function"}),
        (f"{PACKAGE}/valve.py", "(3)", "(4)", {"fixture"}),
        (f"{PACKAGE}/commands/pull_command.py", "return 1", "return 2", {"command"}),
        ("table.csv", "1", "2", {"file"}),
        (f"{TESTS}/test_a.py", "assert valve", "assert valve.pull()", {"fixture"}),
        (f"{TESTS}/conftest.py", "return Valve()", "return 1", {"fixture", "function", "file", "command"}),
    ],
)
def test_a_change_reaches_the_tests_that_use_what_it_changes(
    repository: Path, file: str, old: str, new: str, reached: set[str]
) -> None:
    path = repository / file
    path.write_text(path.read_text("utf-8").replace(old, new), "utf-8")
    found = Repository(repository)
    names = found.tests_reached(found.changed_since("HEAD"))
    assert set(names) == {f"{TESTS}/test_a.py::test_of_a_{name}" for name in reached}


@pytest.mark.parametrize("workers", ["0", "2"])
def test_only_what_is_reached_is_run_by_workers_too(repository: Path, workers: str) -> None:
    shutil.copy(ROOT / "conftest.py", repository)
    commit(repository)
    path = repository / PACKAGE / "laws.py"
    path.write_text(path.read_text("utf-8").replace("return 1", "return 2"), "utf-8")
    source = os.pathsep.join((str(repository / PACKAGE).rpartition("/")[0], os.environ["PYTHONPATH"]))
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", workers, "--changed"]
    done = subprocess.run(
        [sys.executable, *words], cwd=repository, env=os.environ | {"PYTHONPATH": source},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.startswith("since HEAD: 1 test functions can be reached"), done.stdout + done.stderr
    assert "\n1 passed" in done.stdout, done.stdout


def test_nothing_is_reached_where_nothing_changed(repository: Path) -> None:
    found = Repository(repository)
    assert found.tests_reached(found.changed_since("HEAD")) == []


def test_a_commit_that_does_not_exist_is_refused_in_one_line(repository: Path) -> None:
    with pytest.raises(InputError, match=r"^--changed elsewhere: no such commit; git log lists them$"):
        Repository(repository).changed_since("elsewhere")


def test_tests_that_start_nodes_are_listed_with_modules_that_exist() -> None:
    sources = Repository(ROOT).sources
    files = (ROOT / "tests").glob("test_*.py")
    assert {path.stem for path in files if "system.start(" in path.read_text("utf-8")} <= ABOUT.keys()
    for test, patterns in ABOUT.items():
        assert f"tests.{test}" in sources
        for pattern in patterns:
            assert fnmatch.filter(sources, pattern), (test, pattern)
