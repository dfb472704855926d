"""Command of the command line, as its module declares it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from typer import Typer


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
