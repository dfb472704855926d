"""Mutants of the cores: what they change, and that a change that matters is noticed."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

FUNCTION = """
def late(age: float, limit: int = 3) -> bool:
    if age > limit and not quiet:
        count.add(1)
    return age > 0.5
"""


@pytest.fixture(name="tool")
def _tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import mutants  # noqa: PLC0415 - found by the path above

    return mutants


def test_each_mutant_has_one_change_of_a_border_a_condition_a_number_or_an_act(tool: ModuleType) -> None:
    (function,) = ast.parse(FUNCTION).body
    before = ast.unparse(function)
    changes = [tool.difference(before, ast.unparse(one)) for one in tool.altered(function)]
    assert {after for _, after in changes} == {
        "if age > limit or not quiet:",
        "if age >= limit and (not quiet):",
        "if age <= limit and (not quiet):",
        "if age > limit and quiet:",
        "count.add(2)",
        "pass",
        "return age >= 0.5",
        "return age <= 0.5",
        "return age > 0.45",
    }


def test_a_sample_reaches_every_package_and_its_nodes(tool: ModuleType) -> None:
    assert {"spool_fleet", "spool_opcua", "spool_core"} <= set(tool.PACKAGES)
    names = {tool.module_of(path) for package in tool.PACKAGES for path, _, _ in tool.functions(package)}
    assert {"spool_monitor.monitor_node", "spool_view.page_node", "spool.analysis"} <= names


def test_a_sample_is_the_same_for_the_same_seed_and_its_files_are_python(tool: ModuleType) -> None:
    one, other = (tool.drawn(("spool_bag",), 5, seed=3) for _ in range(2))
    assert one == other
    for mutant in one:
        compile(mutant.text, str(mutant.path), "exec")
        assert mutant.text != mutant.path.read_text(encoding="utf-8")


def test_a_wrong_count_of_lost_blocks_is_noticed_and_what_changes_nothing_is_not(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tool.FOLDERS["spool_core"] / "spool_core" / "block_gate.py"
    before, after = (f"missing = block.sequence - last.sequence - {n}\n" for n in (1, 2))
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1
    number = text[: text.index(before)].count("\n") + 1
    mutant = tool.Mutant(path, "", range(number, number + 1), before, after, text.replace(before, after))
    own = "ros2_ws/src/spool_core/test/test_block_gate.py"
    monkeypatch.setattr(tool, "tests_for", lambda *_: [own])
    assert tool.judged(mutant, {}, 60.0).test.startswith(own)
    assert tool.judged(replace(mutant, text=text), {}, 60.0).outcome == "not noticed"
    assert tool.judged(replace(mutant, text="while True: pass"), {}, 1.0).outcome == "cut"
