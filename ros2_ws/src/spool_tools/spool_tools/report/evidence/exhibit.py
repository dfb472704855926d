"""Exhibit: one picture of evidence with its caption, in colours that everybody can tell apart."""

from __future__ import annotations

import matplotlib
from spool_core.numbers import Array

matplotlib.use("Agg")

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from spool_core.errors import InputError

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
class Panel:
    """Panel of numbers to zoom into.

    Attributes:
        across, up: labels of the axes, with units.
        x: shape (n,), rising.
        lines: each of n values; NaN where there is none.
        log_x, log_y: logarithmic axes.
        marks: places on the x axis with their texts.
    """

    across: str
    up: str
    x: Array
    lines: tuple[Line, ...]
    log_x: bool = False
    log_y: bool = False
    marks: tuple[tuple[float, str], ...] = ()


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


def made(title: str, build: Callable[[], Exhibit]) -> Exhibit | LeftOut:
    """Return what ``build`` draws, or why it cannot: no picture may keep a report from being written."""
    opened = set(plt.get_fignums())
    try:
        return build()
    except InputError as error:
        reason = str(error)
    except (ArithmeticError, IndexError, KeyError, ValueError, np.linalg.LinAlgError) as error:
        reason = f"the numbers do not allow it ({type(error).__name__}: {error})"
    for number in set(plt.get_fignums()) - opened:
        plt.close(number)
    return LeftOut(title, reason)


def thinned(*rows: Array, points: int = POINTS) -> tuple[Array, ...]:
    """Return every so manieth sample of ``rows`` of one length, so that ``points`` are left at most."""
    step = max(1, -(-rows[0].size // points))
    return tuple(row[::step] for row in rows)


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
