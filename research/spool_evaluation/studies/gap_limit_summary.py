"""Detection limits counted: how small an effect is still named, against the limit of an ideal test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

#: Of the size that is named in half of the cases over the detection limit: the study's target.
TARGET = 2.0
#: Relative; the sizes are powers of the root of 2, whose even powers miss whole numbers in the last digits.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """Detection limit of one effect under one condition.

    Attributes:
        effect: id.
        seed: of the condition.
        parameter: by which the size is told.
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
