"""The detection limits as a table and a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Protocol

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

PICTURE = "gap_limits.png"
#: Of the size that is named in half of the cases over the one that could be seen.
TARGET = 2.0
#: Relative; the sizes are powers of the root of 2, whose even powers miss whole numbers in the last digits.
ROUNDING = 1e-9
#: Where what was not named at any size is drawn.
BEYOND = 128.0


class Found(Protocol):
    """What was found for one effect under one condition."""

    @property
    def effect(self) -> str:
        """Id."""

    @property
    def parameter(self) -> str:
        """By which the size is told."""

    @property
    def visible(self) -> float | None:
        """Value at the limit of seeing."""

    @property
    def named(self) -> float | None:
        """Value at the smallest size that was named."""

    @property
    def ratio(self) -> float | None:
        """Of the sizes."""


def write_page(limits: Sequence[Found], folder: Path, command: str) -> Path:
    """Write ``gap_limits.md`` and its picture into ``folder``; return the page."""
    figure = limits_figure(limits)
    figure.savefig(folder / PICTURE, dpi=150)
    plt.close(figure)
    page = folder / "gap_limits.md"
    page.write_text(limits_text(limits, command))
    return page


def _by_effect(limits: Sequence[Found]) -> dict[str, list[Found]]:
    """Return what was seen at all, by effect in order of appearance."""
    found: dict[str, list[Found]] = {}
    for limit in limits:
        if limit.visible is not None:
            found.setdefault(limit.effect, []).append(limit)
    return found


def half(limits: Sequence[Found]) -> float:
    """Return the ratio at which half of ``limits`` are named; infinite where fewer are at any."""
    return median(math.inf if limit.ratio is None else limit.ratio for limit in limits)


def within(limits: Sequence[Found]) -> bool:
    """Return whether half of ``limits`` are named at ``TARGET`` times the limit or less."""
    return half(limits) <= TARGET * (1.0 + ROUNDING)


def sentence(met: int, effects: int) -> str:
    """Return how many effects reach the target, in words."""
    return f"{met} of {effects} effects are named in half of the cases at {TARGET:g} times the limit or less."


def limits_text(limits: Sequence[Found], command: str) -> str:
    """Return the page, Markdown."""
    groups = _by_effect(limits)
    met = sum(within(these) for these in groups.values())
    lines = [
        "# How small an effect is still named",
        "",
        f"Made by `{command}`.",
        "",
        "The limit of seeing is the size at which the likelihood-ratio test, the most powerful one for two",
        "known alternatives (Neyman and Pearson 1933), finds what is hidden in half of the records, at one",
        "false alarm in a hundred. That test knows the law and the level of the noise, which is white and",
        "normal, and refits base, gain and delay beside it. It is a mean over the noise, so it bounds how",
        "often a size is found, not which single record is: at the limit itself half of the records are, and",
        "below it some. A ratio under 1 is such luck of a few records, or a program that in this case raises",
        "more than one false alarm in a hundred; it is no better test. Sizes are tried in steps of half an",
        "octave, so ratios are known to a factor of 1.4 at best. Records of 15 to 20 s at",
        "2 kHz with 1 % noise; drive, valve and oil are drawn as in the [blind study](gap_study.md).",
        "Medians over the cases.",
        "",
        sentence(met, len(groups)),
        "",
        "No test against noise sees the error of the simulation itself, so an effect must explain 0.05 % of",
        "the spool's acceleration, see [how it decides](gap.md#how-it-decides): what is seen below that is",
        "not named. Laws of friction must be told from each other, window by window, and a stop that is hit",
        "once or twice is told by few samples.",
        "",
        f"![size named in half of the cases over the limit of seeing]({PICTURE})",
        "",
        "| effect | by | limit of seeing | named in half | ratio | named at any size |",
        "|---|---|---|---|---|---|",
    ]
    for effect, these in groups.items():
        seen = median(abs(limit.visible) for limit in these if limit.visible is not None)
        named = median(math.inf if limit.named is None else abs(limit.named) for limit in these)
        count = sum(limit.named is not None for limit in these)
        cells = (effect, these[0].parameter, f"{seen:.2g}", _number(named), _number(half(these)))
        lines.append(f"| {' | '.join(cells)} | {count}/{len(these)} |")
    return "\n".join(lines) + "\n"


def limits_figure(limits: Sequence[Found]) -> Figure:
    """Return the ratio of each effect: every case, the median, and the target."""
    groups = _by_effect(limits)
    order = sorted(groups, key=lambda effect: -half(groups[effect]))
    figure: Figure
    figure, axis = plt.subplots(figsize=(9.0, 1.6 + 0.32 * len(order)), layout="constrained")
    for place, effect in enumerate(order):
        ratios = np.array([BEYOND if limit.ratio is None else limit.ratio for limit in groups[effect]])
        shift = np.linspace(-0.18, 0.18, ratios.size) if ratios.size > 1 else np.zeros(1)
        axis.plot(ratios, place + shift, ls="", marker="o", ms=4, color="#56B4E9", zorder=2)
        middle = min(half(groups[effect]), BEYOND)
        axis.plot(middle, place, ls="", marker="|", ms=18, mew=2.5, color="#0072B2", zorder=3)
    axis.axvline(TARGET, color="#D55E00", lw=1.4, ls=(0, (4, 2)), label=f"target: {TARGET:g}")
    axis.plot([], [], ls="", marker="o", ms=4, color="#56B4E9", label="a case")
    axis.plot([], [], ls="", marker="|", ms=12, mew=2.5, color="#0072B2", label="half of the cases")
    axis.set_xscale("log", base=2)
    ticks = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, BEYOND]
    axis.set_xticks(ticks, [*(f"{tick:g}" for tick in ticks[:-1]), "not\nnamed"])
    axis.set_xlim(0.6, 1.5 * BEYOND)
    axis.set_yticks(range(len(order)), [effect.replace("_", " ") for effect in order])
    axis.set_xlabel("smallest size that is named over the limit of seeing")
    axis.grid(axis="x", alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(loc="lower right", fontsize=8)
    return figure


def _number(value: float) -> str:
    return "-" if math.isinf(value) else f"{value:.2g}"
