"""Drift of a parameter as the monitor judged it: estimates, baseline, limits, cumulative sums, events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.uncertainty import Z_95, number, with_interval
from spool_monitor.drift.drift_trace import DriftPoint

from spool_tools.report.drawing.palette import AFTER, BEFORE, DARK, FLOOR, MEASURED, WIDTH, plain

from .exhibit import Exhibit, Line, Panel, thinned

Array = NDArray[np.float64]

CAPTION = (
    "Above: estimates with their 95 % band; grey: baseline of the healthy valve with its own; dashed: the "
    "change that warns; dotted: twice that, from which it is an alarm. Below: the cumulative sums of the "
    "sequential test (Page 1954), for a rise and for a fall, and the threshold that noise alone crosses once "
    "in the time the monitor is set to; vertical lines: events. Good: estimates stay around the baseline and "
    "both sums at zero. Bad: a sum that climbs: the change began where it left zero, not where the event "
    "came. Where there are no estimates the valve was not shaken, or not believed."
)
#: Events marked at most.
MARKED = 24


@dataclass(frozen=True, slots=True)
class Mark:
    """Event at ``time`` (s): its ``text``, and whether it was raised or cleared."""

    time: float
    text: str
    raised: bool


def title_of(name: str) -> str:
    """Return the title of the picture of the parameter ``name``."""
    return f"Drift of the {name.replace('_', ' ').replace('coulomb', 'Coulomb')}"


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
    value, deviation, baseline, spread, matters, up, down, threshold = table.T
    half = Z_95 * deviation
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(WIDTH, 5.2), layout="constrained", sharex=True, height_ratios=(3, 2)
    )
    upper.fill_between(
        time, baseline - Z_95 * spread, baseline + Z_95 * spread, color=MEASURED, alpha=0.3, lw=0
    )
    upper.plot(time, baseline, color=MEASURED, lw=1.6, label="baseline")
    for factor, dash, label in ((1.0, (0, (5, 2)), "warns"), (2.0, (0, (1.5, 1.2)), "alarm")):
        for place, sign in enumerate((-1.0, 1.0)):
            upper.plot(
                time, baseline + sign * factor * matters, color=DARK, ls=dash, lw=0.9,
                label=label if place == 0 else None,
            )  # fmt: skip
    upper.fill_between(time, value - half, value + half, color=AFTER, alpha=0.3, lw=0)
    upper.plot(time, value, color=AFTER, lw=1.2, label="estimate")
    for row, colour, style, label in (
        (up, BEFORE, "--", "sum of a rise"),
        (down, AFTER, "-", "sum of a fall"),
    ):
        lower.plot(time, row, color=colour, ls=style, lw=1.3, label=label)
    lower.plot(time, threshold, color=FLOOR, ls=(0, (1.5, 1.2)), lw=1.2, label="threshold")
    top = (
        max(3.0 * float(np.nanmin(threshold)), 1.1 * float(max(up.max(), down.max())))
        if np.isfinite(threshold).any()
        else None
    )
    lower.set_ylim(0.0, top)
    for mark in marks[:MARKED]:
        for axis in (upper, lower):
            axis.axvline(mark.time, color=DARK, lw=0.7, ls="-" if mark.raised else ":")
    _bounded(upper, value, half, baseline, matters)
    _labelled(upper, marks[:MARKED])
    plain(upper, "", f"{_words(name)}, {unit}")
    plain(lower, "time since the start of the record, s", "cumulative sum, s")
    for axis in (upper, lower):
        axis.legend(fontsize=7.5, frameon=False, ncols=4, loc="lower left")
        axis.margins(x=0.0)
    return Exhibit(
        title_of(name),
        figure,
        CAPTION,
        _seen(name, unit, time, table),
        _panels(name, unit, time, table, marks),
    )


def _bounded(axis: plt.Axes, value: Array, half: Array, baseline: Array, matters: Array) -> None:
    """Show what was judged: first estimates may be anything."""
    known = np.concatenate([value, baseline - 2.2 * matters, baseline + 2.2 * matters])
    known = known[np.isfinite(known)]
    if np.isfinite(baseline).any():
        low, high = np.quantile(known, (0.01, 0.99)).tolist()
        room = 0.08 * (high - low) + float(np.nanmedian(half))
        axis.set_ylim(low - room, high + room)


def _labelled(axis: plt.Axes, marks: Sequence[Mark]) -> None:
    for mark in marks:
        if mark.raised:
            axis.annotate(
                mark.text, (mark.time, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2),
                textcoords="offset points", rotation=90, va="top", fontsize=6.5, color=DARK,
            )  # fmt: skip


def _panels(name: str, unit: str, time: Array, table: Array, marks: Sequence[Mark]) -> tuple[Panel, ...]:
    x, *rows = thinned(time, *table.T)
    value, deviation, baseline, spread, matters, up, down, threshold = rows
    half, wide = Z_95 * deviation, Z_95 * spread
    limits = tuple(
        Line(
            f"{label} {'above' if sign > 0.0 else 'below'}",
            baseline + sign * factor * matters,
            DARK,
            dash,
            width=1.0,
        )
        for factor, dash, label in ((1.0, (6, 3), "warns"), (2.0, (2, 2), "alarm"))
        for sign in (-1.0, 1.0)
    )
    shown = tuple((mark.time, mark.text if mark.raised else f"{mark.text} over") for mark in marks[:MARKED])
    return (
        Panel(
            "time, s", f"{_words(name)}, {unit}", x,
            (
                Line("baseline", baseline, MEASURED, (), baseline - wide, baseline + wide),
                *limits,
                Line("estimate", value, AFTER, (), value - half, value + half),
            ),
            marks=shown,
        ),
        Panel(
            "time, s", "cumulative sum, s", x,
            (
                Line("sum of a rise", up, BEFORE, (6, 3)),
                Line("sum of a fall", down, AFTER),
                Line("threshold", threshold, FLOOR, (2, 2)),
            ),
            marks=shown,
        ),
    )  # fmt: skip


def _seen(name: str, unit: str, time: Array, table: Array) -> str:
    value, deviation, baseline, spread, matters, up, down, threshold = table.T
    known = np.flatnonzero(np.isfinite(value))
    last = int(known[-1])
    text = f"Last estimate of the {_words(name)} {with_interval(value[last], deviation[last], unit)} (± 95 %)"
    if not np.isfinite(baseline[-1]):
        return f"{text}; no baseline was learned, so nothing was judged."
    apart = value[last] - baseline[-1]
    text += (
        f", baseline {with_interval(baseline[-1], spread[-1], unit)}: {number(abs(apart / matters[-1]), 2)} "
        f"times the change that warns, {'up' if apart > 0.0 else 'down'}"
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
