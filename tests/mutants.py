"""Mutation check of the cores: change one operation somewhere and see whether a test of its package fails.

    ./spool python tests/mutants.py [--count 60] [--seed 1] [--package spool_bag] [--markdown FILE]

A sample, drawn by lines of code. The tests are those of the package that the change can reach, with a copy of
the package that has the change. A mutant that no test notices is a gap, unless it changes nothing: those are
listed in mutants.yaml with their reasons. Exit code 1 for a mutant that is neither noticed nor listed.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

from mutations import difference, is_text, refusal, replaced, without_effect
from spool_evaluation.changed_tests import Repository
from spool_evaluation.results.page import write_page

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "ros2_ws" / "src"
PACKAGES = ("spool_core", "spool_sim", "spool_estimator", "spool_monitor", "spool_bag", "spool_gap")
#: Not cores: tests of the whole system run them.
NODES = re.compile(r"(_node|/program|/node/.*)\.py$")
#: s, a test that takes longer with a mutant than this does not end.
PATIENCE = 900.0
EQUIVALENT = without_effect(Path(__file__).with_suffix(".yaml"))
REPOSITORY = Repository(ROOT)

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
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}


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
        return self.path.relative_to(SOURCE).parts[0]

    @property
    def place(self) -> str:
        """Module and function."""
        return f"{'.'.join(self.path.relative_to(SOURCE).with_suffix('').parts[1:])}.{self.function}"

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
    """Return the functions and methods of the cores of a package, with their file and name."""
    found = []
    for path in sorted((SOURCE / package / package).rglob("*.py")):
        if NODES.search(path.as_posix()):
            continue
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


def noticed(mutant: Mutant) -> str:
    """Return the test that fails with the mutant and passes without, empty if there is none."""
    own = f"ros2_ws/src/{mutant.package}/test/"
    reached = REPOSITORY.tests_reached({mutant.path.relative_to(ROOT): [mutant.lines]})
    tests = [one for one in reached if one.startswith(own)] or [own]
    with tempfile.TemporaryDirectory() as folder:
        copied = Path(folder) / mutant.package
        shutil.copytree(
            SOURCE / mutant.package / mutant.package, copied, ignore=shutil.ignore_patterns("__pycache__")
        )
        (copied / mutant.path.relative_to(SOURCE / mutant.package / mutant.package)).write_text(mutant.text)
        failed = _first_failure(tests, Path(folder))
    return failed if failed in ("", "no end") or not _first_failure([failed], None) else ""


def _first_failure(tests: list[str], first: Path | None) -> str:
    """Run tests with the modules of ``first`` before others; return the first that fails, if any."""
    path = os.pathsep.join(filter(None, [str(first or ""), os.environ.get("PYTHONPATH", "")]))
    try:
        run = subprocess.run(
            [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "-p", "no:cacheprovider", "--tb=no", *tests],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
    except subprocess.TimeoutExpired:
        return "no end"
    if run.returncode in (0, 5):
        return ""
    # Without the case of a test of several: there may be blanks in it.
    found = re.search(r"^(?:FAILED|ERROR) ([^\s\[]+)", run.stdout, re.MULTILINE)
    return found[1] if found else tests[0]


def page(path: Path, results: dict[Mutant, str], command: str) -> None:
    """Write the shares and the mutants that no test noticed."""
    rows = ["| package | mutants | noticed | without effect | not noticed |", "|---|---|---|---|---|"]
    for package in (*dict.fromkeys(one.package for one in results), ""):
        some = [one for one in results if package in ("", one.package)]
        seen = sum(bool(results[one]) for one in some)
        idle = sum(bool(one.reason) and not results[one] for one in some)
        rows.append(f"| {package or 'all'} | {len(some)} | {seen} | {idle} | {len(some) - seen - idle} |")
    left = [f"- `{one.place}`: `{one.line}`" + (f": {one.reason}" if one.reason else "")
            for one, test in results.items() if not test]  # fmt: skip
    intro = (
        "One operation of a function changed at a time, drawn at random by lines of code from the cores of "
        "these packages (nodes apart). Noticed: a test of the package fails. Without effect: nothing can "
        "notice it, for the reason given below and in [tests/mutants.yaml](../../tests/mutants.yaml)."
    )
    write_page(
        path, "Mutants of the cores", command, [intro, "\n".join(rows), "Not noticed:", "\n".join(left)]
    )


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=60, help="number of mutants")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--package", choices=PACKAGES, help="only mutants of this package")
    parser.add_argument("--markdown", type=Path, help="write the result to this page as well")
    given = parser.parse_args()
    mutants = drawn((given.package,) if given.package else PACKAGES, given.count, given.seed)
    results: dict[Mutant, str] = {}
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for mutant, test in zip(mutants, pool.map(noticed, mutants), strict=True):
            results[mutant] = test
            state = test or (f"without effect: {mutant.reason}" if mutant.reason else "NOT NOTICED")
            print(f"{len(results)}/{len(mutants)} {mutant.place}: {mutant.line}: {state}", flush=True)
    if given.markdown:
        named = f" --package {given.package}" if given.package else ""
        command = f"./spool python tests/mutants.py --count {given.count} --seed {given.seed}{named}"
        page(given.markdown, results, command)
    return int(any(not test and not mutant.reason for mutant, test in results.items()))


if __name__ == "__main__":
    sys.exit(main())
