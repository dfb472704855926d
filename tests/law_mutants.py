"""Mutation check of the laws: change one operation of a law at a time and check that a reference value fails.

    ./spool python tests/law_mutants.py [--only TEXT] [--every N] [--markdown FILE]

Each law, effect, excitation, sensor and oil is changed in every way that a typing error could: its result by
10 % or in sign, a term or a factor left out, an operator, an exponent, a number, a comparison, or a parameter
exchanged for another. The tests of the reference values run against each mutant. A mutant that no test
notices is a gap in those tests: exit 1. Changes without effect are listed with reasons in law_mutants.yaml.
"""

from __future__ import annotations

import os

os.environ["NUMBA_DISABLE_JIT"] = "1"  # before anything is imported: mutants are interpreted

import argparse
import ast
import functools
import importlib
import importlib.util
import inspect
import itertools
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from mutations import changed, difference, without_effect

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "ros2_ws" / "src"
SIMULATION = "spool_sim/test/test_reference_values.py"
EFFECTS = "spool_gap/test/test_reference_values.py"
ESTIMATES = "spool_estimator/test/test_reference_values.py"
#: Functions that hold no law: texts, checks of settings, what a search tries, and the optimiser of phases.
NOT_LAWS = {
    "_low_crest_phases", "_samples", "shapes", "guesses", "sensible", "unknowns",
    "Recorded.highest_frequency", "laws", "slides", "jumps", "uncompiled", "start_for",
    "check", "term", "found", "load_sensors", "trials", "on_the_machine", "to_check", "law",
    "numbers", "is_friction", "__init_subclass__", "__post_init__", "function", "arguments", "imported",
    "call", "taking", "terms", "_term", "fitted", "amplitudes", "_courses",
    "stop_unknowns", "drift_unknowns", "line_unknowns", "soft", "impossible", "alike", "no_excess",
}  # fmt: skip
#: Modules with laws, and the file of tests that holds their values.
MODULES: dict[str, str] = {
    **{
        f"spool_sim.terms.{path.stem}": SIMULATION
        for path in sorted((SOURCE / "spool_sim/spool_sim/terms").glob("*.py"))
        if path.stem != "__init__"
    },
    "spool_sim.valve": SIMULATION,
    "spool_sim.lubrication": SIMULATION,
    "spool_sim.sensors": SIMULATION,
    "spool_sim.excitation": SIMULATION,
    **{
        f"spool_gap.catalogue.{path.stem}": EFFECTS
        for path in sorted((SOURCE / "spool_gap/spool_gap/catalogue").glob("*.py"))
        if path.stem != "__init__"
    },
    "spool_gap.effect": EFFECTS,
    "spool_estimator.identification.chain": EFFECTS,
    "spool_estimator.identification.spectra": EFFECTS,
    "spool_estimator.estimator": ESTIMATES,
}
#: Of a module only these functions are laws; all but NOT_LAWS elsewhere.
ONLY = {
    "spool_sim.valve": {
        "viscous_coefficient", "likely_viscous_coefficient", "likely_spool_mass", "dynamic_viscosity_at",
        "at", "natural_frequency", "damping_ratio",
        "kinematic_viscosity", "_double_logarithm",
    },
    "spool_sim.lubrication": {"_fill", "fluid_friction_coefficient", "ratio"},
    "spool_sim.excitation": {
        "_band", "_continued", "_in_order", "_integral", "_one_list", "_ramp", "_steady", "_turns",
        "acceleration", "duration", "frequencies", "highest_frequency", "revolutions", "rise",
        "steps", "sum_of_lines", "turns_to_sine",
    },
    "spool_estimator.identification.chain": {"high_pass", "low_pass", "mode"},
    "spool_estimator.identification.spectra": {
        "_rise", "apply", "delayed", "gain", "relative_motion",
        "settling",
    },
    "spool_estimator.estimator": {"_derived"},
}  # fmt: skip


EQUIVALENT = without_effect(Path(__file__).with_suffix(".yaml"))


@dataclass(frozen=True)
class Mutant:
    """A function of a module with one change.

    Attributes:
        module, function: where.
        before, after: the line that is changed.
        code: compiles what it runs instead.
        target: the function itself.
    """

    module: str
    function: str
    before: str
    after: str
    code: Callable[[], types.CodeType]
    target: types.FunctionType

    @property
    def place(self) -> str:
        """Module and function, without the package."""
        return f"{self.module.rpartition('.')[2]}.{self.function}"

    @property
    def line(self) -> str:
        """What it writes; of a condition that is always or never met the one before it as well."""
        always = self.after in ("if True:", "if False:")
        return f"{self.before} -> {self.after}" if always else self.after


# From source to mutants, and whether a test notices.


def mutants_of(name: str) -> Iterator[Mutant]:
    """Yield the mutants of a module, each once."""
    module = importlib.import_module(name)
    tree = ast.parse(inspect.getsource(module))
    chosen = ONLY.get(name)
    for owner, definition in _functions(tree):
        place = definition.name if owner is None else f"{owner}.{definition.name}"
        if {definition.name, place} & NOT_LAWS or (chosen is not None and definition.name not in chosen):
            continue
        target = _function(module, owner, definition.name)
        if target is None:
            continue
        seen = {ast.unparse(definition)}
        for other in changed(definition):
            text = ast.unparse(other)
            if text in seen:
                continue
            seen.add(text)
            code = functools.partial(_compiled, tree, definition, other, target)
            yield Mutant(name, place, *difference(ast.unparse(definition), text), code, target)


def _functions(tree: ast.Module) -> Iterator[tuple[str | None, ast.FunctionDef]]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            yield None, node
        elif isinstance(node, ast.ClassDef):
            for member in node.body:
                abstract = isinstance(member, ast.FunctionDef) and "abstractmethod" in ast.unparse(member)
                if isinstance(member, ast.FunctionDef) and not abstract and not _checks(member):
                    yield node.name, member


def _checks(function: ast.FunctionDef) -> bool:
    """Return whether a method only checks the settings of its class."""
    return any("validator" in ast.unparse(one) for one in function.decorator_list)


def _function(module: types.ModuleType, owner: str | None, name: str) -> types.FunctionType | None:
    """Return the plain function behind a name, whatever decorates it."""
    found: Any = vars(module if owner is None else getattr(module, owner)).get(name)
    if isinstance(found, property):
        found = found.fget
    elif isinstance(found, functools.cached_property):
        found = found.func
    elif isinstance(found, (staticmethod, classmethod)):
        found = found.__func__
    found = inspect.unwrap(found) if callable(found) else None
    return found if isinstance(found, types.FunctionType) else None


def _compiled(
    tree: ast.Module, definition: ast.FunctionDef, changed: ast.FunctionDef, target: types.FunctionType
) -> types.CodeType:
    """Return the code of the changed function, compiled where it stands in its module."""
    place = next(
        (body, body.index(definition))
        for body in (tree.body, *(node.body for node in tree.body if isinstance(node, ast.ClassDef)))
        if definition in body
    )
    body, index = place
    body[index] = changed
    try:
        whole = compile(tree, target.__code__.co_filename, "exec")
    finally:
        body[index] = definition
    found = _code(whole, target.__code__.co_name, definition.lineno)
    assert found is not None
    return found


def _code(code: types.CodeType, name: str, line: int) -> types.CodeType | None:
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            if constant.co_name == name and constant.co_firstlineno <= line + 1 and _holds(constant, line):
                return constant
            inner = _code(constant, name, line)
            if inner is not None:
                return inner
    return None


def _holds(code: types.CodeType, line: int) -> bool:
    """Whether a code begins at ``line``, or at a decorator above it."""
    return line - 8 <= code.co_firstlineno <= line


def load_tests(path: str) -> list[Callable[[], None]]:
    """Return the tests of a file as functions without arguments, parametrised ones once for each set."""
    name = path.replace("/", "_").removesuffix(".py")
    spec = importlib.util.spec_from_file_location(name, SOURCE / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    tests: list[Callable[[], None]] = []
    for label, function in vars(module).items():
        if label.startswith("test_"):
            tests += [functools.partial(function, **given) for given in _given(function)]
    return tests


def _given(function: Any) -> Iterator[dict[str, Any]]:
    marks = [mark for mark in getattr(function, "pytestmark", []) if mark.name == "parametrize"]
    sets = []
    for mark in marks:
        names = mark.args[0] if isinstance(mark.args[0], (list, tuple)) else mark.args[0].split(",")
        one = len(names) == 1
        sets.append([dict(zip(names, (row,) if one else row, strict=True)) for row in mark.args[1]])
    for combination in itertools.product(*sets):
        yield {name: value for part in combination for name, value in part.items()}


def survives(mutant: Mutant, tests: list[Callable[[], None]]) -> bool:
    """Return whether all ``tests`` pass with the mutant; the one that fails comes first next time."""
    original = mutant.target.__code__
    mutant.target.__code__ = mutant.code()
    try:
        for place, test in enumerate(tests):
            try:
                test()
            except (Exception, pytest.fail.Exception):  # whatever the change breaks
                tests.insert(0, tests.pop(place))
                return False
    finally:
        mutant.target.__code__ = original
    return True


@dataclass
class Count:
    """Mutants of one module, and the lines of those that are listed as equivalent."""

    made: int = 0
    noticed: int = 0
    equivalent: int = 0


def run(only: str, every: int, first: int = 0) -> tuple[dict[str, Count], list[str]]:
    """Return the counts by module, and complaints: unnoticed mutants, and listed ones that are noticed."""
    suites = {path: load_tests(path) for path in sorted(set(MODULES.values()))}
    for test in itertools.chain.from_iterable(suites.values()):
        test()
    counts: dict[str, Count] = {}
    wrong = []
    unused = {(place, line) for place, lines in EQUIVALENT.items() for line in lines}
    number = 0
    for name, path in MODULES.items():
        if only not in name:
            continue
        count = counts.setdefault(name, Count())
        for mutant in mutants_of(name):
            number += 1
            if number % every != first:
                continue
            listed = mutant.line in EQUIVALENT.get(mutant.place, {})
            alive = survives(mutant, suites[path])
            unused.discard((mutant.place, mutant.line))
            count.made += 1
            count.equivalent += listed
            count.noticed += not alive
            if alive != listed:
                state = "listed as equivalent, but a test notices it" if listed else "no test notices it"
                wrong.append(f"{mutant.place}: {mutant.before} -> {mutant.after}: {state}")
    if not only and every == 1:
        wrong += [f"{place}: {line}: listed as equivalent, but no such mutant" for place, line in unused]
    return counts, wrong


def table(counts: dict[str, Count]) -> str:
    """Return the counts as a table."""
    rows = ["| module | mutants | noticed | equivalent |", "|---|---|---|---|"]
    for name, count in counts.items():
        rows.append(f"| `{name}` | {count.made} | {count.noticed} | {count.equivalent} |")
    totals = [
        sum(getattr(count, what) for count in counts.values()) for what in ("made", "noticed", "equivalent")
    ]
    return "\n".join([*rows, "| all | " + " | ".join(map(str, totals)) + " |"])


def write(page: Path, counts: dict[str, Count]) -> None:
    """Write the result page: the table, and why nothing can notice the equivalent mutants."""
    from spool_evaluation.results.page import write_page  # noqa: PLC0415 - loads most of the suite

    intro = (
        "Each law, effect, excitation, sensor and oil is changed one operation at a time: its result by 10 % "
        "or in sign, a term or factor left out, an operator, exponent, number, comparison or parameter "
        "exchanged. "
        "Noticed: a test of the reference values fails (`test_reference_values.py` of "
        "[spool_sim](../../ros2_ws/src/spool_sim/test), [spool_gap](../../ros2_ws/src/spool_gap/test) and "
        "[spool_estimator](../../ros2_ws/src/spool_estimator/test)). "
        "Equivalent: the change has no effect; each is listed with its reason in "
        "[tests/law_mutants.yaml](../../tests/law_mutants.yaml)."
    )
    write_page(page, "Mutants of the laws", "./spool python tests/law_mutants.py", [intro, table(counts)])


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="modules whose name contains this text")
    parser.add_argument("--every", type=int, default=1, help="every N-th mutant only")
    parser.add_argument("--first", type=int, default=0, help="of every N-th one that with this rest")
    parser.add_argument("--markdown", type=Path, help="write the counts to this page as well")
    given = parser.parse_args()
    counts, wrong = run(given.only, given.every, given.first)
    print(table(counts))
    for line in wrong:
        print(line, file=sys.stderr)
    if given.markdown:
        write(given.markdown, counts)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
