"""Tests that a change can reach, by the names that it changes: for the loop of a developer.

    ./spool test --changed [COMMIT]

From a changed definition the search goes to the definitions that use its name, and so on to tests and
fixtures. It follows imports, registries, names of commands, and a list for tests that start programs. It
misses what is found by computed names alone: all tests together decide.
"""

from __future__ import annotations

import ast
import fnmatch
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

from spool_core.errors import InputError

#: Packages whose modules are found by their place: to use the package is to use each of them.
REGISTRIES = (
    "spool_bag.importing.formats",
    "spool_gap.catalogue",
    "spool_monitor.detectors",
    "spool_sim.terms",
)
#: Tests of the whole system start programs: the modules that each file is about, as patterns.
ABOUT: Mapping[str, tuple[str, ...]] = {
    "test_adapter": ("spool_bag.adapter*", "spool_core.sensor_*", "spool_core.aligner", "spool_core.rate_*"),
    "test_alarms": ("spool_monitor.alarm*", "spool_monitor.monitor_node", "spool_monitor.valve_*"),
    "test_command_line": ("spool_tools.cli", "spool_tools.command", "spool_bringup.program", "setup.*"),
    "test_conditions": ("spool_opcua.*", "spool_monitor.listener", "spool_core.opcua_folder"),
    "test_demo": ("spool_tools.operations.demo", "spool_tools.commands.demo_command"),
    "test_play": ("spool_tools.operations.play", "spool_tools.commands.play_command"),
    "test_gap_live": ("spool_estimator.gap_*", "spool_estimator.estimator_node"),
    "test_host": ("spool_bringup.host.*", "spool_core.node.*"),
    "test_killed_nodes": ("spool_*.*_node", "spool_core.node.*"),
    "test_launch": ("spool_bringup.*", "spool_core.node.*"),
    "test_lifecycle": ("spool_core.node.*", "spool_*.*_node"),
    "test_packages": ("spool_bringup.*", "setup.*"),
    "test_recording": ("spool_bag.record*", "spool_bag.parts", "spool_bag.writer", "spool_bag.snapshot"),
    "test_refits": ("spool_estimator.refit*", "spool_estimator.estimator_node"),
    "test_setup": ("setup.*",),
    "test_stream": ("spool_sim.simulator*", "spool_estimator.estimator_node", "spool_estimator.estimator"),
    "test_supervision": ("spool_bringup.host.*", "spool_*.*_node"),
    "test_watch": ("spool_monitor.listener", "spool_tools.operations.live_run"),
    "test_wrong_valve_file": ("spool_estimator.estimator_node", "spool_estimator.plausibility"),
}
#: A module and a name that it defines at its top level.
Place: TypeAlias = tuple[str, str]
ALL = range(1, sys.maxsize)
_HUNK = re.compile(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@", re.MULTILINE)


class Statement:
    """A statement at the top level of a file.

    Attributes:
        defines: names of functions, classes, values, imports and fixtures.
        lines: its lines, decorators included.
        imports: import statements in it, at any depth.
    """

    def __init__(self, node: ast.stmt, in_test: bool) -> None:
        decorators: list[ast.expr] = getattr(node, "decorator_list", [])
        first = min([node.lineno, *(one.lineno for one in decorators)])
        self.lines = range(first, (node.end_lineno or first) + 1)
        self.defines = {str(getattr(node, "name", ""))} - {""}
        self.imports: list[ast.Import | ast.ImportFrom] = []
        self._names: set[str] = set()
        self._attributes: set[tuple[str, str]] = set()
        holds = isinstance(node, ast.Assign | ast.AnnAssign | ast.For | ast.With | ast.If | ast.Try)
        for one in ast.walk(node):
            if isinstance(one, ast.Name):
                self._names.add(one.id)
                if holds and isinstance(one.ctx, ast.Store):
                    self.defines.add(one.id)
            elif isinstance(one, ast.Attribute):
                if isinstance(one.value, ast.Name):
                    self._attributes.add((one.value.id, one.attr))
            elif isinstance(one, ast.Import | ast.ImportFrom):
                self.imports.append(one)
                self._names |= {alias.asname or alias.name for alias in one.names}
            elif isinstance(one, ast.arg) and in_test:
                self._names.add(one.arg)  # a fixture
            elif isinstance(one, ast.Call) and one in decorators and in_test:
                given = [word.value for word in one.keywords if word.arg == "name"]
                self.defines |= {str(word.value) for word in given if isinstance(word, ast.Constant)}
        if isinstance(node, ast.Import | ast.ImportFrom):
            self.defines |= self._names

    def uses(self, name: str, local: set[str], modules: set[str]) -> bool:
        """Return whether it uses one of the names ``local``, or ``name`` of one of ``modules``."""
        return not self._names.isdisjoint(local) or not self._attributes.isdisjoint(
            (module, name) for module in modules
        )


def imported(node: ast.Import | ast.ImportFrom, package: str) -> Iterator[tuple[str, str, str]]:
    """Yield module, name in it (empty: the module itself) and local name of an import in ``package``."""
    if isinstance(node, ast.Import):
        yield from ((one.name, "", one.asname or one.name) for one in node.names)
        return
    above = package.split(".")[: package.count(".") + 2 - node.level] if node.level else []
    base = ".".join([*above, *filter(None, [node.module])])
    yield from ((base, one.name, one.asname or one.name) for one in node.names)


@dataclass
class Source:
    """One Python file: its path in the repository, its dotted name and text."""

    path: Path
    name: str
    text: str

    @property
    def is_test(self) -> bool:
        """Whether it belongs to tests: the names of arguments are fixtures there."""
        return not {"test", "tests"}.isdisjoint(self.path.parts) or self.path.name == "conftest.py"

    @cached_property
    def statements(self) -> list[Statement]:
        """The statements of the top level."""
        return [Statement(one, self.is_test) for one in ast.parse(self.text).body]

    @cached_property
    def imports(self) -> set[tuple[str, str, str]]:
        """Module, name in it (empty: the module itself) and local name of each import, at any depth."""
        package = self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]
        return {each for one in self.statements for node in one.imports for each in imported(node, package)}

    def using(self, place: Place) -> set[str]:
        """Return the names of the top level whose definitions use ``place``."""
        module, name = place
        package = module.rpartition(".")[0]
        own = self.name == module
        # A fixture of a conftest.py is used by its name in all test files below.
        local = {name} if own or (module.endswith("conftest") and self.name.startswith(package)) else set()
        modules: set[str] = set()
        for base, what, here in self.imports:
            if (base, what) == place or (base == package and package in REGISTRIES):
                local.add(here)
            elif f"{base}.{what}".rstrip(".") == module:
                # With its whole name, as in `import a.b`: whatever uses `a`.
                (local if "." in here else modules).add(here.partition(".")[0])
        if not local and not modules:
            return set()
        return {
            other
            for one in self.statements
            if not (own and name in one.defines) and one.uses(name, local, modules)
            for other in one.defines
        }

    def mentioning(self, pattern: re.Pattern[str]) -> set[str]:
        """Return the names of the top level whose definitions contain ``pattern``."""
        lines = [self.text.count("\n", 0, match.start()) + 1 for match in pattern.finditer(self.text)]
        return self.on([range(line, line + 1) for line in lines])

    def on(self, lines: list[range]) -> set[str]:
        """Return the names of the top level that statements on these lines define."""
        found: set[str] = set()
        for one in self.statements if lines else ():
            if any(some.start < one.lines.stop and one.lines.start < some.stop for some in lines):
                # One that defines nothing, as a condition, may change whatever is defined here.
                found |= one.defines or {name for other in self.statements for name in other.defines}
        return found


@dataclass
class Repository:
    """The Python files of a repository that git knows or would add."""

    root: Path

    @cached_property
    def sources(self) -> dict[str, Source]:
        """The files by dotted name."""
        listed = self._git(
            "ls-files", "--cached", "--others", "--exclude-standard", "--", "*.py"
        ).splitlines()
        paths = [path for line in listed if (self.root / (path := Path(line))).is_file()]
        found = [Source(path, _name(path), (self.root / path).read_text(encoding="utf-8")) for path in paths]
        return {one.name: one for one in found}

    def changed_since(self, commit: str) -> dict[Path, list[range]]:
        """Return the files that differ from ``commit``, new ones included, with the lines that changed.

        Raises:
            InputError: there is no such commit.
        """
        try:
            names = self._git("diff", "--name-only", "--no-renames", commit, "--").splitlines()
        except subprocess.CalledProcessError as error:
            raise InputError(f"--changed {commit}: no such commit; git log lists them") from error
        found = {}
        for path in map(Path, names):
            hunks = _HUNK.findall(self._git("diff", "-U0", commit, "--", str(path)))
            found[path] = [range(int(start), int(start) + max(int(count or 1), 1)) for start, count in hunks]
        for new in self._git("ls-files", "--others", "--exclude-standard").splitlines():
            found[Path(new)] = [ALL]
        return found

    def tests_reached(self, changed: Mapping[Path, list[range]]) -> list[str]:
        """Return the tests that a change of these lines can reach, as pytest names them."""
        places: set[Place] = set()
        for path, lines in changed.items():
            source = self.sources.get(_name(path)) if path.suffix == ".py" else None
            if source is None:  # of another kind, or gone
                word = re.compile(re.escape(path.stem if path.suffix == ".py" else path.name))
                places |= {(one.name, name) for one in self.sources.values() for name in one.mentioning(word)}
            elif path.name == "conftest.py":
                below = [
                    one for one in self.sources.values() if one.is_test and path.parent in one.path.parents
                ]
                places |= {(one.name, name) for one in below for name in one.on([ALL])}
            else:
                places |= {(source.name, name) for name in source.on(lines)}
        found = {
            f"{self.sources[module].path}::{name}"
            for module, name in self._with_users(places)
            if name.startswith("test_") and self.sources[module].is_test
        }
        modules = [_name(path) for path in changed if path.suffix == ".py"]
        for test, patterns in ABOUT.items():
            if any(fnmatch.filter(modules, one) for one in patterns):
                whole = f"tests/{test}.py"
                found = {one for one in found if not one.startswith(f"{whole}::")} | {whole}
        return sorted(found)

    def _with_users(self, waiting: set[Place]) -> set[Place]:
        """Return the places and whatever uses them, directly or not."""
        found: set[Place] = set()
        while waiting:
            place = module, name = waiting.pop()
            found.add(place)
            registered = module.rpartition(".")[0] in REGISTRIES
            for source in self.sources.values():
                if registered or name in source.text:
                    waiting |= {(source.name, one) for one in source.using(place)} - found
            if command := re.search(r"\.commands\.(\w+)_command$", module):
                called = re.compile(rf'\w\(\[?"{command[1]}"[,\]]')
                tests = (source for source in self.sources.values() if source.is_test)
                waiting |= {(one.name, test) for one in tests for test in one.mentioning(called)} - found
        return found

    def _git(self, *words: str) -> str:
        return subprocess.run(
            ["git", *words], cwd=self.root, capture_output=True, text=True, check=True
        ).stdout


def _name(path: Path) -> str:
    """Return the name that a module is imported by; of a test its path with dots."""
    parts = path.with_suffix("").parts
    if "test" not in parts:
        parts = parts[3:] if parts[:1] == ("ros2_ws",) else parts[parts[0] == "research" :]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
