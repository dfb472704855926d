"""`./spool run`: a node, as `ros2 run` starts it."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools.command import PASSING_ON, Command


def run(
    context: typer.Context,
    package: Annotated[str, typer.Argument(metavar="PACKAGE", help="e.g. spool_sim")],
    executable: Annotated[str, typer.Argument(metavar="EXECUTABLE", help="e.g. simulator")],
) -> None:
    """Start a node as `ros2 run` does; all further arguments go to the node.

    Example: ./spool run spool_sim simulator --ros-args -r __ns:=/valve_1 -p excitation:=sweep
    """
    from spool_tools.operations.node_processes import replace_by_node  # noqa: PLC0415

    replace_by_node(package, executable, context.args)


COMMAND = Command(
    run,
    place=200,
    line="what `ros2 run` does: ./spool run PACKAGE EXECUTABLE [arguments]",
    settings=PASSING_ON,
    live=True,
)
