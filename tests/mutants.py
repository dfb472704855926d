"""Mutation check: change one operation somewhere and see whether a test of a usual run fails.

    ./spool python tests/mutants.py [--count 100] [--seed 20261129] [--package spool_bag] [--markdown FILE]

A sample, drawn by lines of code from all packages; the seed is the date unless it is given. The tests are
those that the change can reach, wherever they lie: of files that import the module, then of its package,
the cheapest first. They see the package with the change in place of the real one. A mutant that no test
notices is a gap, unless it changes nothing: those are listed in mutants.yaml with their reasons. One whose
tests take longer than --seconds is cut, and counted apart.

Exit code 1 for a survivor that the page of --known does not list, in a function that users' results pass
through: its module is imported, directly or not, by `replay`, `fit`, `gap`, `check` or a node.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cache, cached_property
from pathlib import Path

from mutations import difference, is_text, refusal, replaced, without_effect
from spool_evaluation.changed_tests import Repository
from spool_evaluation.results.page import markdown_table, write_page
from spool_evaluation.results.stale import loaded_by
from spool_report.outputs import suite_version

ROOT = Path(__file__).resolve().parent.parent
WORKSPACE = ROOT / "ros2_ws"
FOLDERS = {path.parent.name: path.parent for path in WORKSPACE.glob("[as]*/spool_*/setup.py")}
PACKAGES = tuple(sorted(FOLDERS))
#: Modules that users' results come from: results pass through whatever these import.
RESULTS = re.compile(r"spool_tools\.commands\.(replay|fit|gap|check)_command|spool_[\w.]+_node")
#: s that a test takes whose time is unknown; of live nodes and of others.
WAITS, COMPUTES = 15.0, 1.0
#: B of memory that tests of a mutant may take: a loop without an end takes all. And how many s they may take
#: for each of processor time: live nodes wait.
MEMORY, WAITING = 6 << 30, 3.0
PYTEST = [sys.executable, "-m", "pytest", "-xq", "--tb=no", "-pas_given", "-pno:xdist"]
OUTCOMES = ("noticed", "without effect", "not noticed", "cut")
HISTORY = ("date", "seed", "version", "drawn", *OUTCOMES)
EQUIVALENT = without_effect(Path(__file__).with_suffix(".yaml"))
REPOSITORY = Repository(ROOT)
PAGE = ROOT / "docs" / "results" / "mutants.md"

BORDERS: dict[type[ast.cmpop], tuple[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq, ast.NotEq),
    ast.NotEq: (ast.Eq, ast.Eq),
    ast.Is: (ast.IsNot, ast.IsNot),
    ast.IsNot: (ast.Is, ast.Is),
    ast.In: (ast.NotIn, ast.NotIn),
    ast.NotIn: (ast.In, ast.In),
}
_TURNED = {ast.Add: ast.Sub, ast.Mult: ast.Div, ast.BitOr: ast.BitAnd}
OPERATORS = {
    **_TURNED, **{after: before for before, after in _TURNED.items()},
    **dict.fromkeys((ast.FloorDiv, ast.Mod), ast.Mult),
}  # fmt: skip


def module_of(path: Path) -> str:
    """Return the name that a module of the sources is imported by."""
    return ".".join(path.relative_to(WORKSPACE).with_suffix("").parts[2:]).removesuffix(".__init__")


@dataclass(frozen=True)
class Mutant:
    """A function with one change: where, the line before and after, and the whole file with it."""

    path: Path
    function: str
    lines: range
    before: str
    after: str
    text: str

    @property
    def package(self) -> str:
        """The ROS package that it lies in."""
        return self.path.relative_to(WORKSPACE).parts[1]

    @property
    def place(self) -> str:
        """Module and function."""
        return f"{module_of(self.path)}.{self.function}"

    @property
    def line(self) -> str:
        """The change as it is listed."""
        return f"{self.before} -> {self.after}"

    @cached_property
    def reason(self) -> str:
        """Why nothing can notice it, empty where something should."""
        return EQUIVALENT.get(self.place, {}).get(self.line, "")


def altered(function: ast.FunctionDef) -> Iterator[ast.FunctionDef]:
    """Yield the function with one change each: operators, borders, constants, a statement left out."""
    left_out = {id(part) for node in ast.walk(function) for part in (*refusal(node), *_annotations(node))}
    for number, node in enumerate(ast.walk(function)):
        if id(node) in left_out or is_text(node) or isinstance(node, ast.arguments | ast.AnnAssign):
            continue
        if isinstance(node, ast.AugAssign | ast.BinOp) and type(node.op) in OPERATORS:
            yield replaced(function, number, "op", None, OPERATORS[type(node.op)]())
        elif isinstance(node, ast.Compare):
            for other in dict.fromkeys(BORDERS[type(node.ops[0])]):
                yield replaced(function, number, "ops", 0, other())
        elif isinstance(node, ast.BoolOp):
            yield replaced(
                function, number, "op", None, ast.Or() if isinstance(node.op, ast.And) else ast.And()
            )
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list"):
                continue
            for place, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                for other in _instead_of(child):
                    yield replaced(function, number, field, place, other)


def _instead_of(child: object) -> Iterator[ast.AST]:
    """Yield what may stand where ``child`` does."""
    if isinstance(child, ast.UnaryOp) and isinstance(child.op, ast.Not | ast.USub):
        yield child.operand
    elif isinstance(child, ast.Constant) and isinstance(child.value, bool):
        yield ast.Constant(not child.value)
    elif isinstance(child, ast.Constant) and isinstance(child.value, int):
        yield ast.Constant(child.value + 1)
    elif isinstance(child, ast.Constant) and isinstance(child.value, float):
        yield ast.Constant(0.9 * child.value if child.value else 0.1)
    elif isinstance(child, ast.AugAssign | ast.Expr | ast.Assign) and _acts(child):
        yield ast.Pass()


def _acts(statement: ast.AugAssign | ast.Expr | ast.Assign) -> bool:
    """Return whether a statement changes something else than a name."""
    if isinstance(statement, ast.Assign):
        return not isinstance(statement.targets[0], ast.Name | ast.Tuple)
    return isinstance(statement, ast.AugAssign) or isinstance(statement.value, ast.Call)


def _annotations(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of a type."""
    for kind in (getattr(node, "returns", None), getattr(node, "annotation", None)):
        if kind is not None:
            yield from ast.walk(kind)


@cache
def functions(package: str) -> list[tuple[Path, str, ast.FunctionDef]]:
    """Return the functions and methods of a package, with their file and name."""
    found = []
    folders = [path.parent for path in FOLDERS[package].glob("spool*/__init__.py")]
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for owner in ast.walk(tree):
            for node in owner.body if isinstance(owner, ast.Module | ast.ClassDef) else ():
                if isinstance(node, ast.FunctionDef):
                    name = node.name if isinstance(owner, ast.Module) else f"{owner.name}.{node.name}"
                    found.append((path, name, node))
    return found


def drawn(packages: tuple[str, ...], count: int, seed: int) -> list[Mutant]:
    """Return a sample of mutants, each function as often as it has lines, each mutant once."""
    source = random.Random(seed)
    all_of_them = [one for package in packages for one in functions(package)]
    weights = [(node.end_lineno or node.lineno) - node.lineno + 1 for _, _, node in all_of_them]
    found: dict[str, Mutant] = {}
    while len(found) < count:
        path, name, node = source.choices(all_of_them, weights)[0]
        choices = list(altered(node))
        if choices:
            one = _mutant(path, name, node, source.choice(choices))
            if one.before != one.after:
                found.setdefault(f"{one.place} {one.line}", one)
    return list(found.values())


def _mutant(path: Path, name: str, node: ast.FunctionDef, other: ast.FunctionDef) -> Mutant:
    first = min([node.lineno, *(one.lineno for one in node.decorator_list)])
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    indent = " " * node.col_offset
    body = "".join(f"{indent}{line}\n" if line else "\n" for line in ast.unparse(other).splitlines())
    text = "".join([*lines[: first - 1], body, *lines[node.end_lineno :]])
    span = range(first, (node.end_lineno or first) + 1)
    return Mutant(path, name, span, *difference(ast.unparse(node), ast.unparse(other)), text)


@dataclass(frozen=True)
class Result:
    """What became of a mutant: one of OUTCOMES, the test that noticed it, s that this took."""

    outcome: str
    test: str = ""
    seconds: float = 0.0


def times_of(report: Path | None) -> dict[str, float]:
    """Return how long each test function took, s, by a report of pytest (``--junitxml``, family xunit1)."""
    found: dict[str, float] = defaultdict(float)
    for case in ET.parse(report).iter("testcase") if report else ():
        found[f"{case.get('file')}::{(case.get('name') or '').partition('[')[0]}"] += float(
            case.get("time", 0)
        )
    return found


def tests_for(mutant: Mutant, times: dict[str, float]) -> list[str]:
    """Return the tests that a mutant can reach: the nearest files first, among them the cheapest."""
    path = mutant.path.relative_to(ROOT)
    own = f"{FOLDERS[mutant.package].relative_to(ROOT)}/test/"
    module = module_of(mutant.path)
    sources = {str(one.path): one for one in REPOSITORY.sources.values()}
    files: dict[str, list[str]] = {}
    # Names that are computed, as those of kernels, lead nowhere: then all tests of the package.
    whole = [file for file in sources if file.startswith(own) and "/test_" in file]
    for one in REPOSITORY.tests_reached({path: [mutant.lines]}) or whole:
        files.setdefault(one.partition("::")[0], []).append(one)

    def place(file: str) -> tuple[int, float]:
        imports = {name for base, what, _ in sources[file].imports for name in (base, f"{base}.{what}")}
        usual = WAITS if file.startswith("tests/") or "/web/" in file or "/node/" in file else COMPUTES
        cost = sum(times.get(one, usual if "::" in one else 30.0 * usual) for one in files[file])
        return (0 if module in imports else 1 if file.startswith(own) else 2), cost

    return [one for file in sorted(files, key=place) for one in files[file]]


def judged(mutant: Mutant, times: dict[str, float], seconds: float) -> Result:
    """Run the tests that a mutant can reach, for ``seconds`` of processor time at most."""
    begun, tests, without = time.monotonic(), tests_for(mutant, times), set[str]()
    while True:
        left = seconds - (time.monotonic() - begun) / WAITING
        rest = [one for one in tests if without.isdisjoint((one, one.partition("::")[0]))]
        failed = _first_failure(mutant, mutant.text, rest, left) if rest else ""
        taken = time.monotonic() - begun
        if failed is None:
            return Result("cut", seconds=taken)
        if not failed:
            return Result("without effect" if mutant.reason else "not noticed", seconds=taken)
        # One that fails without the change as well shows nothing.
        original = mutant.path.read_text(encoding="utf-8")
        if not _first_failure(mutant, original, [failed], seconds):
            return Result("noticed", failed, taken)
        without.add(failed)


def _first_failure(mutant: Mutant, text: str, tests: list[str], seconds: float) -> str | None:
    """Run tests with ``text`` in the mutant's file; return the first that fails, None if they do not end."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (most, most + 5))

    most = max(int(seconds), 1)
    with tempfile.TemporaryDirectory(prefix="spool_mutant_") as folder:
        _overlay(mutant.path, Path(folder), text)
        # The order of the tests is that of the command line: the hook of conftest.py puts long files first.
        (Path(folder) / "as_given.py").write_text(AS_GIVEN, encoding="utf-8")
        path = os.pathsep.join([folder, *filter(None, [os.environ.get("PYTHONPATH", "")])])
        try:
            run = subprocess.run(
                [*PYTEST, *tests],
                cwd=ROOT,
                env={**os.environ, "PYTHONPATH": path},
                preexec_fn=limited,
                capture_output=True,
                text=True,
                check=False,
                timeout=WAITING * most,
            )
        except subprocess.TimeoutExpired:
            return None
    if run.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return None
    if run.returncode in (0, 5):
        return ""
    # Without the case of a test of several: there may be blanks in it.
    found = re.search(r"^(?:FAILED|ERROR) ([^\s\[]+)", run.stdout, re.MULTILINE)
    return found[1] if found else tests[0]


#: A plugin of pytest.
AS_GIVEN = """
import pytest

@pytest.hookimpl(hookwrapper=True)
def pytest_collection_modifyitems(items):
    before = list(items)
    yield
    kept = set(items)
    items[:] = [one for one in before if one in kept]
"""


def _overlay(path: Path, folder: Path, text: str) -> None:
    """Make the package of ``path`` in ``folder``: links to all that it holds, but the file with ``text``."""
    here = FOLDERS[path.relative_to(WORKSPACE).parts[1]]
    for depth, part in enumerate(path.relative_to(here).parts):
        for other in here.iterdir() if depth else ():
            if other.name == "__pycache__":  # a copy, so that the changed file gets none among the others
                shutil.copytree(other, folder / other.name, dirs_exist_ok=True)
            elif other.name != part:
                (folder / other.name).symlink_to(other)
        here, folder = here / part, folder / part
        if here.is_dir():
            folder.mkdir()
    folder.write_text(text, encoding="utf-8")


def listed(one: Mutant) -> str:
    """Return a survivor as a page lists it."""
    return f"- `{one.place}`: `{one.line}`"


def survivors(text: str) -> list[str]:
    """Return the survivors that a page lists and whose code is still there."""
    code = {f"{module_of(path)}.{name}": ast.unparse(node)
            for package in PACKAGES for path, name, node in functions(package)}  # fmt: skip
    found = re.findall(r"^(- `([\w.]+)`: `(.*) -> .*`)$", text, re.MULTILINE)
    idle = {f"- `{place}`: `{line}`" for place, lines in EQUIVALENT.items() for line in lines}
    return [line for line, place, before in found if before in code.get(place, "") and line not in idle]


def page(path: Path, published: str, results: dict[Mutant, Result], seed: int, command: str) -> None:
    """Write the rates of all runs, the shares of this one, and the survivors."""

    def counts(some: list[Result]) -> list[str]:
        found = Counter(one.outcome for one in some)
        return [str(len(some)), *(str(found[name]) for name in OUTCOMES)]

    of = {name: [one for mutant, one in results.items() if mutant.package == name] for name in PACKAGES}
    rows = [[name, *counts(some)] for name, some in of.items() if some]
    earlier = re.findall(r"^\| (\d{4}-\d\d-\d\d \|.*) \|$", published, re.MULTILINE)
    all_of_them = counts(list(results.values()))
    day = datetime.now(timezone.utc).date().isoformat()
    today = [day, str(seed), suite_version(), *all_of_them]
    here = [listed(one) for one, found in results.items() if found.outcome == "not noticed"]
    noticed_now = {listed(one) for one, found in results.items() if found.outcome == "noticed"}
    old = [one for one in survivors(published) if one not in here and one not in noticed_now]
    parts = [
        "One operation of a function changed at a time, drawn at random by lines of code from all packages. "
        "Noticed: a test of a usual run fails. Without effect: nothing can notice it, for the reason in "
        "[tests/mutants.yaml](../../tests/mutants.yaml). Cut: its tests did not end in its time.",
        "## Rate over time",
        markdown_table(HISTORY, [*(row.split(" | ") for row in earlier), today]),
        "## This run",
        markdown_table(("package", "mutants", *OUTCOMES), [*rows, ["all", *all_of_them]]),
        "## Not noticed in this run",
        "\n".join(here) or "None.",
        "## Not noticed in earlier runs",
        "\n".join(old) or "None.",
    ]
    write_page(path, "Mutants", command, parts)


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    day = int(datetime.now(timezone.utc).strftime("%Y%m%d"))
    parser.add_argument("--count", type=int, default=100, help="number of mutants")
    parser.add_argument("--seed", type=int, default=day, help="of the sample (default: the date)")
    parser.add_argument("--package", choices=PACKAGES, help="only mutants of this package")
    parser.add_argument("--seconds", type=float, default=60.0, help="of processor time for one mutant")
    parser.add_argument("--minutes", type=float, default=600.0, help="begin no mutant after this time")
    parser.add_argument(
        "--times",
        type=Path,
        help="report of a usual run: ./spool test -o junit_family=xunit1 --junitxml FILE",
    )
    parser.add_argument("--known", type=Path, default=PAGE, help="page with the known survivors")
    parser.add_argument("--markdown", type=Path, help="write the result to this page as well")
    given = parser.parse_args()
    print(f"seed {given.seed}", flush=True)
    mutants = drawn((given.package,) if given.package else PACKAGES, given.count, given.seed)
    times, end = times_of(given.times), time.monotonic() + 60.0 * given.minutes
    results: dict[Mutant, Result] = {}

    def tried(one: Mutant) -> Result | None:
        return judged(one, times, given.seconds) if time.monotonic() < end else None

    published = given.known.read_text(encoding="utf-8") if given.known.exists() else ""
    users = loaded_by(*filter(RESULTS.match, REPOSITORY.sources))
    new = []
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for number, (mutant, result) in enumerate(zip(mutants, pool.map(tried, mutants), strict=True), 1):
            if result is None:
                continue
            results[mutant] = result
            state = result.test or mutant.reason or result.outcome
            if (
                result.outcome == "not noticed"
                and listed(mutant) not in published
                and module_of(mutant.path) in users
            ):
                new.append(mutant)
                state = "NOT NOTICED, new, in a function that users' results pass through"
            print(
                f"{number}/{len(mutants)} {mutant.place}: {mutant.line}: {state} ({result.seconds:.0f} s)",
                flush=True,
            )
    counted = Counter(one.outcome for one in results.values())
    print(f"{len(results)} mutants: " + ", ".join(f"{counted[name]} {name}" for name in OUTCOMES))
    if given.markdown:
        named = f" --package {given.package}" if given.package else ""
        command = f"./spool python tests/mutants.py --count {given.count} --seed {given.seed}{named}"
        page(given.markdown, published, results, given.seed, command)
    return int(bool(new))


if __name__ == "__main__":
    sys.exit(main())
