"""Structure of the source: imports go one way, and what makes code hard to take over may only shrink.

    ./spool python tests/test_structure.py [COMMIT]

prints what is counted, lowers the limits to it, and lists the packages that grew since ``COMMIT`` (default:
the last tag).
"""

from __future__ import annotations

import ast
import math
import re
import subprocess
import sys
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path
from typing import TypeAlias

import pytest
from spool_evaluation.pictures.structure import Module, layers, package_imports, read_modules

Modules: TypeAlias = dict[str, Module]

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "ros2_ws" / "src"
#: Needed by developers and studies only: not in the workspace.
RESEARCH = {path.parent.name for path in (ROOT / "research").glob("*/__init__.py")}
#: What was measured. A limit is only lowered: a feature is paid by a removal in the same change.
RATCHETS = {
    "lines": 83_653,
    "lines of code": 53_371,
    "files": 372,
    "lines of research": 11_500,
    "lines up to the last import, %": 8.04,
    "private functions with one caller, %": 15.32,
    "modules with one importer, %": 11.89,
}


def source_files() -> list[Path]:
    """Return every file of what users run: packages, launch files and set-up, without tests."""
    folders = (*SOURCE.glob("spool_*"), *SOURCE.parent.glob("addons/spool_*"), ROOT / "setup")
    return [path for folder in folders for path in folder.rglob("*.py") if "test" not in path.parts]


def code_lines(tree: ast.Module, text: str) -> int:
    """Return the lines that hold code, without blanks, comments, docstrings and imports."""
    rows = enumerate((line.strip() for line in text.splitlines()), 1)
    kept = {number for number, line in rows if line and not line.startswith("#")}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom) or (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            kept -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(kept)


def counted(modules: Modules) -> dict[str, float]:
    """Return what can be counted without running anything."""
    paths = source_files()
    functions = helpers = until = lines = code = 0
    for path in paths:
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        lines += text.count("\n")
        code += code_lines(tree, text)
        heads = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
        until += (heads[-1].end_lineno or 0) if heads else 0
        named = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
        named.update(node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                functions += 1
                helpers += node.name[0] == "_" and node.name[:2] != "__" and named[node.name] == 1
    product = {name for name, module in modules.items() if module.package not in RESEARCH}
    importers = Counter(name for own in product for name in modules[own].imports)
    imported = [importers[name] for name in product if importers[name]]
    return {
        "lines": lines,
        "lines of code": code,
        "files": len(paths),
        "lines of research": sum(module.lines for module in modules.values() if module.package in RESEARCH),
        "lines up to the last import, %": 100 * until / lines,
        "private functions with one caller, %": 100 * helpers / functions,
        "modules with one importer, %": 100 * imported.count(1) / len(product),
    }


def test_what_makes_code_hard_to_take_over_only_shrinks(modules: Modules) -> None:
    found = counted(modules)
    grown = {name: (value, RATCHETS[name]) for name, value in found.items() if value > RATCHETS[name]}
    assert not grown, "name: (now, at most)"


def test_no_module_imports_itself_through_others(modules: Modules) -> None:
    known = {name: module.imports & modules.keys() for name, module in modules.items()}
    assert len(list(TopologicalSorter(known).static_order())) == len(modules)


def test_packages_import_one_way(modules: Modules) -> None:
    order = [name for layer in layers(package_imports(modules)) for name in layer]
    pillars = [
        *("spool_core", "spool_sim", "spool_estimator", "spool_gap"),
        *("spool_monitor", "spool_report", "spool_tools"),
    ]
    assert [name for name in order if name in pillars] == pillars


def test_nothing_that_runs_on_a_machine_needs_studies_or_benchmarks(modules: Modules) -> None:
    assert sorted(RESEARCH) == ["spool_blind", "spool_evaluation", "spool_operation"]
    imports = package_imports(modules)
    assert not [name for name, wanted in imports.items() if name not in RESEARCH and wanted & RESEARCH]


def test_of_the_core_only_the_shell_of_nodes_imports_ros() -> None:
    core = SOURCE / "spool_core" / "spool_core"
    importing = {
        path.relative_to(core).parts[0]
        for path in core.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
        if name.split(".")[0].startswith("rcl") or name.split(".")[0].endswith(("_msgs", "_interfaces"))
    }
    assert importing == {"node"}


def test_no_package_outgrows_the_others(modules: Modules) -> None:
    lines = Counter[str]()
    for module in modules.values():
        if module.package not in RESEARCH:
            lines[module.package] += module.lines
    assert max(lines.values()) < lines.total() / 5


def test_a_test_that_takes_random_examples_inside_is_marked_for_the_nightly_search() -> None:
    unmarked = [
        f"{path.relative_to(ROOT)}::{test.name}"
        for folder in (ROOT / "tests", ROOT / "research" / "test", *SOURCE.glob("*/test"))
        for path in folder.rglob("test_*.py")
        for test in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(test, ast.FunctionDef)
        and test.name.startswith("test_")
        and not any("mark.fuzz" in ast.unparse(one) for one in test.decorator_list)
        and any(
            ast.unparse(one).startswith(("given(", "hypothesis.given("))
            for inner in ast.walk(test)
            if isinstance(inner, ast.FunctionDef) and inner is not test
            for one in inner.decorator_list
        )
    ]
    assert unmarked == []


@pytest.mark.parametrize(("words", "minutes"), [((), 150), (("--weekly",), 600)])
def test_the_limits_of_the_nightly_steps_fit_into_its_time(words: tuple[str, ...], minutes: int) -> None:
    done = subprocess.run(
        [ROOT / ".ci/nightly", *words, "--plan"], capture_output=True, text=True, check=True
    )
    limits = [int(line.split()[0]) for line in done.stdout.splitlines()]
    assert len(limits) >= 10
    assert sum(limits) <= minutes


def test_a_cycle_is_seen() -> None:
    modules = {
        name: Module(name, "spool_a", 1, frozenset({other}))
        for name, other in (("spool_a.x", "spool_b.y"), ("spool_b.y", "spool_a.x"))
    }
    imports = package_imports(modules)
    assert imports == {"spool_a": {"spool_b"}, "spool_b": {"spool_a"}}


def lower_limits(found: dict[str, float]) -> None:
    """Write what is ``found`` into this file where it is below its limit."""
    path = Path(__file__)
    text = path.read_text(encoding="utf-8")
    for name, value in found.items():
        percent = isinstance(RATCHETS[name], float)
        new = math.ceil(100 * value - 1e-9) / 100 if percent else value
        print(f"{name:36} {value:10.2f}   limit {RATCHETS[name]}")
        if new < RATCHETS[name]:
            shown = f"{new:.2f}" if percent else f"{new:_}"
            text = re.sub(rf'("{re.escape(name)}": )[\d_.]+', rf"\g<1>{shown}", text, count=1)
    path.write_text(text, encoding="utf-8")


def print_growth(commit: str) -> None:
    """Print the packages of users that have more lines of source than at ``commit``."""
    asked = ["git", "diff", "--numstat", commit, "--", "ros2_ws/src", "ros2_ws/addons", "setup"]
    grown = Counter[str]()
    for line in subprocess.run(
        asked, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines():
        added, removed, name = line.split("\t")
        parts = Path(name).parts
        if name.endswith(".py") and "test" not in parts:
            grown[parts[2] if parts[0] == "ros2_ws" else parts[0]] += int(added) - int(removed)
    print(f"since {commit}: {grown.total():+} lines")
    for package, lines in grown.most_common():
        if lines > 0:
            print(f"  {package} {lines:+}")


if __name__ == "__main__":
    lower_limits(counted(read_modules(SOURCE, SOURCE.parent / "addons", ROOT / "research")))
    latest = subprocess.run(
        ["git", "describe", "--tags", "--abbrev=0"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    reference = next(iter(sys.argv[1:]), latest.stdout.strip())
    if reference:
        print_growth(reference)
