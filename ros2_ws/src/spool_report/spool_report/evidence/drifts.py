"""Drift of each parameter over time, with what the monitor's test made of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95, number, with_interval
from spool_monitor.drift_trace import DriftPoint
from spool_report.evidence import exhibit
from spool_report.evidence.exhibit import Exhibit, Line, Mark, Panel
from spool_report.terminal import captions

#: Events marked at most.
MARKED = 24


def title_of(name: str) -> str:
    """Return the title of the picture of the parameter ``name``."""
    return f"Drift of the {_words(name)}"


def drift(name: str, unit: str, points: Sequence[DriftPoint], first: int, marks: Sequence[Mark]) -> Exhibit:
    """Return the picture of one parameter.

    Args:
        name: of the parameter.
        unit: of it.
        points: as the monitor saw them.
        first: stamp of the record's start, ns.
        marks: events of the valve.

    Raises:
        InputError: there is no estimate of it.
    """
    # A clock that was set back makes no line run back.
    stamps = np.array([point.stamp for point in points], dtype=np.int64)
    before = np.concatenate([[-1], np.maximum.accumulate(stamps)[:-1]]) if stamps.size else stamps
    rising = np.flatnonzero(stamps > before).tolist()
    table = np.array(
        [
            (one.value, one.deviation, one.baseline, one.spread, one.matters, one.up, one.down, one.threshold)
            for one in (points[place] for place in rising)
        ],
        dtype=np.float64,
    ).reshape(-1, 8)
    if not np.isfinite(table[:, 0]).any():
        raise InputError("the estimator gave no value of it in this record")
    time = np.asarray((stamps[rising] - first) * 1e-9, dtype=np.float64)
    x, *rows = exhibit.thinned(time, *table.T)
    value, deviation, baseline, spread, matters, up, down, threshold = rows
    half, wide = Z_95 * deviation, Z_95 * spread
    limits = [
        Line(label, baseline + factor * matters, exhibit.DARK, dash, width=0.9)
        for label, dash, size in (("change that matters", (6, 3), 1.0), ("alarm", (2, 2), 2.0))
        for factor in (-size, size)
    ]
    span = top = None
    if np.isfinite(baseline).any():  # show what was judged: first estimates may be anything
        known = np.concatenate([value, baseline - 2.2 * matters, baseline + 2.2 * matters])
        low, high = np.quantile(known[np.isfinite(known)], (0.01, 0.99)).tolist()
        room = 0.08 * (high - low) + float(np.nanmedian(half))
        span = (low - room, high + room)
    if np.isfinite(threshold).any():
        top = max(3.0 * float(np.nanmin(threshold)), 1.1 * float(max(up.max(), down.max())))
    panels = (
        Panel(
            "time since the start of the record, s", f"{_words(name)}, {unit}", x,
            (
                Line("baseline", baseline, exhibit.MEASURED, (), baseline - wide, baseline + wide, 1.6),
                *limits,
                Line("estimate", value, exhibit.AFTER, (), value - half, value + half, 1.2),
            ),
            marks=tuple(marks[:MARKED]), span=span,
        ),
        Panel(
            "time since the start of the record, s", "cumulative sum, s", x,
            (
                Line("sum of a rise", up, exhibit.BEFORE, (6, 3), width=1.3),
                Line("sum of a fall", down, exhibit.AFTER, width=1.3),
                Line("threshold", threshold, exhibit.FLOOR, (2, 2), width=1.2),
            ),
            marks=tuple(marks[:MARKED]), span=None if top is None else (0.0, top),
        ),
    )  # fmt: skip
    seen = _drift_seen(name, unit, time, table)
    caption = captions("evidence")["drift"]
    return Exhibit(title_of(name), exhibit.drawn(panels, (3, 2), 5.2), caption, seen, panels)


def _drift_seen(name: str, unit: str, time: Array, table: Array) -> str:
    value, deviation, baseline, spread, matters, up, down, threshold = table.T
    known = np.flatnonzero(np.isfinite(value))
    last = int(known[-1])
    text = f"Last estimate of the {_words(name)} {with_interval(value[last], deviation[last], unit)} (± 95 %)"
    if not np.isfinite(baseline[-1]):
        return f"{text}; no baseline was learned, so nothing was judged."
    apart = value[last] - baseline[-1]
    text += (
        f", baseline {with_interval(baseline[-1], spread[-1], unit)}: {number(abs(apart / matters[-1]), 2)} "
        f"times the change that matters, {'up' if apart > 0.0 else 'down'}"
    )
    sums = np.maximum(up, down)
    crossed = np.flatnonzero(sums >= threshold)
    if crossed.size:
        return (
            f"{text}; a cumulative sum first crosses its threshold at {number(float(time[crossed[0]]), 3)} s."
        )
    if not np.isfinite(threshold).any():
        return f"{text}; the test judged nothing."
    most = number(float(np.nanmax(sums / threshold)), 2)
    return f"{text}; the cumulative sums reach {most} of their threshold at most."


def _words(name: str) -> str:
    return name.replace("_", " ").replace("coulomb", "Coulomb")
