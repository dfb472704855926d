"""Palette: colours that the colour-blind and a grey printer distinguish, and axes without ornament."""

from __future__ import annotations

import matplotlib

matplotlib.use("Agg")
from matplotlib.axes import Axes

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


def plain(axis: Axes, across: str = "", up: str = "") -> None:
    """Leave the left and the lower line of ``axis`` alone, and label it ``across`` and ``up``."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(DARK)
    axis.tick_params(labelsize=8)
    if across:
        axis.set_xlabel(across, fontsize=9)
    if up:
        axis.set_ylabel(up, fontsize=9)
