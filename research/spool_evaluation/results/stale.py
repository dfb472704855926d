"""Pages of results that are older than the code that they measured."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from spool_evaluation.benchmarks import BENCHMARKS
from spool_evaluation.changed_tests import Repository
from spool_evaluation.studies import STUDIES

ROOT = Path(__file__).resolve().parents[3]
_MADE = re.compile(r"^Made on (\S+) by `([^`]+)`, version .*commit ([0-9a-f]{7,})", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Age:
    """Age of a page: the day it was made, and the commits since then to each package that it measured.

    ``commits`` is None where the page's commit is not in this repository.
    """

    page: str
    made: str
    commits: dict[str, int] | None

    def __str__(self) -> str:
        if self.commits is None:
            return f"{self.page}, made {self.made} with a commit that is not in this repository"
        counts = ", ".join(f"{name} {count}" for name, count in self.commits.items())
        return f"{self.page}, made {self.made}; commits since: {counts}"


@cache
def depends_on(command: str) -> tuple[str, ...]:
    """Return the packages that a command of a results page runs, by what its module imports.

    Args:
        command: as on the page, e.g. ``./spool bench estimate --markdown FILE``.
    """
    sources = Repository(ROOT).sources
    waiting = [name for name in _modules(command) if name in sources]
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        found.add(name)
        for base, what, _ in sources[name].imports:
            module = next((one for one in (f"{base}.{what}", base) if one in sources), None)
            if module is not None and module not in found:
                waiting.append(module)
    parts = (sources[name].path.parts for name in found)
    return tuple(sorted({one[2] for one in parts if one[0] == "ros2_ws"}))


def _modules(command: str) -> list[str]:
    """Return the modules whose functions a command runs; some may not exist."""
    words = command.split()
    if words[1] == "bench":
        names = [words[2]] if words[2] in BENCHMARKS else list(BENCHMARKS)
        return [f"spool_evaluation.benchmarks.{name}" for name in names]
    if words[1] == "study":
        module = STUDIES[words[2]][0]
        return [module, f"spool_evaluation.{module}"]
    if words[1] == "python":
        return [word.removesuffix(".py").replace("/", ".") for word in words if word.endswith(".py")]
    return ["tests.faults.live"]


def ages(folder: Path) -> list[Age]:
    """Return the age of each page of results in ``folder`` whose packages changed since, oldest first."""
    found = []
    for page in sorted(folder.glob("*.md")):
        made = _MADE.search(page.read_text(encoding="utf-8"))
        if made is not None:
            counts = {package: _commits(made[3], package) for package in depends_on(made[2])}
            if None in counts.values():
                found.append(Age(page.name, made[1], None))
            elif changed := {name: count for name, count in counts.items() if count}:
                found.append(Age(page.name, made[1], changed))
    return sorted(found, key=lambda one: one.made)


def _commits(since: str, package: str) -> int | None:
    words = ["git", "rev-list", "--count", f"{since}..HEAD", "--", f"ros2_ws/src/{package}/{package}"]
    run = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    return int(run.stdout) if run.returncode == 0 else None
