from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from spool_bag.reader import BagReader
from spool_report import recording_report
from spool_report.recording_report import write_report
from spool_report.requests import ReplayRequest
from spool_report.runs.record_replay import replay_bag

if TYPE_CHECKING:
    from .conftest import MakeBag, Recorded

PNG = b"\x89PNG\r\n\x1a\n"
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Check that elements are closed in order; collect text, images and whatever points elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[str] = []
        self.links: list[str] = []
        self.cells: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "img":
            assert given.get("alt")
            self.images.append(given["src"] or "")
        elif "src" in given or "href" in given:
            self.links.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th", "h1", "h2", "p"):
            self.cells.append(data)


def test_the_page_stands_by_itself_with_a_picture_of_each_valve(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(
        tmp_path / "bag",
        {
            "valve_1": recorded(seconds=6.0, analysed=True, lost=(40,)),
            "valve_2": recorded("4weh10_stiff", seconds=5.0, analysed=True),
        },
    )
    reader, open_before = BagReader(bag), plt.get_fignums()
    path = write_report(tmp_path, reader, replay_bag(ReplayRequest(record=bag)))
    assert path == tmp_path / "report.html"
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert page.links == []
    assert not re.search(r"https?:|//[a-z]|url\(|@import|<script", re.sub(r"base64,[^\"]*", "", text))
    pictures = [(tmp_path / f"{name}.png").read_bytes() for name in ("valve_1", "valve_2")]
    embedded = [base64.b64decode(image.removeprefix("data:image/png;base64,")) for image in page.images]
    assert embedded == pictures
    assert all(picture.startswith(PNG) for picture in pictures)
    assert pictures[0] != pictures[1]
    assert "2 valves, 6 s, 1 block lost." in " ".join(page.cells)
    assert {"valve_1", "valve_2", "spring stiffness", "N/m"} <= set(page.cells)
    assert {"warning raised", "Lost blocks: 1"} <= set(page.cells)
    assert plt.get_fignums() == open_before


def drawn(reader: BagReader, analysis: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figure of each valve, as the report draws them."""
    figures = {}
    original = recording_report.draw_valve

    def keep(reader: BagReader, name: str, *rest: Any) -> Any:
        figures[name] = original(reader, name, *rest)
        return figures[name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording_report, "draw_valve", keep)
        write_report(reader.path.parent, reader, dict(analysis))
    return figures


def test_the_time_axis_starts_at_0_and_is_that_of_the_events(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(
        tmp_path / "bag",
        {
            "early": recorded(seconds=7.0, analysed=True),
            "late": recorded(begin=3.0, seconds=4.0, analysed=True, lost=(100,)),
        },
    )
    analysis = replay_bag(ReplayRequest(record=bag))
    (event,) = analysis["valves"]["late"]["events"]
    for name, figure in drawn(BagReader(bag), analysis).items():
        acceleration, frequency, viscous, coulomb = figure.axes
        for axis in figure.axes:
            left, right = axis.get_xlim()
            assert left == 0.0
            assert right == pytest.approx(6.98, abs=0.01)
        times = frequency.lines[1].get_xdata()
        assert all(times > 0.0)
        assert times[0] == pytest.approx((3.0 if name == "late" else 0.0) + 1.0, abs=0.01)
        assert coulomb.get_xlabel() == "time, s"
        for axis, unit in ((acceleration, "m/s²"), (frequency, "Hz"), (viscous, "N·s/m"), (coulomb, "N")):
            assert axis.get_ylabel().endswith(unit)
        # The estimates that are drawn are those of the bag.
        forces = coulomb.lines[0].get_ydata()
        assert forces[np.isfinite(forces)][-1] == pytest.approx(0.3, rel=0.2)
        begins = [patch.get_x() for patch in coulomb.patches]
        assert begins == ([pytest.approx(event["t_s"])] if name == "late" else [])
    assert event["t_s"] == pytest.approx(3.0 + 101 * 0.02)


def test_a_bag_without_estimates_and_a_nested_namespace_are_drawn(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(tmp_path / "bag", {"plant/valve_1": recorded(seconds=1.0, described=False)})
    write_report(tmp_path, BagReader(bag), replay_bag(ReplayRequest(record=bag)))
    assert (tmp_path / "plant_valve_1.png").read_bytes().startswith(PNG)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "unknown" in page.cells
    assert "plant/valve_1" in page.cells


def test_what_a_bag_says_is_text_and_no_markup(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(tmp_path / "bag", {"valve_1": recorded(seconds=1.0)})
    analysis = replay_bag(ReplayRequest(record=bag))
    analysis["valves"]["valve_1"]["events"] = [
        {"t_s": 0.5, "kind": "<b>", "state": "raised", "severity": "alarm", "cause": "<i>", "value": 1.0,
         "unit": "1", "message": "<script>alert(1)</script>", "code": 900,
         "details": ["<script>alert(2)</script>"]},
    ]  # fmt: skip
    write_report(tmp_path, BagReader(bag), analysis)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in text
    cells = Page(text).cells
    assert "<script>alert(1)</script>" in cells
    assert "&lt;script&gt;alert(2)&lt;/script&gt;" in text
    assert "alarm raised" in cells
    assert "± 95 %" in cells


def event(seconds: float, state: str, kind: str = "resonance", cause: str | None = None) -> dict[str, Any]:
    return {"t_s": seconds, "kind": kind, "state": state, "cause": cause, "code": 201 if cause else 100}


@pytest.mark.parametrize(
    ("events", "spans"),
    [
        ([], []),
        ([event(1.0, "raised"), event(2.0, "cleared")], [("Resonance", 1.0, 2.0)]),
        ([event(1.0, "raised")], [("Resonance", 1.0, 9.0)]),
        ([event(1.0, "raised"), event(1.5, "raised"), event(2.0, "cleared")], [("Resonance", 1.0, 2.0)]),
        ([event(2.0, "cleared")], []),
        (
            [
                event(1.0, "raised"),
                event(2.0, "raised", "friction_drift", "wear"),
                event(3.0, "cleared"),
                event(4.0, "raised"),
            ],
            [("Resonance", 1.0, 3.0), ("Friction drift (wear)", 2.0, 9.0), ("Resonance", 4.0, 9.0)],
        ),
    ],
)
def test_events_become_stretches_of_time(
    events: list[dict[str, Any]], spans: list[tuple[str, float, float]]
) -> None:
    assert sorted(recording_report._spans(events, 9.0), key=lambda span: span[1]) == spans
