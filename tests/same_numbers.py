"""Regression check of numbers: a change of structure leaves what replay, fit and gap say as it was.

    python3 tests/same_numbers.py collect FOLDER [--tree REPOSITORY] [--cases 20]
    python3 tests/same_numbers.py compare BEFORE AFTER [--within 0.01]

``collect`` runs the commands of a repository over the shipped bags and over generated cases whose seeds are
fixed; ``compare`` tells which numbers differ, bit for bit or by more than a share of their deviation.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
VALVES = {"practice_01": "4weh10_soft", "practice_03": "4weh10_soft", "practice_04": "4weh10_soft"}
#: First seed of the generated cases; no threshold was chosen on them.
FIRST_SEED = 26000
MODELS = ("fluid", "coulomb", "stribeck", "mixed")
#: What differs from one run to the next without meaning anything.
VOLATILE = (
    "seconds",
    "elapsed_s",
    "processor_seconds",
    "version",
    "created",
    "command",
    "record",
    "records",
    "file",
    "bag",
)


def jobs(tree: Path, out: Path, cases: int) -> Iterator[tuple[str, list[str]]]:
    """Yield (name, command) of each result."""
    spool = str(tree / "spool")
    for bag, valve in VALVES.items():
        record = str(tree / "bags" / bag)
        for method in ("prediction", "equation"):
            yield (
                f"replay_{bag}_{method}",
                [spool, "replay", record, "--valve", valve, "--method", method, "--refits"],
            )
        for model in MODELS:
            yield f"fit_{bag}_{model}", [spool, "fit", record, "--valve", valve, "--model", model]
    for seed in range(FIRST_SEED, FIRST_SEED + cases):
        case = out / "cases" / f"case_{seed}"
        yield (
            f"gap_{seed}",
            [spool, "gap", str(case / "record.csv.gz"), "--valve", str(case / "valve.yaml")],
        )


def collect(out: Path, tree: Path, cases: int) -> int:
    """Write one JSON file per command into ``out``; return how many commands gave none."""
    out.mkdir(parents=True, exist_ok=True)
    python = tree / ".venv" / "bin" / "python"
    seeds = [str(seed) for seed in range(FIRST_SEED, FIRST_SEED + cases)]
    folders = [*sorted((ROOT / "ros2_ws" / "src").glob("spool_*")), ROOT / "research"]
    path = os.pathsep.join(map(str, folders))
    subprocess.run(
        [python, "-m", "spool_blind", *seeds, "--out", out / "cases"],
        env=os.environ | {"PYTHONPATH": path},
        check=True,
        stdout=subprocess.DEVNULL,
    )

    def run(job: tuple[str, list[str]]) -> bool:
        name, command = job
        ran = subprocess.run(
            [*command, "--json", str(out / f"{name}.json"), "--force"],
            cwd=out,
            capture_output=True,
            text=True,
            check=False,
        )
        (out / f"{name}.txt").write_text(f"exit {ran.returncode}\n{ran.stderr}")
        print(f"{name}: exit {ran.returncode}", flush=True)
        return (out / f"{name}.json").exists()

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        done = list(pool.map(run, jobs(tree, out, cases)))
    print(f"{sum(done)} of {len(done)} results in {out}")
    return done.count(False)


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of each number and text that means something."""
    if isinstance(value, dict):
        for key, below in value.items():
            if key not in VOLATILE:
                yield from leaves(below, f"{path}.{key}")
    elif isinstance(value, list):
        for index, below in enumerate(value):
            yield from leaves(below, f"{path}[{index}]")
    else:
        yield path, value


def deviation_of(values: dict[str, Any], path: str) -> float:
    """Return the standard deviation told next to the number at ``path``, 0 where none is."""
    parent = path.rpartition(".")[0]
    for name in ("std", "standard_deviation", "sigma"):
        told = values.get(f"{parent}.{name}")
        if isinstance(told, int | float) and math.isfinite(told):
            return float(told)
    return 0.0


def differences(before: Any, after: Any, within: float) -> Iterator[str]:
    """Yield a line for each leaf that differs by more than ``within`` standard deviations."""
    first, second = dict(leaves(before)), dict(leaves(after))
    for path in sorted(first.keys() | second.keys()):
        old, new = first.get(path, "absent"), second.get(path, "absent")
        if repr(old) == repr(new):
            continue
        numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (old, new))
        if numbers and within and abs(new - old) <= within * deviation_of(first, path):
            continue
        yield f"{path}: {old} -> {new}"


def compare(before: Path, after: Path, within: float) -> int:
    """Print what differs between two folders of ``collect``; return how many files do."""
    names = sorted({path.name for folder in (before, after) for path in folder.glob("*.json")})
    differing = 0
    for name in names:
        if not all((folder / name).exists() for folder in (before, after)):
            print(f"{name}: only in one of the folders")
            differing += 1
            continue
        texts = ((folder / name).read_text() for folder in (before, after))
        lines = list(differences(*map(json.loads, texts), within))
        differing += bool(lines)
        for line in lines[:10]:
            print(f"{name}{line}")
        if len(lines) > 10:
            print(f"{name}: {len(lines) - 10} more")
    print(f"{len(names) - differing} of {len(names)} results are the same")
    return differing


def main() -> int:
    """Collect or compare; exit 1 where something is missing or differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    tasks = parser.add_subparsers(dest="task", required=True)
    collecting = tasks.add_parser("collect", help="run the commands of a repository")
    collecting.add_argument("folder", type=Path)
    collecting.add_argument("--tree", type=Path, default=ROOT, help="repository whose commands are run")
    collecting.add_argument("--cases", type=int, default=20, help="generated cases of the gap workflow")
    comparing = tasks.add_parser("compare", help="tell which numbers differ")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument("--within", type=float, default=0.0, help="standard deviations; 0: bit for bit")
    given = parser.parse_args()
    if given.task == "collect":
        return min(1, collect(given.folder.resolve(), given.tree.resolve(), given.cases))
    return min(1, compare(given.before, given.after, given.within))


if __name__ == "__main__":
    sys.exit(main())
