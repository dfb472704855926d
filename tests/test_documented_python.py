"""Python in the documentation: each block of a page runs, each name of an API table can be imported."""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from spool_tools.operations.node_processes import find_executable
from std_msgs.msg import Float64

from .forks import completed

if TYPE_CHECKING:
    from .conftest import System

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ROOT / "ros2_ws" / "src"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.M | re.S)
#: Blocks on this page are files; its recipes have separate tests below.
CONTRIBUTING = ROOT / "CONTRIBUTING.md"
#: Its block is a node, which runs until it is ended.
NODE = PACKAGES / "spool_core" / "spool_core" / "node" / "README.md"
#: Of packages, and of those subpackages that have one.
READMES = sorted([*PACKAGES.glob("*/[A-Z]*.md"), *PACKAGES.glob("*/spool_*/*/README.md")])
PAGES = [
    page
    for page in sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *READMES])
    if "```python" in page.read_text(encoding="utf-8")
]


def blocks(page: Path) -> list[str]:
    return BLOCK.findall(page.read_text(encoding="utf-8"))


def run(arguments: list[str], folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def spool_python(*arguments: str, entered: str = "") -> subprocess.CompletedProcess[str]:
    program = str(find_executable("spool_bringup", "spool"))
    return subprocess.run(
        [program, "python", *arguments], input=entered, capture_output=True, text=True, check=False
    )


def test_spool_python_passes_all_arguments_to_python(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("import sys, spool_gap\nprint(sys.argv[1:])\nsys.exit(3)\n", "utf-8")
    done = spool_python(str(script), "--help", "-x", "record")
    assert (done.returncode, done.stdout) == (3, "['--help', '-x', 'record']\n")
    assert spool_python("-c", "import sys; print(sys.argv[1:])", "--json").stdout == "['--json']\n"
    assert spool_python("-m", "json.tool", "--compact", entered='{"a": 1}').stdout == '{"a":1}\n'
    assert spool_python(entered="print(6 * 7)").stdout == "42\n"


def test_spool_python_refuses_a_script_that_does_not_exist_in_one_line() -> None:
    done = spool_python("no_such.py")
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"spool: no_such\.py: no such script; pass a file, .*\n", done.stderr)


def test_no_page_asks_for_another_interpreter() -> None:
    pages = [CONTRIBUTING, *(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), *READMES]
    found = [
        str(page) for page in pages if re.search(r"\.venv/bin/python|PYTHONPATH=", page.read_text("utf-8"))
    ]
    assert found == []


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            page, marks=[pytest.mark.slow] * (page.parent.name == "notebooks" or page.stem == "python")
        )
        for page in PAGES
        if page != NODE
    ],
    ids=lambda page: f"{page.parent.name}-{page.stem}",
)
def test_the_blocks_of_a_page_run_in_order_as_one_script(page: Path, tmp_path: Path) -> None:
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    script = tmp_path / "pasted.py"
    script.write_text("\n\n".join(blocks(page)), encoding="utf-8")
    done = completed([str(script)], folder=tmp_path, environment=os.environ)
    assert (done.returncode, done.stderr) == (0, "")
    # What a page says that it writes is written.
    for name in re.findall(r'savefig\("(.+?)"\)', script.read_text(encoding="utf-8")):
        assert (tmp_path / name).stat().st_size > 1000


def test_the_node_of_the_page_publishes_once_it_is_active(system: System, tmp_path: Path) -> None:
    (block,) = blocks(NODE)
    script = tmp_path / "thermometer.py"
    script.write_text(block, encoding="utf-8")
    node = subprocess.Popen(
        [sys.executable, str(script), "--ros-args", "-r", "__ns:=/machine"],
        env={**os.environ, "ROS_DOMAIN_ID": str(system.domain_id)},
    )
    try:
        readings = system.listen(Float64, "/machine/reading", latched=True)
        system.until(lambda: readings.heard, "a reading")
        assert readings.heard[0].message.data == 21.5
    finally:
        node.send_signal(signal.SIGINT)
        assert node.wait(timeout=180) == 0


def names_of_tables() -> list[tuple[str, str, str | None]]:
    """Return package, name and the module that the name before it in its cell stands in."""
    found: list[tuple[str, str, str | None]] = []
    for readme in READMES:
        folder = readme.parent.relative_to(PACKAGES)
        package = ".".join(folder.parts[1:] or folder.parts)
        section, api = "", False
        for line in readme.read_text(encoding="utf-8").splitlines():
            section = line if line.startswith("## ") else section
            api = line.startswith("| name |") or (api and line.startswith("|"))
            if section != "## API" or not api or not line.startswith("| `"):
                continue
            module = None
            for written in re.findall(r"`([^`]+)`", line.split(" | ")[0]):
                name = written.partition("(")[0]
                if re.fullmatch(r"[A-Za-z_][\w.]*", name):
                    found.append((package, name, module))
                    module = name.rpartition(".")[0] or module
    return found


def resolved(path: str) -> Any:
    """Return the module or the attribute of a module called ``path``.

    Raises:
        ImportError, AttributeError: there is none.
    """
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        owner, _, name = path.rpartition(".")
        return getattr(importlib.import_module(owner), name)


@pytest.mark.parametrize(("package", "name", "before"), names_of_tables())
def test_a_name_in_an_api_table_can_be_imported(package: str, name: str, before: str | None) -> None:
    """A bare name stands in the module of the name before it in its cell, else in the package."""
    paths = [f"{package}.{name}"] + ([f"{package}.{before}.{name}"] if before and "." not in name else [])
    problems = []
    for path in paths:
        try:
            resolved(path)
        except (ImportError, AttributeError) as error:
            problems.append(f"{path}: {error}")
    assert len(problems) < len(paths), problems


# The recipes of CONTRIBUTING, each applied to a copy as it stands on the page.

FILE = re.compile(r"`(\S+\.(?:py|json))`:\n\n```(?:python|json)\n(.*?)^```$", re.M | re.S)
ROW = re.compile(r"`(\w+)` of\s+`(\S+\.(?:py|json))`$")


def recipes() -> list[str]:
    """Return the sections that add something."""
    text = CONTRIBUTING.read_text(encoding="utf-8")
    return [part for part in re.split(r"^(?=## )", text, flags=re.M) if part.startswith("## Add")]


def apply(recipe: str, copy: Path) -> None:
    """Write the files of a recipe, and put its rows first into the tables that it names."""
    for match in FILE.finditer(recipe):
        file, text = copy / match.group(1), match.group(2)
        table = ROW.search(recipe[: match.end(1) + 1])
        if table is None:
            assert not file.exists(), file
            file.write_text(text, encoding="utf-8")
            continue
        own = file.read_text(encoding="utf-8")
        if file.suffix == ".json":
            entries = json.loads(own)
            entries[table.group(1)] |= json.loads(text)
            file.write_text(json.dumps(entries), encoding="utf-8")
            continue
        head = re.search(rf"^{table.group(1)}\b.* = [(\[{{]\n", own, flags=re.M)
        assert head, f"{file}: no table {table.group(1)}"
        file.write_text(f"{own[: head.end()]}{text.rstrip()},\n{own[head.end() :]}", encoding="utf-8")


@pytest.fixture(scope="module", name="copy")
def _copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources to which every recipe was applied."""
    copy = tmp_path_factory.mktemp("recipes")
    for name in ("conftest.py", "pyproject.toml"):
        shutil.copy(ROOT / name, copy)
    (copy / "tests").mkdir()
    for tool in ("law_mutants.py", "law_mutants.yaml", "test_public_interface.py"):
        shutil.copy(ROOT / "tests" / tool, copy / "tests")
    shutil.copytree(PACKAGES, copy / "ros2_ws/src", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "docs", copy / "docs")
    (copy / "bags").symlink_to(ROOT / "bags")
    for recipe in recipes():
        apply(recipe, copy)
    return copy


def path_of(copy: Path) -> str:
    """Return a module path on which the copy comes before the workspace."""
    own = [str(package) for package in sorted((copy / "ros2_ws/src").glob("spool_*"))]
    return os.pathsep.join([*own, os.environ.get("PYTHONPATH", "")])


def test_each_recipe_is_found_by_its_file(copy: Path) -> None:
    found = run(
        [
            "-c",
            "from spool_sim.terms import TERMS\n"
            "from spool_gap.catalogue import EFFECTS\n"
            "from spool_bag.importing.formats.format import formats\n"
            "from spool_monitor.detectors import KINDS\n"
            "from spool_tools.command import command_modules\n"
            "name = 'progressive_stiffness'\n"
            "print(name in TERMS, name in EFFECTS, 'hot_oil' in KINDS)\n"
            "print('LGX' in [one.name for one in formats()], 'rate' in command_modules())\n",
        ],
        copy,
        PYTHONPATH=path_of(copy),
    )
    assert found.stdout.split() == ["True"] * 5, found.stderr


@pytest.mark.slow
@pytest.mark.parametrize("recipe", recipes(), ids=lambda text: text.splitlines()[0].removeprefix("## "))
def test_the_commands_at_the_end_of_a_recipe_pass(recipe: str, copy: Path) -> None:
    lines = [shlex.split(line)[1:] for line in recipe.splitlines() if line.startswith("    ./spool ")]
    assert "test" in [words[0] for words in lines]
    for what, *words in lines:
        arguments = ["-m", "pytest", "-q", "-p", "no:cacheprovider", *words] if what == "test" else words
        done = run(arguments, copy, PYTHONPATH=path_of(copy))
        assert done.returncode == 0, (words, done.stdout[-3000:], done.stderr[-1000:])
