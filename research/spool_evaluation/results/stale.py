"""Pages of results that are older than the code that they measured."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from spool_evaluation.benchmarks import BENCHMARKS
from spool_evaluation.changed_tests import REGISTRIES, Repository
from spool_evaluation.studies import STUDIES

ROOT = Path(__file__).resolve().parents[3]
_MADE = re.compile(r"^Made on (\S+) by `([^`]+)`, version .*commit ([0-9a-f]{7,})", re.MULTILINE)
#: Share of the lines loaded by a page's command that may be newer: beyond it the page measured other code.
OLD = 1.0 / 3.0


@dataclass(frozen=True, slots=True)
class Age:
    """Age of a page: the day it was made, and the share of the lines that it measured that are newer."""

    page: str
    made: str
    share: float

    @property
    def stale(self) -> bool:
        """Whether the page has to be made again."""
        return self.share > OLD

    def __str__(self) -> str:
        head = "stale: " if self.stale else ""
        return (
            f"{head}{self.page}, made {self.made}; {self.share:.1%} of the lines that it measured are newer"
        )


@cache
def depends_on(command: str) -> tuple[str, ...]:
    """Return the packages that a command of a results page runs, by what its module imports.

    Args:
        command: as on the page, e.g. ``./spool bench estimate --markdown FILE``.
    """
    parts = (path.parts for path in _files(command))
    return tuple(sorted({one[2] for one in parts if one[0] == "ros2_ws"}))


def _files(command: str) -> list[Path]:
    """Return the files of the modules that a command of a results page runs."""
    sources = _repository().sources
    return [sources[name].path for name in loaded_by(frozenset(_modules(command)))]


@cache
def _repository() -> Repository:
    return Repository(ROOT)


@cache
def loaded_by(modules: frozenset[str]) -> frozenset[str]:
    """Return the modules of this repository that ``modules`` import, directly or not, and themselves.

    The modules of a registry, as that of the formats, are found by their place: all count with it.
    """
    sources = _repository().sources
    waiting = [name for name in modules if name in sources]
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        for registry in (one for one in REGISTRIES if name.startswith(f"{one.rpartition('.')[0]}.")):
            waiting += [one for one in sources if one.startswith(f"{registry}.")]
        for base, what, _ in sources[name].imports:
            waiting += [one for one in (f"{base}.{what}", base) if one in sources]
    return frozenset(found)


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
    """Return the age of each page of results in ``folder`` whose code changed, oldest code first."""
    found = []
    for page in sorted(folder.glob("*.md")):
        made = _MADE.search(page.read_text(encoding="utf-8"))
        if made is not None and (share := _share(_commit(made[3], made[1]), _files(made[2]))):
            found.append(Age(page.name, made[1], share))
    return sorted(found, key=lambda one: -one.share)


def _share(since: str, files: list[Path]) -> float:
    """Return the share of the lines of ``files`` that are newer than a commit; 1 without a commit."""
    total = sum((ROOT / path).read_bytes().count(b"\n") for path in files)
    rows = _git("diff", "--numstat", since, "--", *map(str, files)).splitlines() if since else []
    return sum(int(row.split("\t")[0]) for row in rows) / max(total, 1) if since else 1.0


def _commit(name: str, day: str) -> str:
    """Return a commit, or the last one of its day where it is not in this repository; empty if none."""
    known = _git("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}")
    return (known or _git("rev-list", "-1", f"--before={day}T23:59:59Z", "HEAD")).strip()


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout
