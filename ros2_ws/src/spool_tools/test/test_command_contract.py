"""Contract of every command, wherever its module lies."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import pytest
from spool_tools import command as command_group
from spool_tools.cli import app, main
from spool_tools.command import OPTION_PANELS, command_modules, declaration
from typer.main import get_command

HERE = Path(__file__).resolve()
#: Tables of commands: of this package, and of the add-ons that have one.
READMES = [HERE.parents[1] / "README.md", *HERE.parents[3].glob("addons/spool_design/README.md")]


@pytest.fixture(scope="module", name="group")
def _group() -> Any:
    """The group of commands, with every command loaded."""
    group: Any = get_command(app)
    group.list_commands(None)
    return group


@pytest.mark.parametrize("name", command_modules())
def test_help_shows_examples_that_are_parsed(name: str, group: Any) -> None:
    examples = [line.strip() for line in group.commands[name].help.splitlines() if "Example:" in line]
    assert examples
    for example in examples:
        words = example.removeprefix("Example: ./spool ").split()
        assert words[0] == name
        group.commands[name].make_context(name, words[1:])


@pytest.mark.parametrize("name", command_modules())
def test_panels_of_help_are_in_one_order(name: str, group: Any) -> None:
    """Each option of a command stands in a panel that other commands have."""
    options = [one for one in group.commands[name].params if one.param_type_name == "option"]
    places = [OPTION_PANELS.index(one.rich_help_panel) for one in options]
    assert places == sorted(places)


@pytest.mark.parametrize("name", command_modules())
def test_nonsense_is_one_line_on_stderr_and_2(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    # What follows a node or a script is passed on: there the node or the script is the nonsense.
    passed_on = {"run": ["no_such_package", "node"], "python": ["no_such_script.py"]}
    assert main([name, *passed_on.get(name, ["--no-such-option"])]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("spool: ")
    assert said.err.count("\n") == 1


def test_a_file_that_ends_early_is_no_interruption(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def cut_off(*_arguments: object) -> None:
        pickle.loads(b"")

    monkeypatch.setattr("spool_report.records.valve_sheet.judged", cut_off)
    assert main(["valve", "check", "4weh10_soft"]) == 2
    line = capsys.readouterr().err.strip()
    assert line.startswith("spool: a file or the input ends too early (Ran out of input; read by ")
    assert "interrupted" not in line


def test_each_has_a_line_and_a_place_of_its_own() -> None:
    declared = [declaration(name) for name in command_modules()]
    assert all(one.line for one in declared)
    assert len({one.place for one in declared}) == len(declared)


def test_a_command_of_research_says_that_it_needs_a_checkout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own = {name: module for name, module in command_modules().items() if module.startswith("spool_tools.")}
    monkeypatch.setattr(command_group, "command_modules", lambda: own)
    for name in command_group.IN_A_CHECKOUT:
        assert main([name]) == 2
        assert re.fullmatch(
            rf"spool: {name}: this command needs a checkout of the sources: .*\n", capsys.readouterr().err
        )
    assert main(["info", "--help"]) == 0


@pytest.mark.parametrize("readme", READMES, ids=lambda path: path.parent.name)
def test_the_readme_shows_commands_as_they_are_parsed(group: Any, readme: Path) -> None:
    """The README's commands and the table below them name what there is, with options that exist."""
    text = readme.read_text(encoding="utf-8")
    lines = [line.split()[1:] for line in text.splitlines() if line.startswith("./spool ")]
    assert lines
    for words in lines:
        if words[0] not in set(command_group.IN_A_CHECKOUT) - group.commands.keys():
            group.commands[words[0]].make_context(words[0], words[1:])
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| `") and "--" in line]
    for row in rows:
        name = re.split(r"[` ]", row[0].removeprefix("| `"))[0]
        if name in group.commands:
            command = group.commands[name]
            # Of a command that is a group, the row names the one below it: "`list` with `--all`".
            if below := re.match(r"`([a-z]+)` with ", row[2]):
                command = command.commands[below[1]]
            shown = (one for one in command.params if not getattr(one, "hidden", False))
            options = {option for one in shown for option in one.opts if option.startswith("--")}
            assert set(re.findall(r"--[a-z-]+", row[2])) == options
