"""PlotJuggler layout: the plots of each valve in a tab of its own.

The form is the one that PlotJuggler 4 reads (schema 4; ``PlotDocker``, ``TabbedPlotWidget`` and ``LayoutXml``
of its source). It finds a curve by ``topic`` and ``field``, as its ROS 2 parser names them: an element of an
array by its number. PlotJuggler 3 ignores both and reads the curve's ``name``.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from .foxglove import COLOURS
from .plotted_valve import PlottedValve


def plotjuggler_layout(valves: Sequence[PlottedValve]) -> str:
    """Return the layout, XML."""
    root = ElementTree.Element("root", {"format": "PlotJuggler", "pj4_version": "4", "binding": "generic"})
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


def _plots(valve: PlottedValve) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return the plots of ``valve``: the title of each, and topic and field of its curves."""
    health, estimate = f"/{valve.name}/health", f"/{valve.name}/estimate"
    frequencies = [(health, "dominant_frequency/value"), (estimate, "natural_frequency/value")]
    return [
        ("frequencies, Hz", frequencies),
        ("amplification", [(health, "amplification/value")]),
        *(
            (name.replace("_", " "), [(estimate, f"parameters[{place}]/value")])
            for place, name in enumerate(valve.parameters)
        ),
        ("residual", [(estimate, "residual/value")]),
    ]
