"""Reports of a recording: estimates, events and pictures over its time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from spool_bag.reader import BagReader
from spool_core.block_gate import malformed
from spool_core.events.sentences import title
from spool_core.numbers import Array
from spool_core.text import plural
from spool_core.uncertainty import LEGEND, PLUS_MINUS, Z_95, interval

from spool_report import page as html
from spool_report.evidence.exhibit import Exhibit, LeftOut, subplots
from spool_report.outputs import sources
from spool_report.terminal import Table, captions, spoken

#: Okabe and Ito's colours: apart for the colour-blind and in print.
BODY, SPOOL, ESTIMATE, EVENT = "#0072B2", "#D55E00", "#009E73", "#E69F00"


def write_report(folder: Path, reader: BagReader, analysis: dict[str, Any]) -> Path:
    """Write ``report.html`` and one PNG per valve into ``folder``; return the page's path.

    ``analysis`` is what ``replay --json`` writes for the bag of ``reader``.
    """
    sections: list[str] = []
    peaks = {name: _peaks(reader, name) for name in analysis["valves"]}
    start = min((float(table[0, 0]) for table in peaks.values() if table.size), default=0.0)
    for name, valve in analysis["valves"].items():
        figure = draw_valve(reader, name, peaks[name], start, valve["events"])
        raised = [event for event in valve["events"] if event["state"] == "raised"]
        events = ", ".join(f"{title(one['code'], one['kind'])} at {one['t_s']:.0f} s" for one in raised)
        image, content = html.picture(
            figure,
            f"{name} over time: peak acceleration of body and spool, the frequency that the body shakes at "
            f"next to the natural frequency, viscous coefficient, Coulomb force. Events: {events or 'none'}.",
            dpi=150,
        )
        (folder / f"{name.replace('/', '_')}.png").write_bytes(content)
        sections += [html.heading(name), image, _parameters(valve), _events(valve)]
    lost = sum(valve["lost_blocks"] for valve in analysis["valves"].values())
    summary = (
        f"{plural(len(analysis['valves']), 'valve')}, {analysis['duration_s'] or 0.0:.0f} s, "
        f"{plural(lost, 'block')} lost. "
        f"{LEGEND}; bands around curves are the same intervals. Shaded stretches are events."
    )
    described = [
        (key, f"{name}: {valve[key]['sentence']}")
        for name, valve in analysis["valves"].items()
        for key in ("valve", "limits")
        if key in valve
    ]
    text = html.page(
        "Spool valves: report of the recording", [html.paragraph(summary), *sections],
        [*sources([reader.path]), *described],
    )  # fmt: skip
    path = folder / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


def draw_valve(
    reader: BagReader, name: str, peaks: Array, start: float, events: list[dict[str, Any]]
) -> Figure:
    """Return the picture of one valve: accelerations, frequencies, friction over time, events shaded.

    ``peaks`` has the columns time (s) and peak accelerations of body and spool; ``start`` (s) is where the
    time axis and the events of all valves count from.
    """
    time, body, spool = peaks.T
    estimates = list(reader.messages(f"/{name}/estimate")) if f"/{name}/estimate" in reader.topics else []
    health = list(reader.messages(f"/{name}/health")) if f"/{name}/health" in reader.topics else []
    figure, axes = subplots(9.5, 4, sharex=True)
    relative = time - start
    axes[0].fill_between(relative, -spool, spool, color=SPOOL, alpha=0.7, lw=0, label="spool")
    axes[0].fill_between(relative, -body, body, color=BODY, alpha=0.8, lw=0, label="body")
    axes[0].set_ylabel("peak acceleration\nm/s²")
    at = _stamps(health) - start
    # What a monitor says before the first block is stamped by its own clock and comes from its settings.
    health = [message for message, seconds in zip(health, at, strict=True) if seconds > 0.0]
    at = at[at > 0.0]
    axes[1].plot(at, _values(health, "dominant_frequency"), color=BODY, label="body shakes at")
    axes[1].plot(at, _values(health, "natural_frequency"), color=ESTIMATE, ls="--", label="natural frequency")
    axes[1].set_ylabel("frequency\nHz")
    at = _stamps(estimates) - start
    _band(axes[2], at, estimates, "viscous_coefficient", "viscous coefficient\nN·s/m")
    _band(axes[3], at, estimates, "coulomb_force", "Coulomb force\nN")
    axes[3].set_xlabel("time, s")
    axes[3].set_xlim(0.0, float(relative[-1]) if relative.size else None)
    for axis in axes:
        axis.grid(alpha=0.3)
        for _, begin, until in _spans(events, float(relative[-1]) if relative.size else 0.0):
            axis.axvspan(begin, until, color=EVENT, alpha=0.18, lw=0)
    for axis in axes[:2]:
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, borderpad=0.0)
    for number, (label, begin, _) in enumerate(sorted(_spans(events, 0.0), key=lambda span: span[1])):
        # Two heights in turn, so that neighbours stay apart.
        axes[0].annotate(
            label, (begin, 0.02 + 0.13 * (number % 2)), xycoords=("data", "axes fraction"), fontsize=8,
            va="bottom", xytext=(2, 0), textcoords="offset points",
        )  # fmt: skip
    figure.suptitle(name)
    return figure


def replay_page(
    result: Mapping[str, Any],
    evidence: Mapping[str, Sequence[Exhibit | LeftOut]],
    sources: Sequence[tuple[str, str]] = (),
) -> str:
    """Return the page of a replay.

    Args:
        result: as ``replay --json`` writes it.
        evidence: pictures of each valve, by its name.
        sources: label and value of what it was made from.
    """
    sections: list[str] = []
    if result["warnings"]:
        sections.append(html.listing([f"Warning: {text}" for text in result["warnings"]]))
    for name, valve in result["valves"].items():
        raised = [event for event in valve["events"] if event["state"] == "raised"]
        count = f"{len(raised)} event{'' if len(raised) == 1 else 's'}"
        lost = f"; {plural(valve['lost_blocks'], 'block')} lost" if valve["lost_blocks"] else ""
        sections += [
            html.heading(name),
            html.verdict(f"{name} at the end: {valve['health']['summary']}; {count} in the record{lost}."),
            html.paragraph(valve["valve"]["sentence"]),
            html.paragraph(f"Judged by {valve['limits']['sentence']}."),
            *(
                [html.listing([f"Warning: {text}" for text in valve["warnings"]])]
                if valve["warnings"]
                else []
            ),
            _events(valve),
            *([_parameters(valve), html.paragraph(f"{LEGEND}.")] if valve["estimate"]["parameters"] else []),
            html.heading(f"Evidence of {name}"),
            html.paragraph(captions("replay")["evidence"]),
            *html.evidence(evidence.get(name, ())),
        ]
    return html.page(f"Monitor report on {result['bag']}", sections, sources)


def _peaks(reader: BagReader, name: str) -> Array:
    """Return time (s) and peak accelerations of body and spool by well-formed block, shape (n, 3)."""
    peaks = [
        (block.stamp * 1e-9, float(np.abs(block.body).max()), float(np.abs(block.spool).max()))
        for block in reader.blocks(name)
        if malformed(block) is None
    ]
    return np.array(peaks).reshape(-1, 3)


def _stamps(messages: list[Any]) -> Array:
    return np.array([message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 for message in messages])


def _values(messages: list[Any], name: str) -> Array:
    return np.array([getattr(message, name).value for message in messages])


def _band(axis: Axes, at: Array, estimates: list[Any], name: str, label: str) -> None:
    rows = []
    for estimate in estimates:
        found = [quantity for quantity in estimate.parameters if quantity.name == name]
        known = bool(found) and found[0].validity in (1, 2)
        rows.append((found[0].value, found[0].standard_deviation) if known else (np.nan, np.nan))
    table = np.array(rows).reshape(-1, 2)
    axis.plot(at, table[:, 0], color=ESTIMATE, marker=".", ms=4)
    low, high = table[:, 0] - Z_95 * table[:, 1], table[:, 0] + Z_95 * table[:, 1]
    axis.fill_between(at, low, high, color=ESTIMATE, alpha=0.25, lw=0)
    axis.set_ylabel(label)


def _spans(events: list[dict[str, Any]], end: float) -> list[tuple[str, float, float]]:
    """Return title, begin and end (s) of each event; those that go on last to the end."""
    spans = []
    begun: dict[str, float] = {}
    for event in events:
        key = title(event["code"], event["kind"])
        if event["state"] == "raised":
            begun.setdefault(key, event["t_s"])
        elif key in begun:
            spans.append((key, begun.pop(key), event["t_s"]))
    return spans + [(key, since, end) for key, since in begun.items()]


def _parameters(valve: Mapping[str, Any]) -> Markup:
    rows = [
        (spoken(name), shown.value, shown.half_width, one["unit"])
        for name, one in valve["estimate"]["parameters"].items()
        for shown in (interval(one["value"], one["std"]),)
    ]
    columns = ("parameter", "at the end", PLUS_MINUS, "unit")
    return html.table(Table(columns, rows, columns[1:3]))


def _events(valve: Mapping[str, Any]) -> Markup:
    rows = [
        (
            f"{event['t_s']:.1f}", f"{event['severity']} {event['state']}", event["message"],
            html.folded("show", event["details"]),
        )
        for event in valve["events"]
    ]  # fmt: skip
    table = Table(("time, s", "event", "headline", "details"), rows, ("time, s",))
    return html.table(table) if rows else html.paragraph("No event.")
