"""Modules that analyse records need no ROS and nothing that only Linux has; colcon installs all modules."""

from __future__ import annotations

import ast
import re
import runpy
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from spool_evaluation.pictures.structure import Module

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "ros2_ws" / "src"
#: Commands that need no running nodes.
OFFLINE = (
    "check", "compare", "export", "fit", "fleet", "gap", "import", "info", "plan", "recover",
    "replay", "simulate", "valve", "verify", "what_if",
)  # fmt: skip
#: Modules that only run in a node.
NODE = re.compile(r"\.node(\.|$)|_node$|\.messages$")
ROS = re.compile(r"(rcl\w*|\w+_msgs|\w+_interfaces|ament_\w+|launch\w*)(\.|$)")
LINUX = {"fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog"}
#: Knows the differences between systems.
SEAM = "spool_core.system"


@cache
def tree(module: str) -> ast.Module:
    folder = next(SOURCE.parent.glob(f"[as]*/{module.partition('.')[0]}/package.xml")).parent
    path = folder / Path(*module.split("."))
    file = path.with_suffix(".py") if path.with_suffix(".py").is_file() else path / "__init__.py"
    return ast.parse(file.read_text(encoding="utf-8"))


def imported(module: str) -> set[str]:
    """Return the full names that ``module`` imports, anywhere in it."""
    found = set()
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(node.module or "")
    return found


@pytest.fixture(scope="module", name="reached")
def _reached(modules: dict[str, Module]) -> list[str]:
    """Return the modules that the offline commands import, directly or not, nodes left out."""
    waiting = [name for name in modules if re.search(rf"\.({'|'.join(OFFLINE)})_command$", name)]
    assert len(waiting) == len(OFFLINE)
    waiting += ["spool_bringup.program", "spool_design.fmu", "spool_design.setups_run", "spool_rigs.analyse"]
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in found or name not in modules or NODE.search(name):
            continue
        found.add(name)
        waiting += modules[name].imports
    return sorted(found)


def test_no_module_of_the_analysis_imports_ros(modules: dict[str, Module], reached: list[str]) -> None:
    assert len(reached) > 150
    assert [f"{name}: {one}" for name in reached for one in imported(name) if ROS.match(one)] == []
    # A node is loaded by the function that needs it, if at all: without ROS all else of the module works.
    at_start = {
        name: node.module
        for name in reached
        for node in tree(name).body
        if isinstance(node, ast.ImportFrom) and node.module in modules and NODE.search(node.module)
    }
    assert at_start == {}


def test_one_module_of_the_analysis_knows_the_operating_system(reached: list[str]) -> None:
    assert SEAM in reached
    assert [name for name in reached if imported(name) & LINUX] == [SEAM]
    forking = [
        name for name in reached if re.search(r"\bos\.(fork|posix_spawn)|SIGKILL", ast.unparse(tree(name)))
    ]
    assert forking == []


@pytest.mark.parametrize(
    "package",
    sorted(path.parent for path in SOURCE.parent.glob("[as]*/*/setup.py")),
    ids=lambda path: path.name,
)
def test_a_build_without_links_installs_every_module(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As ``colcon build`` does; ``./spool`` builds with links, where a missing folder is not seen."""
    given: dict[str, list[str]] = {}
    monkeypatch.setattr("setuptools.setup", lambda **words: given.update(words))
    monkeypatch.chdir(package)
    runpy.run_path("setup.py")
    folders = {".".join(path.parent.relative_to(package).parts) for path in package.glob("spool*/**/*.py")}
    assert folders - set(given["packages"]) == set()
