"""Result page of the detection limits: a table and a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.figure import Figure

from spool_evaluation.results.page import markdown_table, save_picture, write_page

from .gap_limit_summary import TARGET, DetectionLimit, by_effect, half, sentence, within

PAGE, PICTURE = "gap_limits.md", "gap_limits.png"
TITLE = "Detection limits of the gap workflow"
#: Where what was not named at any size is drawn.
BEYOND = 128.0
ABOUT = (
    "Smallest size of each effect that is named, over the size that the most powerful test finds in half of "
    "the records. Records of 15 to 20 s at 2 kHz with 1 % noise; excitation, valve and oil are drawn as in "
    "the [blind study](gap_study.md). Medians over the cases. What limits mean and what bounds them: "
    "[detection limits](../methods/gap.md#detection-limits)."
)


def write_study(limits: Sequence[DetectionLimit], folder: Path, command: str) -> Path:
    """Write ``gap_limits.md`` and its picture into ``folder``; return the page."""
    save_picture(limits_figure(limits), folder / PICTURE, dpi=150)
    return write_page(folder / PAGE, TITLE, command, page_parts(limits))


def page_parts(limits: Sequence[DetectionLimit]) -> list[str]:
    """Return the page's paragraphs and its table, Markdown."""
    groups = by_effect(limits)
    body = []
    for effect, these in groups.items():
        seen = median(abs(limit.visible) for limit in these if limit.visible is not None)
        named = median(math.inf if limit.named is None else abs(limit.named) for limit in these)
        count = f"{sum(limit.named is not None for limit in these)}/{len(these)}"
        cells = (effect, these[0].parameter, f"{seen:.2g}", _number(named), _number(half(these)), count)
        body.append(cells)
    return [
        ABOUT,
        sentence(sum(within(these) for these in groups.values()), len(groups)),
        f"![size named in half of the cases over the detection limit]({PICTURE})",
        markdown_table(
            ("effect", "by", "detection limit", "named in half", "ratio", "named at any size"), body
        ),
    ]


def limits_figure(limits: Sequence[DetectionLimit]) -> Figure:
    """Return the ratio of each effect: every case, the median, and the target."""
    groups = by_effect(limits)
    order = sorted(groups, key=lambda effect: -half(groups[effect]))
    figure = Figure(figsize=(9.0, 1.6 + 0.32 * len(order)), layout="constrained")
    axis = figure.subplots()
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
    axis.set_xlabel("smallest size that is named over the detection limit")
    axis.grid(axis="x", alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(loc="lower right", fontsize=8)
    return figure


def _number(value: float) -> str:
    return "-" if math.isinf(value) else f"{value:.2g}"
