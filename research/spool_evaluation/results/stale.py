"""Pages of results that are older than the code that they measured."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Collection
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

    def __str__(self) -> str:
        head = "stale: " if self.share > OLD else ""
        return f"{head}{self.page}, made {self.made}; {self.share:.1%} of the lines it measured are newer"


def depends_on(command: str) -> tuple[str, ...]:
    """Return the packages that a command of a results page runs, as ``./spool bench sim --markdown FILE``."""
    paths = map(Path.as_posix, loaded_by(*_modules(command)).values())
    return tuple(sorted({path.split("/")[2] for path in paths if path.startswith("ros2_ws/")}))


@cache
def loaded_by(*modules: str) -> dict[str, Path]:
    """Return the files of ``modules``, of what they import, directly or not, and of its registries."""
    sources = Repository(ROOT).sources
    waiting, found = list(modules), dict[str, Path]()
    while waiting:
        if (name := waiting.pop()) in found or name not in sources:
            continue
        found[name] = sources[name].path
        for registry in (one for one in REGISTRIES if name.startswith(f"{one.rpartition('.')[0]}.")):
            waiting += [one for one in sources if one.startswith(f"{registry}.")]
        for base, what, _ in sources[name].imports:
            waiting += [f"{base}.{what}", base]
    return found


def _modules(command: str) -> list[str]:
    """Return the modules whose functions a command runs; some may not exist."""
    words = command.split()
    if words[1] == "bench":
        chosen = [name for name in BENCHMARKS if words[2] in (name, "--markdown")]
        return [f"spool_evaluation.benchmarks.{name}" for name in chosen]
    if words[1] == "study":
        return [STUDIES[words[2]][0], f"spool_evaluation.{STUDIES[words[2]][0]}"]
    if words[1] == "python":
        return [word.removesuffix(".py").replace("/", ".") for word in words if word.endswith(".py")]
    return ["tests.faults.live"]


def ages(folder: Path) -> list[Age]:
    """Return the age of each page of results in ``folder`` whose code changed, oldest code first."""
    found = []
    for page in folder.glob("*.md"):
        for day, command, commit in _MADE.findall(page.read_text("utf-8")):
            if share := _share(commit, day, loaded_by(*_modules(command)).values()):
                found.append(Age(page.name, day, share))
    return sorted(found, key=lambda one: -one.share)


def _share(commit: str, day: str, files: Collection[Path]) -> float:
    """Return the share of lines newer than a commit, or than its day without it; 1 where nothing is known."""
    since = _git("rev-list", "-1", commit) or _git("rev-list", "-1", f"--before={day}T23:59Z", "HEAD")
    if not since or not files:
        return 1.0
    added = [int(row.split("\t")[0]) for row in _git("diff", "--numstat", since, "--", *files).splitlines()]
    return sum(added) / sum((ROOT / path).read_bytes().count(b"\n") for path in files)


def _git(*words: str | Path) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, check=False).stdout.decode().strip()
