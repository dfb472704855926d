"""Commands: what a command module declares, and the group that finds and loads them."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import Any

from spool_core.errors import InputError
from typer import Typer
from typer.core import TyperGroup
from typer.main import get_group

#: Entry points of this group name packages that hold command modules.
ENTRY_POINTS = "spool.commands"
SUFFIX = "_command"
#: Commands of ``research/``, which only a checkout of the sources has; ``./spool`` puts it on the path.
RESEARCH = "spool_evaluation"
IN_A_CHECKOUT = ("bench", "paper", "study")


@dataclass(frozen=True, slots=True)
class Command:
    """Command, declared as ``COMMAND`` by a module ``NAME_command.py``; there is no other list of commands.

    Attributes:
        run: function with options and arguments in its annotations, or a group of such functions; its
            docstring is the help, with an example.
        place: in the list of commands; the lowest comes first.
        line: what it does, for the list that is shown before anything is installed.
        settings: of the context in which its arguments are parsed.
    """

    run: Callable[..., None] | Typer
    place: int
    line: str
    settings: Mapping[str, object] = field(default_factory=dict)


@cache
def command_modules() -> dict[str, str]:
    """Return the full name of each command's module by the command's name."""
    packages = {entry.value for entry in entry_points(group=ENTRY_POINTS)}
    if find_spec(RESEARCH) is not None:
        packages.add(f"{RESEARCH}.commands")
    return {
        found.name.removesuffix(SUFFIX): f"{package}.{found.name}"
        for package in sorted(packages)
        for found in pkgutil.iter_modules(import_module(package).__path__)
        if found.name.endswith(SUFFIX)
    }


def declaration(name: str) -> Command:
    """Return what the module of the command ``name`` declares."""
    found: Command = import_module(command_modules()[name]).COMMAND
    return found


class CommandGroup(TyperGroup):
    """Group whose commands are imported one by one, so that none pays for what others need."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands in their places."""
        names = sorted(command_modules(), key=lambda name: declaration(name).place)
        for name in names:
            self.get_command(ctx, name)
        return names

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command, ``None`` where there is none.

        Raises:
            InputError: it is in a checkout of the sources only.
        """
        if cmd_name in command_modules():
            if cmd_name not in self.commands:
                self.commands[cmd_name] = _parser(cmd_name, declaration(cmd_name))
        elif cmd_name in IN_A_CHECKOUT:
            raise InputError(
                f"{cmd_name}: this command needs a checkout of the sources: type ./spool {cmd_name} there"
            )
        else:
            self.list_commands(ctx)  # names alike are suggested from what is loaded
        return self.commands.get(cmd_name)


def _parser(name: str, declared: Command) -> Any:
    """Return what parses the arguments of a command."""
    around = Typer(rich_markup_mode="rich")
    if isinstance(declared.run, Typer):
        around.add_typer(declared.run, name=name)
    else:
        around.command(name, context_settings=dict(declared.settings))(declared.run)
    return get_group(around).commands[name]
