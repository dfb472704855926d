"""`./spool layout`: state, plots and events of each valve for Foxglove, Lichtblick and PlotJuggler.

Foxglove: the form is that of ``LayoutData`` in ``@foxglove/studio-base``; Lichtblick reads the same. Paths
name recorded topics, so the layout serves live and on a bag.

PlotJuggler: the form is the one that PlotJuggler 4 reads (schema 4; ``PlotDocker``, ``TabbedPlotWidget`` and
``LayoutXml`` of its source). It finds a curve by ``topic`` and ``field``, as its ROS 2 parser names them: an
element of an array by its number. PlotJuggler 3 ignores both and reads the curve's ``name``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from xml.etree import ElementTree

import typer
from spool_tools import command as cli
from spool_tools.command import Command

if TYPE_CHECKING:
    from spool_bag.reader import BagReader


#: Okabe and Ito's colours, which the colour-blind can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")

#: Parameters where no estimate says what the model has: those of the default model.
DEFAULT_PARAMETERS = ("spring_stiffness", "viscous_coefficient", "coulomb_force")


def layout(
    valves: Annotated[
        list[str], typer.Argument(metavar="BAG|VALVE...", help="A bag, or namespaces of running valves.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to write the layouts to.")] = Path("layouts"),
    _force: cli.Force = False,
) -> None:
    """Write layouts for Foxglove, Lichtblick and PlotJuggler that show valves, live or from a bag.

    Example: ./spool layout bags/practice_03 --out layouts

    Example: ./spool layout valve_1 valve_2
    """
    from spool_bag import check_valve  # noqa: PLC0415 - slow to load, as below
    from spool_bag.information import describe  # noqa: PLC0415
    from spool_bag.reader import BagReader  # noqa: PLC0415
    from spool_report.outputs import write_file  # noqa: PLC0415

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


def foxglove_layout(valves: Sequence[PlottedValve]) -> dict[str, Any]:
    """Return the layout, types of JSON."""
    panels: dict[str, Any] = {}
    tabs = [_tab(valve, number, panels) for number, valve in enumerate(valves)]
    panels["Tab!valves"] = {"activeTabIdx": 0, "tabs": tabs}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": "Tab!valves",
    }


def plotjuggler_layout(valves: Sequence[PlottedValve]) -> str:
    """Return the layout, XML."""
    root = ElementTree.Element("root", {"format": "PlotJuggler", "pj4_version": "4", "binding": "generic"})
    widget = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for valve in valves:
        tab = ElementTree.SubElement(widget, "Tab", tab_name=valve.name, containers="1")
        container = ElementTree.SubElement(tab, "Container")
        # The plots of valve: the title of each, and topic and field of its curves.
        health, estimate = f"/{valve.name}/health", f"/{valve.name}/estimate"
        frequencies = [(health, "dominant_frequency/value"), (estimate, "natural_frequency/value")]
        plots = [
            ("frequencies, Hz", frequencies),
            ("amplification", [(health, "amplification/value")]),
            *(
                (name.replace("_", " "), [(estimate, f"parameters[{place}]/value")])
                for place, name in enumerate(valve.parameters)
            ),
            ("residual", [(estimate, "residual/value")]),
        ]
        sizes = ";".join([f"{1.0 / len(plots):.6g}"] * len(plots))
        splitter = ElementTree.SubElement(
            container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes
        )
        for title, curves in plots:
            area = ElementTree.SubElement(splitter, "DockArea", name=title)
            plot = ElementTree.SubElement(
                area, "plot", style="Lines", mode="TimeSeries", flip_x="false", flip_y="false"
            )
            ElementTree.SubElement(plot, "limitY")
            for place, (topic, field) in enumerate(curves):
                ElementTree.SubElement(
                    plot,
                    "curve",
                    name=f"{topic}/{field}",
                    topic=topic,
                    field=field,
                    color=COLOURS[place % len(COLOURS)],
                )
    ElementTree.SubElement(widget, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


@dataclass(frozen=True, slots=True)
class PlottedValve:
    """``name`` is its namespace, ``parameters`` those of its estimates, in their order."""

    name: str
    parameters: tuple[str, ...] = DEFAULT_PARAMETERS


def recorded_valves(reader: BagReader, names: Sequence[str]) -> list[PlottedValve]:
    """Return the valves ``names`` of a bag with the parameters that their first estimate has."""
    found = []
    for name in names:
        topic = f"/{name}/estimate"
        estimate = next(iter(reader.messages(topic)), None) if topic in reader.topics else None
        own = tuple(one.name for one in estimate.parameters) if estimate is not None else DEFAULT_PARAMETERS
        found.append(PlottedValve(name, own))
    return found


def _tab(valve: PlottedValve, number: int, panels: dict[str, Any]) -> dict[str, Any]:
    """Add the panels of ``valve`` to ``panels`` and return its tab."""
    space = f"/{valve.name}"

    def panel(kind: str, name: str, config: dict[str, Any]) -> str:
        key = f"{kind}!{number}{name}"
        panels[key] = config
        return key

    plots = [
        panel("Plot", "frequency", _plot("frequencies, Hz", [
            (f"{space}/health.dominant_frequency.value", "shaken at"),
            (f"{space}/estimate.natural_frequency.value", "natural frequency"),
        ])),
        panel("Plot", "amplification", _plot("amplification", [
            (f"{space}/health.amplification.value", "spool over body"),
        ])),
        *(
            panel("Plot", name, _plot(name.replace("_", " "), [
                (f"{space}/estimate.parameters[:]{{name==\"{name}\"}}.value", name),
            ]))
            for name in valve.parameters
        ),
        panel("Plot", "residual", _plot("residual", [(f"{space}/estimate.residual.value", "residual")])),
    ]  # fmt: skip
    state = panel("RawMessages", "health", {"topicPath": f"{space}/health", "expansion": "all"})
    events = panel("RawMessages", "events", {"topicPath": f"{space}/events"})
    side = {"first": state, "second": events, "direction": "column", "splitPercentage": 60}
    layout = {"first": side, "second": _stacked(plots), "direction": "row", "splitPercentage": 25}
    return {"title": valve.name, "layout": layout}


def _plot(title: str, paths: Sequence[tuple[str, str]]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {
                "value": path,
                "label": label,
                "enabled": True,
                "color": COLOURS[place % len(COLOURS)],
                "timestampMethod": "headerStamp",
            }
            for place, (path, label) in enumerate(paths)
        ],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _stacked(keys: Sequence[str]) -> Any:
    """Return ``keys`` one below the other, of equal heights, as the viewer's mosaic takes it."""
    if len(keys) == 1:
        return keys[0]
    share = 100.0 / len(keys)
    return {"first": keys[0], "second": _stacked(keys[1:]), "direction": "column", "splitPercentage": share}


COMMAND = Command(layout, place=175, line="layouts of viewers (Foxglove, Lichtblick, PlotJuggler) for valves")
