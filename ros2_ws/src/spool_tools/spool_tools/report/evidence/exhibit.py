"""Exhibit: one picture of evidence with its caption and what it shows, or why it cannot be drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from spool_core.errors import InputError

Array = NDArray[np.float64]

#: Points of a line that a reader can zoom into, at most.
POINTS = 1500


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
