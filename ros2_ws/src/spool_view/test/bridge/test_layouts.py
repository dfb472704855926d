"""Layouts: every curve and path names what a bag holds, in the form that the viewers read."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from spool_bag.reader import BagReader
from spool_msgs.msg import ModelEstimate, ValveHealth
from spool_tools.cli import main
from spool_view.commands.layout_command import (
    PlottedValve,
    foxglove_layout,
    plotjuggler_layout,
    recorded_valves,
)

VALVES = [PlottedValve("valve_1"), PlottedValve("press/left", ("spring_stiffness", "viscous_coefficient"))]
TYPES = {"estimate": ModelEstimate, "health": ValveHealth}


def panels_of(layout: Any) -> list[str]:
    """Return the panels that a mosaic shows, and check that it is one (react-mosaic's MosaicNode)."""
    if isinstance(layout, str):
        return [layout]
    assert set(layout) <= {"first", "second", "direction", "splitPercentage"}
    assert layout["direction"] in ("row", "column")
    assert 0.0 < layout["splitPercentage"] < 100.0
    return [*panels_of(layout["first"]), *panels_of(layout["second"])]


def test_the_foxglove_layout_has_the_form_of_layout_data() -> None:
    """As ``LayoutData`` and ``PlotPath`` of @foxglove/studio-base 1.48 declare it."""
    layout = json.loads(json.dumps(foxglove_layout(VALVES)))
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = layout["configById"]
    (outer,) = panels_of(layout["layout"])
    shown = [name for tab in panels[outer]["tabs"] for name in panels_of(tab["layout"])]
    assert sorted([*shown, outer]) == sorted(panels)
    assert all(re.fullmatch(r"(Plot|RawMessages|Tab)![\w]+", name) for name in panels)
    for name in shown:
        for path in panels[name].get("paths", []):
            assert {"value", "enabled", "timestampMethod"} <= set(path)
            assert path["timestampMethod"] in ("headerStamp", "receiveTime")


def test_paths_and_curves_name_fields_that_messages_have() -> None:
    layout = foxglove_layout(VALVES)
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])]
    root = ElementTree.fromstring(plotjuggler_layout(VALVES))
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(paths) == len(curves) == 5 + 2 + 4 + 2
    for path in paths:
        match = re.fullmatch(r"/(valve_1|press/left)/(\w+)\.(\w+)(\[:\]\{name==\"\w+\"\})?\.value", path)
        assert match, path
        assert hasattr(TYPES[match[2]](), match[3])
    for curve in curves:
        match = re.fullmatch(r"/(valve_1|press/left)/(\w+)/(\w+)(\[\d\])?/value", curve)
        assert match, curve
        assert hasattr(TYPES[match[2]](), match[3])


def test_plotjuggler_4_finds_each_curve_by_topic_and_field() -> None:
    """Without both it drops a curve of a layout in silence; 3 reads the name alone."""
    root = ElementTree.fromstring(plotjuggler_layout(VALVES))
    assert root.attrib == {"format": "PlotJuggler", "pj4_version": "4", "binding": "generic"}
    for curve in root.iter("curve"):
        topic, field = curve.attrib["topic"], curve.attrib["field"]
        assert re.fullmatch(r"/(valve_1|press/left)/(health|estimate)", topic)
        assert not field.startswith("/")
        assert curve.attrib["name"] == f"{topic}/{field}"


def test_the_plotjuggler_layout_has_the_form_that_it_reads() -> None:
    """PlotJuggler 4 refuses a tab of two containers, a wrong count, and an area of two plots."""
    root = ElementTree.fromstring(plotjuggler_layout(VALVES))
    assert root.tag == "root"
    tabs = root.findall("tabbed_widget/Tab")
    assert [tab.attrib["tab_name"] for tab in tabs] == ["valve_1", "press/left"]
    for tab in tabs:
        ((splitter,),) = tab
        assert (tab[0].tag, splitter.tag) == ("Container", "DockSplitter")
        assert (tab.attrib["containers"], splitter.attrib["orientation"]) == ("1", "-")
        areas = list(splitter)
        assert {area.tag for area in areas} == {"DockArea"}
        assert [[plot.tag for plot in area] for area in areas] == [["plot"]] * len(areas)
        assert int(splitter.attrib["count"]) == len(areas)
        assert len(splitter.attrib["sizes"].split(";")) == len(areas)
        assert sum(float(size) for size in splitter.attrib["sizes"].split(";")) == pytest.approx(
            1.0, abs=1e-4
        )
        assert all(area.find("plot/curve") is not None for area in areas)


def test_a_bag_gives_its_valves_and_the_command_writes_both(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    simulated = ["simulate", "--valve", "4weh10_soft", "--seconds", "2", "--out", str(bag)]
    assert main(simulated) == 0
    assert [one.name for one in recorded_valves(BagReader(bag), ["valve_1"])] == ["valve_1"]
    assert main(["layout", str(bag), "--out", str(tmp_path / "out")]) == 0
    json.loads((tmp_path / "out" / "foxglove.json").read_text("utf-8"))
    ElementTree.fromstring((tmp_path / "out" / "plotjuggler.xml").read_text("utf-8"))
