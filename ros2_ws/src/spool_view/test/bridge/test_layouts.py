"""Layouts: every curve and path names what a bag holds, in the form that the viewers read."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from spool_core.errors import InputError
from spool_msgs.msg import ModelEstimate, ValveHealth
from spool_tools.cli import main
from spool_tools.operations.node_processes import find_executable

LAYOUTS = Path(__file__).resolve().parents[2] / "layouts"
TYPES = {"estimate": ModelEstimate, "health": ValveHealth}


@pytest.fixture(name="layout", params=["foxglove", "lichtblick"])
def _layout(request: pytest.FixtureRequest) -> Any:
    return json.loads((LAYOUTS / f"{request.param}.json").read_text("utf-8"))


@pytest.fixture(name="root")
def _root() -> ElementTree.Element:
    return ElementTree.fromstring((LAYOUTS / "plotjuggler.xml").read_text("utf-8"))


def panels_of(layout: Any) -> list[str]:
    """Return the panels that a mosaic shows, and check that it is one (react-mosaic's MosaicNode)."""
    if isinstance(layout, str):
        return [layout]
    assert set(layout) <= {"first", "second", "direction", "splitPercentage"}
    assert layout["direction"] in ("row", "column")
    assert 0.0 < layout["splitPercentage"] < 100.0
    return [*panels_of(layout["first"]), *panels_of(layout["second"])]


def test_the_foxglove_layout_has_the_form_of_layout_data(layout: Any) -> None:
    """As ``LayoutData`` and ``PlotPath`` of @foxglove/studio-base 1.48 declare it."""
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


def test_paths_and_curves_name_fields_that_messages_have(layout: Any, root: ElementTree.Element) -> None:
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])]
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(paths) == len(curves) == 7
    for path in paths:
        match = re.fullmatch(r"/(valve_1)/(\w+)\.(\w+)(\[:\]\{name==\"\w+\"\})?\.value", path)
        assert match, path
        assert hasattr(TYPES[match[2]](), match[3])
    for curve in curves:
        match = re.fullmatch(r"/(valve_1)/(\w+)/(\w+)(\[\d\])?/value", curve)
        assert match, curve
        assert hasattr(TYPES[match[2]](), match[3])


def test_plotjuggler_4_finds_each_curve_by_topic_and_field(root: ElementTree.Element) -> None:
    """Without both it drops a curve of a layout in silence; 3 reads the name alone."""
    assert root.attrib == {"format": "PlotJuggler", "pj4_version": "4", "binding": "generic"}
    for curve in root.iter("curve"):
        topic, field = curve.attrib["topic"], curve.attrib["field"]
        assert re.fullmatch(r"/(valve_1)/(health|estimate)", topic)
        assert not field.startswith("/")
        assert curve.attrib["name"] == f"{topic}/{field}"


def test_the_plotjuggler_layout_has_the_form_that_it_reads(root: ElementTree.Element) -> None:
    """PlotJuggler 4 refuses a tab of two containers, a wrong count, and an area of two plots."""
    assert root.tag == "root"
    tabs = root.findall("tabbed_widget/Tab")
    assert [tab.attrib["tab_name"] for tab in tabs] == ["valve_1"]
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


def test_what_was_removed_names_the_layouts_to_open(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["layout", "valve_1"]) == 2
    assert "spool_view/layouts" in capsys.readouterr().err
    with pytest.raises(InputError, match="spool_view/layouts"):
        find_executable("spool_view", "plots")
