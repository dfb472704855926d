"""`./spool demo`: the main job, live."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_report.requests import in_range

from spool_tools.command import Command

#: s: enough for the baseline, a passage and a drift, which may take 14 s to be raised; and an hour.
SHORTEST, LONGEST = 40.0, 3600.0


def demo(
    seconds: Annotated[
        float, typer.Option(help="Length of the run, s; at least 40.", callback=in_range(SHORTEST, LONGEST))
    ] = 60.0,
    out: Annotated[Path, typer.Option(help="Folder for bag, analysis and report.")] = Path("spool_demo"),
) -> None:
    """Run the main job live: two valves simulated, estimated, monitored and recorded by ROS 2 nodes.

    Example: ./spool demo --seconds 60 --out my_demo
    """
    from spool_tools.operations.demo import run_demo  # noqa: PLC0415 - rclpy is needed here only

    raise typer.Exit(run_demo(seconds, out))


COMMAND = Command(
    demo,
    place=10,
    line="the main job, live: two valves simulated, estimated, monitored, recorded, reported",
    live=True,
)
