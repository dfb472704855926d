"""Exhibit: one picture of evidence with its caption, in colours that everybody can tell apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from spool_core.errors import InputError
from spool_core.faults import show_traceback, unexpected
from spool_core.numbers import Array

# Pictures are drawn where there is no screen: every module of the report that draws imports this one.
matplotlib.use("Agg")

#: Points of a line that a reader can zoom into, at most.
POINTS = 1500

MEASURED, DARK = "#8a8a8a", "#222222"
#: Okabe and Ito's colours with a dash and a marker each: apart for the colour-blind and in print.
STYLES = (
    ("#0072B2", "-", "o"), ("#D55E00", (0, (5, 2)), "s"), ("#009E73", (0, (5, 1.5, 1, 1.5)), "^"),
    ("#CC79A7", (0, (1.5, 1.2)), "D"), ("#E69F00", (0, (8, 2)), "v"),
    ("#56B4E9", (0, (3, 1, 1, 1, 1, 1)), "P"),
)  # fmt: skip
#: Base model, model with what was found, and what noise alone would show.
BEFORE, AFTER, FLOOR = "#D55E00", "#0072B2", "#555555"
#: Colour and dash (on and off, pixels) of two models, base first: distinguished without colour as well.
MODEL_LOOKS: tuple[tuple[str, tuple[int, ...]], ...] = ((BEFORE, (6, 3)), (AFTER, ()))
#: Dash of a line before, so that it is distinguished from the one after without colour.
DASHED = (0, (5, 2))
#: Inches across a page.
WIDTH = 9.0


@dataclass(frozen=True, slots=True)
class Line:
    """Line of a panel; ``low`` and ``high`` bound its band, ``dash`` is of on and off pixels."""

    label: str
    values: Array
    colour: str
    dash: tuple[int, ...] = ()
    low: Array | None = None
    high: Array | None = None
    width: float = 1.5


@dataclass(frozen=True, slots=True)
class Mark:
    """Event at ``time`` (s): its ``text``, and whether it was raised or cleared."""

    time: float
    text: str
    raised: bool


@dataclass(frozen=True, slots=True)
class Panel:
    """Panel of numbers: drawn, and there to zoom into.

    Attributes:
        across, up: labels of the axes, with units.
        x: shape (n,), rising.
        lines: each of n values; NaN where there is none.
        log_x, log_y: logarithmic axes.
        marks: events on the x axis.
        span: ends of the y axis as it is drawn; ``None`` fits them to the lines.
    """

    across: str
    up: str
    x: Array
    lines: tuple[Line, ...]
    log_x: bool = False
    log_y: bool = False
    marks: tuple[Mark, ...] = ()
    span: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Exhibit:
    """A picture of evidence.

    Attributes:
        title: of it.
        figure: what is printed, and seen where no program runs.
        caption: how to read it, what is good and what is bad.
        seen: what it shows here, in words and numbers.
        panels: the same numbers to zoom into; empty where there is nothing to zoom.
    """

    title: str
    figure: Figure
    caption: str
    seen: str
    panels: tuple[Panel, ...] = ()


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A picture that cannot be drawn, and why."""

    title: str
    reason: str


def subplots(height: float, rows: int = 1, columns: int = 1, **how: Any) -> tuple[Figure, Any]:
    """Return a figure across the page, ``height`` inches high, and its axes, as Matplotlib does."""
    figure, axes = plt.subplots(rows, columns, figsize=(WIDTH, height), layout="constrained", **how)
    return figure, axes


def drawn(panels: Sequence[Panel], heights: Sequence[float], height: float) -> Figure:
    """Return ``panels`` below each other, ``height`` inches in all, shared out as ``heights``.

    A legend stands over a panel that has other lines than the one above; events are named in the first.
    """
    alike = len({panel.across for panel in panels}) == 1
    figure, axes = subplots(height, len(panels), sharex=alike, height_ratios=heights)
    before: list[str] = []
    for axis, panel in zip(axes, panels, strict=True):
        for line in panel.lines:
            if line.low is not None and line.high is not None:
                axis.fill_between(panel.x, line.low, line.high, color=line.colour, alpha=0.3, lw=0)
            dash = (0, line.dash) if line.dash else "-"
            axis.plot(panel.x, line.values, color=line.colour, ls=dash, lw=line.width)
        for mark in panel.marks:
            axis.axvline(mark.time, color=DARK, lw=0.7, ls="-" if mark.raised else ":")
            if mark.raised and axis is axes[0]:
                axis.annotate(
                    mark.text, (mark.time, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2),
                    textcoords="offset points", rotation=90, va="top", fontsize=6.5, color=DARK,
                )  # fmt: skip
        axis.set_xscale("log" if panel.log_x else "linear")
        axis.set_yscale("log" if panel.log_y else "linear")
        axis.margins(x=0.0)
        if panel.span is not None:
            axis.set_ylim(*panel.span)
        plain(axis, "" if alike and axis is not axes[-1] else panel.across, panel.up)
        labels = [line.label for line in panel.lines]
        if labels != before:
            entries = dict(zip(labels, axis.lines, strict=False))  # lines of one name look alike
            axis.legend(
                entries.values(), entries.keys(), fontsize=8, frameon=False, ncols=4, loc="lower left",
                bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2,
            )  # fmt: skip
        before = labels
    return figure


def made(title: str, build: Callable[[], Exhibit]) -> Exhibit | LeftOut:
    """Return what ``build`` draws, or why it cannot: no picture may keep a report from being written."""
    opened = set(plt.get_fignums())
    try:
        return build()
    except InputError as error:
        reason = str(error)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        show_traceback(error)
        reason = f"the numbers do not allow it ({type(error).__name__}: {error})"
    except Exception as error:
        reason = unexpected(error)
    for number in set(plt.get_fignums()) - opened:
        plt.close(number)
    return LeftOut(title, reason)


def thinned(*rows: Array, points: int = POINTS) -> tuple[Array, ...]:
    """Return samples of ``rows`` of one length, ``points`` at most: evenly apart, and the peaks between."""
    size = rows[0].size
    if size <= points:
        return rows
    kept = [np.linspace(0, size - 1, points // 2).astype(np.int64)]
    for piece in np.array_split(np.arange(size), points // (4 * len(rows))):
        for part in (sign * row[piece] for row in rows for sign in (-1.0, 1.0)):
            kept.append(piece[[np.argmax(np.where(np.isnan(part), -np.inf, part))]])
    chosen = np.unique(np.concatenate(kept))
    return tuple(row[chosen] for row in rows)


def listed(parts: Sequence[str]) -> str:
    """Return ``parts`` as people list them: ``a, b and c``."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def plain(axis: Axes, across: str = "", up: str = "") -> None:
    """Leave the left and the lower line of ``axis`` alone, and label it ``across`` and ``up``."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(DARK)
    axis.tick_params(labelsize=8)
    if across:
        axis.set_xlabel(across, fontsize=9)
    if up:
        axis.set_ylabel(up, fontsize=9)
