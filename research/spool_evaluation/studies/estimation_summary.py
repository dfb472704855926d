"""Coverage and bias of the estimates: how often the intervals hold the truth, how far values are off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spool_evaluation.results.proportion import interval

#: Half the width of a 95 % interval, in standard deviations.
WIDTH = 1.959964
ALL = "all"


@dataclass(frozen=True, slots=True)
class Estimated:
    """Estimate of one quantity with its truth, in ``unit``."""

    model: str
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


@dataclass(frozen=True, slots=True)
class RecordFit:
    """Fit of one simulated record.

    Attributes:
        number: of the record; with the seed it gives everything.
        model, spring, oil, excitation, noise: what it is.
        estimates: what the fit told of each quantity, with the truth.
        not_observable: parameters that the fit said it cannot tell.
        reason: why there is no fit, or ``None``.
        converged: the fit says so.
        nrmse: of the free run.
        seconds: the fit took.
    """

    number: int
    model: str
    spring: str
    oil: str
    excitation: str
    noise: float
    estimates: tuple[Estimated, ...]
    not_observable: tuple[str, ...]
    reason: str | None
    converged: bool
    nrmse: float
    seconds: float


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
    low, high = interval(covered, fits, "exact")
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
