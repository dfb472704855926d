"""`./spool report`: a month of a machine's valves on paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spool_tools.command import Command, Force, StateFolder


def report(
    out: Annotated[Path, typer.Option(help="HTML page to write.")],
    month: Annotated[str, typer.Option(help="Month like 2026-10 (UTC); default: last full month.")] = "",
    machine: Annotated[
        str | None, typer.Option(help="Machine, the first part of the valves' namespaces; default: all.")
    ] = None,
    state_folder: StateFolder = None,
    _force: Force = False,
) -> None:
    """Write a monthly report of alarms, trends and lost data: one page per machine, one line per valve.

    Example: ./spool report --month 2026-10 --out october.html
    """
    from spool_tools.operations.alarm_journal import write_month  # noqa: PLC0415 - slow to load

    write_month(month, machine, state_folder, out)


COMMAND = Command(report, place=240, line="a month of alarms, trends and losses, to print")
