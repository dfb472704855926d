"""`./spool layout`: layouts of viewers for the valves of a bag, or for valves by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from spool_tools import command as cli
from spool_tools.command import Command


def layout(
    valves: Annotated[
        list[str], typer.Argument(metavar="BAG|VALVE...", help="A bag, or namespaces of running valves.")
    ],
    out: Annotated[Path, typer.Option(help="Folder that is made for the layouts.")] = Path("layouts"),
    _force: cli.Force = False,
) -> None:
    """Write layouts for Foxglove, Lichtblick and PlotJuggler that show valves, live or from a bag.

    Example: ./spool layout bags/practice_03 --out layouts

    Example: ./spool layout valve_1 valve_2
    """
    from spool_bag import check_valve  # noqa: PLC0415 - slow to load, as below
    from spool_bag.information import describe  # noqa: PLC0415
    from spool_bag.reader import BagReader  # noqa: PLC0415
    from spool_tools.outputs import write_file  # noqa: PLC0415

    from spool_view.layouts import PlottedValve, foxglove_layout, plotjuggler_layout, recorded_valves  # noqa: PLC0415

    bag = Path(valves[0])
    if len(valves) == 1 and bag.exists():
        names = [one.name for one in describe(bag).valves]
        shown = recorded_valves(BagReader(bag), names)
    else:
        for name in valves:
            check_valve(name)
        shown = [PlottedValve(name) for name in valves]
    out.mkdir(parents=True, exist_ok=True)
    written = {
        "foxglove.json": json.dumps(foxglove_layout(shown), indent=1) + "\n",
        "plotjuggler.xml": plotjuggler_layout(shown),
    }
    for name, text in written.items():
        write_file(out / name, text, "--out")
        print(out / name)


COMMAND = Command(layout, place=175, line="layouts of viewers (Foxglove, Lichtblick, PlotJuggler) for valves")
