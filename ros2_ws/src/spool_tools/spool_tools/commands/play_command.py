"""`./spool play`: a record as if it were measured now."""

from __future__ import annotations

import typer
from spool_report.requests import PlayRequest

from spool_tools import command as cli


def play(request: PlayRequest) -> None:
    """Play a record to live nodes, as if it were measured now: estimates, alarms and the page.

    The times of the record are moved: it ends when playing ends.

    Example: ./spool play bags/practice_03 --valve 4weh10_soft

    Example: ./spool play record.csv --valve press_4_left.yaml --speed 5 --no-web
    """
    cli.refuse_missing(request.record)
    from spool_tools.operations.play import run_play  # noqa: PLC0415 - rclpy is needed here only

    raise typer.Exit(run_play(request))


COMMAND = cli.Command(play, place=202, line="a record played to live nodes, with the page", live=True)
