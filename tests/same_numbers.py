"""Record of what users get: a change of structure leaves every command, page, message and file as it was.

    python3 tests/same_numbers.py collect FOLDER [--tree REPOSITORY]
    python3 tests/same_numbers.py compare BEFORE AFTER [--within 0.01] [--relative 0.000001]

``collect`` runs what ``tests/same/runs.txt`` lists in a repository by its ``./spool``; ``compare`` prints
what differs. This repository has to be set up (``./spool --version``): its environment reads the files.
"""

from __future__ import annotations

import argparse
import difflib
import json
import math
import os
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT))

from tests.same.reading import leaves  # noqa: E402 - also as a script

PYTHON = ROOT / ".venv" / "bin" / "python"
#: Lines that are shown of one run.
SHOWN = 12
_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)?(?:e[-+]?\d+)?", re.IGNORECASE)


def deviation_of(values: dict[str, Any], path: str) -> float:
    """Return the standard deviation stated beside the number at ``path``, 0 without one."""
    parent = path.rpartition(", ")[0]
    for name in ("std", "standard_deviation", "sigma"):
        told = values.get(f"{parent}, {name}" if parent else name)
        if isinstance(told, int | float) and math.isfinite(told):
            return float(told)
    return 0.0


def same_text(old: str, new: str, relative: float) -> bool:
    """Whether two lines differ by spaces and by numbers within ``relative`` alone."""
    if not relative or _NUMBER.sub("", old).split() != _NUMBER.sub("", new).split():
        return old == new
    pairs = zip(_NUMBER.findall(old), _NUMBER.findall(new), strict=True)
    numbers = [tuple(float(one.replace(",", ".")) for one in pair) for pair in pairs]
    return all(math.isclose(*pair, rel_tol=relative) for pair in numbers)


def different_lines(old: list[str], new: list[str], relative: float) -> Iterator[str]:
    """Yield a text for each line that differs."""
    for kind, a, b, c, d in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if kind == "equal":
            continue
        paired = min(b - a, d - c)
        for n in range(paired):
            if not same_text(old[a + n], new[c + n], relative):
                yield f"line {a + n + 1}: {old[a + n]!r} -> {new[c + n]!r}"
        yield from (f"line {n + 1} is gone: {old[n]!r}" for n in range(a + paired, b))
        yield from (f"line {n + 1} is new: {new[n]!r}" for n in range(c + paired, d))


def differences(before: Any, after: Any, within: float, relative: float = 0.0) -> Iterator[str]:
    """Yield a line for each number or text that differs by more than is allowed."""
    first, second = dict(leaves(before)), dict(leaves(after))
    for path in dict.fromkeys([*first, *second]):
        old, new, more = first.get(path, "absent"), second.get(path, "absent"), ""
        kinds = {type(old), type(new)}
        if repr(old) == repr(new) or (kinds == {str} and same_text(old, new, relative)):
            continue
        if kinds == {list}:
            yield from (f"{path}, {line}" for line in different_lines(old, new, relative))
            continue
        if kinds <= {int, float}:
            deviation = deviation_of(first, path)
            if abs(new - old) <= max(within * deviation, relative * abs(old)):
                continue
            more = f" ({abs(new - old) / deviation:.2g} standard deviations)" if deviation else ""
        yield f"{path}: {old} -> {new}{more}"


def compare(before: Path, after: Path, within: float, relative: float = 0.0) -> int:
    """Print what differs between two records; return how many runs do."""
    names = sorted({path.name for folder in (before, after) for path in folder.glob("*.json")})
    differing = 0
    for name in names:
        found = [folder / name for folder in (before, after) if (folder / name).exists()]
        results = [json.loads(one.read_text("utf-8")) for one in found]
        one_alone = [f"only in {found[0].parent}"] if len(found) == 1 else []
        lines = one_alone or list(differences(*results, within, relative))
        more = [f"{len(lines) - SHOWN} more"] if len(lines) > SHOWN else []
        differing += bool(lines)
        for line in (*lines[:SHOWN], *more):
            print(f"{results[0]['run']}: {line[:400]}")
    print(f"{len(names) - differing} of {len(names)} runs are equal")
    return differing


def main() -> int:
    """Collect or compare; exit 1 where something is missing or differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    tasks = parser.add_subparsers(dest="task", required=True)
    collecting = tasks.add_parser("collect", help="record what users get of a repository")
    collecting.add_argument("folder", type=Path, help="is replaced")
    collecting.add_argument("--tree", type=Path, default=ROOT, help="repository whose commands are run")
    collecting.add_argument("--only", default="", help="pattern of the wanted runs, e.g. 'fit|nodes'")
    collecting.add_argument("--jobs", type=int, default=2, help="runs at a time")
    comparing = tasks.add_parser("compare", help="print what differs")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument("--within", type=float, default=0.0, help="share of the deviation; 0: bit for bit")
    comparing.add_argument("--relative", type=float, default=0.0, help="of all other numbers")
    given = parser.parse_args()
    if given.task == "compare":
        return min(1, compare(given.before, given.after, given.within, given.relative))
    if Path(sys.prefix) != PYTHON.parent.parent:
        os.execv(PYTHON, [str(PYTHON), *sys.argv])
    from tests.same.collecting import Collection  # noqa: PLC0415 - needs the environment

    begun = time.monotonic()
    missing = Collection(given.folder.resolve(), given.tree.resolve()).collect(given.only, given.jobs)
    print(f"{time.monotonic() - begun:.0f} s")
    return min(1, missing)


if __name__ == "__main__":
    sys.exit(main())
