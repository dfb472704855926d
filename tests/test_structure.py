"""Structure of the source: imports go one way, packages stay of a size."""

from __future__ import annotations

from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

from spool_evaluation.pictures.structure import Module, layers, package_imports, read_modules

SOURCE = Path(__file__).resolve().parent.parent / "ros2_ws" / "src"
#: Needed by developers and studies only.
NOT_ON_A_MACHINE = {"spool_evaluation", "spool_blind"}
MODULES = read_modules(SOURCE)


def within(package: str) -> dict[str, set[str]]:
    """Return which folders of ``package`` import which others of it."""
    found: dict[str, set[str]] = {}
    for module in MODULES.values():
        if module.package != package:
            continue
        imported = {
            MODULES[name].folder for name in module.imports if name.startswith(package) and name in MODULES
        }
        found.setdefault(module.folder, set()).update(imported - {module.folder})
    return found


def test_no_module_imports_itself_through_others() -> None:
    known = {name: module.imports & MODULES.keys() for name, module in MODULES.items()}
    assert len(list(TopologicalSorter(known).static_order())) == len(MODULES)


def test_packages_import_one_way() -> None:
    order = [name for layer in layers(package_imports(MODULES)) for name in layer]
    pillars = [
        "spool_core",
        "spool_sim",
        "spool_gap",
        "spool_estimator",
        "spool_monitor",
        "spool_tools",
    ]
    assert [name for name in order if name in pillars] == pillars


def test_folders_of_a_package_import_one_way() -> None:
    for package in package_imports(MODULES):
        list(TopologicalSorter(within(package)).static_order())


def test_nothing_that_runs_on_a_machine_needs_studies_or_benchmarks() -> None:
    needing = {name for name, wanted in package_imports(MODULES).items() if wanted & NOT_ON_A_MACHINE}
    assert needing <= NOT_ON_A_MACHINE


def test_no_package_outgrows_the_others() -> None:
    lines = Counter[str]()
    for module in MODULES.values():
        lines[module.package] += module.lines
    assert max(lines.values()) < lines.total() / 5


def test_a_cycle_is_seen() -> None:
    modules = {
        name: Module(name, "spool_a", 1, frozenset({other}))
        for name, other in (("spool_a.x", "spool_b.y"), ("spool_b.y", "spool_a.x"))
    }
    imports = package_imports(modules)
    assert imports == {"spool_a": {"spool_b"}, "spool_b": {"spool_a"}}
