"""`./spool baseline`: what a running valve's healthy state is held to be."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools.command import Command, CommentOption, RunningValve, WhoOption

app = typer.Typer(
    no_args_is_help=True,
    help="Show, confirm, relearn or restore a valve's baseline.\n\nExample: ./spool baseline show valve_1",
)


@app.command()
def show(valve: RunningValve) -> None:
    """Show the baseline: the values that drift is judged against.

    Example: ./spool baseline show valve_1
    """
    _manage(valve, "show")


@app.command()
def learn(valve: RunningValve, who: WhoOption = "", comment: CommentOption = "") -> None:
    """Learn a new baseline from now on, as after a repair.

    Example: ./spool baseline learn valve_1 --comment "new spool fitted"
    """
    _manage(valve, "learn", who=who, comment=comment)


@app.command()
def freeze(valve: RunningValve, who: WhoOption = "", comment: CommentOption = "") -> None:
    """Confirm the learned baseline.

    Example: ./spool baseline freeze valve_1 --who Eva
    """
    _manage(valve, "freeze", who=who, comment=comment)


@app.command()
def restore(
    valve: RunningValve,
    version: Annotated[int, typer.Argument(help="Number of the version.")],
    who: WhoOption = "",
    comment: CommentOption = "",
) -> None:
    """Restore an older version.

    Example: ./spool baseline restore valve_1 2
    """
    _manage(valve, "restore", version=version, who=who, comment=comment)


def _manage(valve: str, action: str, *, version: int = 0, who: str = "", comment: str = "") -> None:
    from spool_tools.operations.service_client import manage_baseline  # noqa: PLC0415 - slow to load

    manage_baseline(valve, action, version=version, who=who, comment=comment)


COMMAND = Command(
    app, place=215, line="baseline of the healthy valve: show, learn, confirm, restore", live=True
)
