"""Study of detection limits: how small an effect is named, against a likelihood-ratio test that knows it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.figure import Figure
from spool_blind.case import limit_case, make
from spool_blind.hidden import EFFECTS

from spool_evaluation.results.page import markdown_table, renew_json, save_picture, study_command, write_page
from spool_evaluation.studies.gap import judge
from spool_evaluation.studies.workers import resumed

#: Sizes that are tried over the detection limit: powers of this, from the one to the other power.
STEP, LOWEST, HIGHEST = math.sqrt(2.0), -1, 14
#: The power that is tried first: twice the limit, the target.
FIRST = 2
#: A size beyond this many times the clear one is not made larger.
LARGEST_FACTOR = 2.0

#: Of the size that is named in half of the cases over the detection limit: the study's target.
TARGET = 2.0
#: Relative; the sizes are powers of the root of 2, whose even powers miss whole numbers in the last digits.
ROUNDING = 1e-9

PAGE, PICTURE = "gap_limits.md", "gap_limits.png"
TITLE = "Detection limits of the gap workflow"
#: Where what was not named at any size is drawn.
BEYOND = 128.0
ABOUT = (
    "Smallest size of each effect that is named, over the size that the most powerful test finds in half of "
    "the records. Records of 15 to 20 s at 2 kHz with 1 % noise; excitation, valve and oil are drawn as in "
    "the [blind study](gap_study.md). Medians over the cases, sizes in SI units. The ratio is that of the "
    "effect's size, which grows as a stop's gap or a sensor's rail gets less. What limits mean and what "
    "bounds them: [detection limits](../methods/gap.md#detection-limits)."
)


def run(
    cases: int, seed: int, out: Path, workers: int | None = None, effects: Sequence[str] = tuple(EFFECTS)
) -> list[DetectionLimit]:
    """Look for the smallest size of each effect that is named, under ``cases`` conditions from ``seed`` on.

    ``out`` gets table and picture; what ``gap_limits.jsonl`` there holds already is not looked for again.
    """
    wanted = [(effect, seed + case) for case in range(cases) for effect in effects]
    done = resumed(
        out / "gap_limits.jsonl", DetectionLimit, lambda one: (one.effect, one.seed), smallest_named, wanted,
        "limits", workers,
    )  # fmt: skip
    limits = sorted(done, key=lambda one: wanted.index((one.effect, one.seed)))
    renew_json(out / "gap_limits.json", limits)
    save_picture(limits_figure(limits), out / PICTURE, dpi=150)
    page = write_page(out / PAGE, TITLE, study_command("gap-limit", cases, seed), page_parts(limits))
    print(page.read_text("utf-8"))
    return limits


def smallest_named(item: tuple[str, int]) -> DetectionLimit:
    """Return the smallest size that is named right, by steps of half an octave over the detection limit.

    A size above the smallest is taken to be named, too, one below the largest that is not taken not to be.
    """
    effect, seed = item
    seen = limit_case(seed, effect, moderate=True)
    if seen is None:
        parameter = next(iter(make(seed, effect, factor=1.0, moderate=True).truth[effect]))
        return DetectionLimit(effect, seed, parameter, None, None, None)
    parameter, visible = next(iter(seen.truth[effect].items()))
    top = min(HIGHEST, math.floor(math.log(LARGEST_FACTOR / seen.factor, STEP)))
    values: dict[int, float] = {}

    def named(power: int) -> bool:
        case = make(seed, effect, factor=seen.factor * STEP**power, moderate=True)
        values[power] = case.truth[effect][parameter]
        return judge(case, least_share=0.0).right

    smallest = _smallest(named, top)
    if smallest is None:
        return DetectionLimit(effect, seed, parameter, visible, None, None)
    return DetectionLimit(effect, seed, parameter, visible, values[smallest], STEP**smallest)


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """Detection limit of one effect under one condition.

    Attributes:
        effect: id.
        seed: of the condition.
        parameter: that holds the size.
        visible: its value at the detection limit; ``None`` where no size is detected.
        named: its value at the smallest size that was named right, ``None`` where none was.
        ratio: of the sizes.
    """

    effect: str
    seed: int
    parameter: str
    visible: float | None
    named: float | None
    ratio: float | None


def by_effect(limits: Sequence[DetectionLimit]) -> dict[str, list[DetectionLimit]]:
    """Return the limits of what is detected at all, by effect in order of appearance."""
    found: dict[str, list[DetectionLimit]] = {}
    for limit in limits:
        if limit.visible is not None:
            found.setdefault(limit.effect, []).append(limit)
    return found


def half(limits: Sequence[DetectionLimit]) -> float:
    """Return the ratio at which half of ``limits`` are named; infinite where fewer are at any."""
    return median(math.inf if limit.ratio is None else limit.ratio for limit in limits)


def within(limits: Sequence[DetectionLimit]) -> bool:
    """Return whether half of ``limits`` are named at ``TARGET`` times the limit or less."""
    return half(limits) <= TARGET * (1.0 + ROUNDING)


def sentence(met: int, effects: int) -> str:
    """Return how many effects reach the target, in words."""
    return f"{met} of {effects} effects are named in half of the cases at {TARGET:g} times the limit or less."


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


def _smallest(named: Callable[[int], bool], top: int) -> int | None:
    """Return the smallest power that is ``named``, by strides from ``FIRST`` and then by halving."""
    low, high, stride = LOWEST - 1, min(FIRST, top), 2
    while not named(high):
        low = high
        if high >= top:
            return None
        high, stride = min(top, high + stride), 2 * stride
    while high - low > 1:
        middle = (low + high) // 2
        if named(middle):
            high = middle
        else:
            low = middle
    return high


def _number(value: float) -> str:
    return "-" if math.isinf(value) else f"{value:.2g}"
