"""How often the intervals cover the truth, and how far the estimates are off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import beta

#: Half the width of a 95 % interval, in standard deviations.
WIDTH = 1.959964
ALL = "all"


@dataclass(frozen=True, slots=True)
class Estimated:
    """One quantity of one fit beside its truth, in ``unit``."""

    model: str
    drive: str
    quantity: str
    unit: str
    truth: float
    value: float
    deviation: float

    @property
    def score(self) -> float:
        """Error over the standard deviation."""
        return (self.value - self.truth) / self.deviation if self.deviation > 0.0 else math.inf

    @property
    def error(self) -> float:
        """Error relative to the truth."""
        return (self.value - self.truth) / self.truth

    @property
    def covered(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return abs(self.score) <= WIDTH


def summary(estimates: Sequence[Estimated]) -> list[dict[str, Any]]:
    """Return coverage and bias by model and quantity, and of everything in the last entry."""
    groups: dict[tuple[str, str], list[Estimated]] = {}
    for entry in estimates:
        groups.setdefault((entry.model, entry.quantity), []).append(entry)
    found = [_counted(model, quantity, entries) for (model, quantity), entries in sorted(groups.items())]
    return [*found, _counted(ALL, ALL, estimates)]


def _counted(model: str, quantity: str, entries: Sequence[Estimated]) -> dict[str, Any]:
    fits = len(entries)
    covered = sum(entry.covered for entry in entries)
    low, high = interval(covered, fits)
    errors = np.array([entry.error for entry in entries])
    return {
        "model": model,
        "quantity": quantity,
        "fits": fits,
        "covered": covered,
        "coverage": covered / fits if fits else math.nan,
        "coverage_low": low,
        "coverage_high": high,
        "bias": float(np.mean(errors)) if fits else math.nan,
        "scatter": float(np.std(errors)) if fits else math.nan,
        "median_deviation": float(np.median([abs(e.deviation / e.truth) for e in entries]))
        if fits
        else math.nan,
    }


def interval(hits: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of Clopper and Pearson for a share of ``hits`` in ``trials``."""
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, trials - hits + 1))
    high = 1.0 if hits == trials else float(beta.ppf(0.975, hits + 1, trials - hits))
    return low, high
