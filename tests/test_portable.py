"""Modules that analyse records need no ROS and nothing that only Linux has; colcon installs all modules."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from spool_evaluation.pictures.structure import read_modules

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "ros2_ws" / "src"
MODULES = read_modules(SOURCE)
#: Commands that need no running nodes.
OFFLINE = (
    "check", "compare", "export", "fit", "fleet", "gap", "import", "info", "layout", "plan", "recover",
    "replay", "simulate", "valve", "verify",
)  # fmt: skip
#: Modules that only run in a node.
NODE = re.compile(r"\.node(\.|$)|_node$|\.messages$")
ROS = re.compile(r"(rcl\w*|\w+_msgs|\w+_interfaces|ament_\w+|launch\w*)(\.|$)")
LINUX = {"fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog"}
#: Knows the differences between systems.
SEAM = "spool_core.system"


def tree(module: str) -> ast.Module:
    path = SOURCE / module.partition(".")[0] / Path(*module.split("."))
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


def imports_node_at_start(module: str) -> bool:
    return any(
        isinstance(node, ast.ImportFrom) and node.module in MODULES and NODE.search(node.module)
        for node in tree(module).body
    )


def reached() -> set[str]:
    """Return the modules that the offline commands import, directly or not, nodes left out."""
    waiting = [name for name in MODULES if re.search(rf"\.commands\.({'|'.join(OFFLINE)})_command$", name)]
    assert len(waiting) == len(OFFLINE)
    waiting.append("spool_bringup.program")
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in found or name not in MODULES or NODE.search(name):
            continue
        found.add(name)
        waiting += MODULES[name].imports
    return found


REACHED = reached()


def test_no_module_of_the_analysis_imports_ros() -> None:
    assert len(REACHED) > 150
    assert [f"{name}: {one}" for name in sorted(REACHED) for one in imported(name) if ROS.match(one)] == []
    # A node is loaded by the function that needs it, if at all: without ROS all else of the module works.
    assert [name for name in sorted(REACHED) if imports_node_at_start(name)] == []


def test_one_module_of_the_analysis_knows_the_operating_system() -> None:
    assert SEAM in REACHED
    assert {name for name in REACHED if imported(name) & LINUX} == {SEAM}
    forking = {
        name for name in REACHED if re.search(r"\bos\.(fork|posix_spawn)|SIGKILL", ast.unparse(tree(name)))
    }
    assert forking == set()


@pytest.mark.parametrize(
    "package", sorted(path.parent for path in SOURCE.glob("*/setup.py")), ids=lambda path: path.name
)
def test_a_build_without_links_installs_every_module(package: Path) -> None:
    """As ``colcon build`` does; ``./spool`` builds with links, where a missing folder is not seen."""
    listed = subprocess.run(
        [sys.executable, "-c", "import runpy, setuptools; setuptools.setup = lambda **given: "
         "print(*given['packages'], sep='\\n'); runpy.run_path('setup.py')"],
        cwd=package, capture_output=True, text=True, check=True,
    )  # fmt: skip
    folders = {".".join(path.parent.relative_to(package).parts) for path in package.glob("spool*/**/*.py")}
    assert folders - set(listed.stdout.split()) == set()
