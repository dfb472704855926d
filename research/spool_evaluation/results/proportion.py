"""Binomial proportion: how many of how many, with a confidence interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from scipy.stats import binomtest, chi2

#: Of every interval that is reported.
CONFIDENCE = 0.95

Method = Literal["exact", "wilson"]


def interval(count: int, of: int, method: Method) -> tuple[float, float]:
    """Return the 95 % interval of a proportion; 0 to 1 where nothing was counted.

    Args:
        count: hits.
        of: trials.
        method: "exact" is Clopper and Pearson's, which never covers less than it says; "wilson" covers 95 %
            on average.
    """
    if not of:
        return 0.0, 1.0
    found = binomtest(count, of).proportion_ci(CONFIDENCE, method)
    return float(found.low), float(found.high)


def poisson_interval(count: int) -> tuple[float, float]:
    """Return the exact 95 % interval of the mean of which ``count`` were counted (Garwood)."""
    tail = 0.5 - 0.5 * CONFIDENCE
    low = float(chi2.ppf(tail, 2 * count)) / 2.0 if count else 0.0
    return low, float(chi2.ppf(1.0 - tail, 2 * count + 2)) / 2.0


@dataclass(frozen=True, slots=True)
class Proportion:
    """Proportion of ``count`` in ``of``, shown with Wilson's 95 % interval."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """The proportion, ``None`` of nothing."""
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds within which the true proportion lies in 95 % of such studies."""
        return interval(self.count, self.of, "wilson")

    def __str__(self) -> str:
        if self.value is None:
            return "-"
        low, high = (100.0 * bound for bound in self.interval)
        return f"{self.count}/{self.of} = {100.0 * self.value:.1f} % ({low:.0f} to {high:.0f})"
