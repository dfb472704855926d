"""`./spool trend`: what the monitor kept of a valve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from spool_report.requests import option

from spool_tools.command import Command, Force, JsonFile, RunningValve, StateFolder


def trend(
    valve: RunningValve,
    state_folder: StateFolder = None,
    parameter: Annotated[
        list[str] | None, option("Parameter to plot, e.g. coulomb_force; repeatable; default: all.")
    ] = None,
    since: Annotated[str | None, option("How long ago, e.g. 6h, 7d, or a time (UTC); default: all.")] = None,
    out: Annotated[Path | None, option("Picture FILE.png or page FILE.html.")] = None,
    json: JsonFile = None,
    _force: Force = False,
) -> None:
    """Show the stored trends of a valve: minimum, mean, maximum per minute, hour or day, and counters.

    Example: ./spool trend valve_1 --since 7d --out valve_1.html
    """
    from spool_tools.operations.valve_trend import show_trend  # noqa: PLC0415 - slow to load

    show_trend(valve, state_folder, parameter or [], since, out, json)


COMMAND = Command(trend, place=235, line="trends of a valve over hours, days and months")
