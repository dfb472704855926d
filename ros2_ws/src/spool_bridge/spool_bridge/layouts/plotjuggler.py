"""PlotJuggler layout: the plots of each valve in a tab of its own.

The form is that which PlotJuggler 3 writes (``PlotDocker`` and ``TabbedPlotWidget``). Curves name recorded
topics as its ROS 2 parser does: an element of an array by its number.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from .foxglove import COLOURS
from .plotted_valve import PlottedValve


def plotjuggler_layout(valves: Sequence[PlottedValve]) -> str:
    """Return the layout, XML."""
    root = ElementTree.Element("root")
    widget = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for valve in valves:
        tab = ElementTree.SubElement(widget, "Tab", tab_name=valve.name, containers="1")
        container = ElementTree.SubElement(tab, "Container")
        plots = _plots(valve)
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
            for place, curve in enumerate(curves):
                ElementTree.SubElement(plot, "curve", name=curve, color=COLOURS[place % len(COLOURS)])
    ElementTree.SubElement(widget, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _plots(valve: PlottedValve) -> list[tuple[str, list[str]]]:
    """Return titles and curves of the plots of ``valve``."""
    space = f"/{valve.name}"
    frequencies = [f"{space}/health/dominant_frequency/value", f"{space}/estimate/natural_frequency/value"]
    return [
        ("frequencies, Hz", frequencies),
        ("amplification", [f"{space}/health/amplification/value"]),
        *(
            (name.replace("_", " "), [f"{space}/estimate/parameters[{place}]/value"])
            for place, name in enumerate(valve.parameters)
        ),
        ("residual", [f"{space}/estimate/residual/value"]),
    ]
