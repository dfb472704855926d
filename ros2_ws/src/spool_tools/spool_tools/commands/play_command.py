"""`./spool play`: a record as if it were measured now."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spool_tools import command as cli
from spool_tools.command import Command


def play(
    record: cli.RecordArgument,
    valve: cli.ValveFiles = None,
    speed: Annotated[
        float, typer.Option(help="Seconds of the record in a second.", callback=cli.in_range(1.0, 20.0))
    ] = 1.0,
    no_web: Annotated[bool, typer.Option("--no-web", help="Serve no page; end with the record.")] = False,
    port: Annotated[int, typer.Option(help="Port of the page; 0: any free one.", min=0, max=65535)] = 8765,
    columns: cli.ColumnsOption = None,
    state: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder that keeps baselines and alarms from record to record."),
    ] = None,
    since: cli.SinceOption = None,
    until: cli.UntilOption = None,
    around: cli.AroundOption = None,
    params_file: cli.ParamsFile = None,
) -> None:
    """Play a record to live nodes, as if it were measured now: estimates, alarms and the page.

    The times of the record are moved: it ends when playing ends.

    Example: ./spool play bags/practice_03 --valve 4weh10_soft

    Example: ./spool play record.csv --valve press_4_left.yaml --speed 5 --no-web
    """
    cli.refuse_missing(record)
    from spool_tools.operations.play import PlayOptions, run_play  # noqa: PLC0415 - rclpy is needed here only

    options = PlayOptions(
        speed, None if no_web else port, columns, (since, until, around), state, params_file
    )
    raise typer.Exit(run_play(record, valve or [], options))


COMMAND = Command(play, place=202, line="a record played to live nodes, with the page", live=True)
