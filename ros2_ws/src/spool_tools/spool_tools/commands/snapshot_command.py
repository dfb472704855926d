"""`./spool snapshot`: the surroundings of this moment of a running valve, kept as a bag of its own."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools.command import Command


def snapshot(
    valve: Annotated[str, typer.Argument(metavar="VALVE", help="Namespace of the valve, e.g. valve_1.")],
    who: Annotated[str, typer.Option(help="Who does it; default: the user's name.")] = "",
    comment: Annotated[str, typer.Option(help="What is to be said about it.")] = "",
) -> None:
    """Let the running recorder keep what came before and comes after this moment, as it does on an alarm.

    Example: ./spool snapshot valve_1 --who Eva
    """
    from spool_tools.operations.service_client import take_snapshot  # noqa: PLC0415 - slow to load

    take_snapshot(valve, who=who, comment=comment)


COMMAND = Command(
    snapshot, place=167, line="the minutes around this moment of a running valve, as a bag of its own"
)
