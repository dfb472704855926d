"""Structure of the source: packages by lines, layered by what they import, as a picture and for its test.

python -m spool_evaluation.pictures.structure ros2_ws/src ros2_ws/addons docs/pictures/structure.png
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle

from spool_evaluation.changed_tests import imported

PREFIX = "spool"
#: Not a Python package, so imported without a source here.
MESSAGES = "spool_msgs"


@dataclass(frozen=True, slots=True)
class Module:
    """Dotted ``name``, ``folder`` (the package it lies in), lines, and the modules it imports."""

    name: str
    folder: str
    lines: int
    imports: frozenset[str]

    @property
    def package(self) -> str:
        """Name of the ROS package."""
        return self.name.partition(".")[0]


def read_modules(*sources: Path) -> dict[str, Module]:
    """Return every module below ``sources`` by name, imports of any kind included.

    Args:
        sources: folders that hold packages, or, as a workspace's ``src``, folders of packages.
    """
    files = {}
    for source in sources:
        inits = [*source.glob(f"{PREFIX}*/__init__.py"), *source.glob(f"{PREFIX}*/{PREFIX}*/__init__.py")]
        tops = {init.parent for init in inits if not (init.parent.parent / "__init__.py").exists()}
        for top, path in sorted((folder, path) for folder in tops for path in folder.rglob("*.py")):
            parts = path.relative_to(top.parent).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    modules = {}
    for name, path in files.items():
        folder = name if path.name == "__init__.py" else name.rpartition(".")[0]
        text = path.read_text(encoding="utf-8")
        found = _imports(ast.parse(text), folder, files.keys())
        modules[name] = Module(name, folder, text.count("\n"), frozenset(found - {name}))
    return modules


def _imports(tree: ast.Module, folder: str, known: Iterable[str]) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = ((base, f"{base}.{name}") for base, name, _ in imported(node, folder))
            found |= {full if full in known else base for base, full in names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found |= {str(one.value) for one in node.args[:1] if isinstance(one, ast.Constant)}
    return {name for name in found if name.startswith(PREFIX)}


def package_imports(modules: Mapping[str, Module]) -> dict[str, set[str]]:
    """Return which packages each package imports, without messages."""
    found: dict[str, set[str]] = {module.package: set() for module in modules.values()}
    for module in modules.values():
        found[module.package] |= {name.partition(".")[0] for name in module.imports}
    return {name: wanted - {name, MESSAGES} for name, wanted in found.items()}


def layers(imports: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the packages in layers: each imports only from layers before its own.

    Raises:
        graphlib.CycleError: packages import each other.
    """
    order = TopologicalSorter(imports)
    order.prepare()
    found = []
    while order.is_active():
        ready = sorted(order.get_ready())
        found.append(ready)
        order.done(*ready)
    return found


def draw(sources: Iterable[Path], picture: Path) -> None:
    """Draw the packages below ``sources``: width by lines, arrows to what is imported and not implied."""
    modules = read_modules(*sources)
    lines = {name: sum(module.lines for module in modules.values() if module.package == name)
             for name in package_imports(modules)}  # fmt: skip
    imports = package_imports(modules)
    rows = layers(imports)
    figure = Figure(figsize=(9.0, 1.15 * len(rows) + 0.6))
    axes = figure.subplots()
    boxes = {}
    for level, row in enumerate(rows):
        for place, name in enumerate(row):
            width = 2.0 + lines[name] / 6000.0
            left = (place - (len(row) - 1) / 2.0) * 4.2 - width / 2.0
            boxes[name] = (left + width / 2.0, level)
            axes.add_patch(
                Rectangle((left, level - 0.26), width, 0.52, fill=True, fc="#dbe6f0", ec="#1f3b57", zorder=2)
            )
            folders = len({module.folder for module in modules.values() if module.package == name})
            text = f"{name}\n{lines[name]} lines, {folders} folder{'s' if folders > 1 else ''}"
            axes.text(left + width / 2.0, level, text, ha="center", va="center", fontsize=7.5, zorder=3)
    for name, wanted in imports.items():
        indirect = {below for other in wanted for below in _below(other, imports)}
        for other in wanted - indirect:
            (x, y), (x_other, y_other) = boxes[name], boxes[other]
            axes.add_patch(
                FancyArrowPatch(
                    (x, y - 0.27),
                    (x_other, y_other + 0.27),
                    arrowstyle="-|>",
                    mutation_scale=9,
                    color="#5a5a5a",
                )
            )
    axes.set_xlim(-6.6, 6.6)
    axes.set_ylim(-0.5, len(rows) - 0.5)
    axes.set_axis_off()
    axes.set_title(f"Packages: {sum(lines.values())} lines; arrows lead to what is imported", fontsize=9)
    figure.savefig(picture, dpi=130, bbox_inches="tight")


def _below(name: str, imports: Mapping[str, set[str]]) -> set[str]:
    return {name for other in imports[name] for name in {other, *_below(other, imports)}}


if __name__ == "__main__":
    draw(map(Path, sys.argv[1:-1]), Path(sys.argv[-1]))
