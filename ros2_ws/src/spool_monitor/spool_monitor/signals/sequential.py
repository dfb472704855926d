"""Page's cumulative sum: a sequential test for a change that begins at an unknown time.

Page, E. S.: Continuous inspection schemes, Biometrika 41 (1954); run length of the Brownian approximation as
in Basseville and Nikiforov, Detection of Abrupt Changes (1993), section 5.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from scipy.optimize import brentq


def mean_run_length(threshold: float, allowance: float, variance: float) -> float:
    """Return the mean time, s, to a false alarm of a one-sided sum.

    Args:
        threshold: of the sum, s times the unit of the change.
        allowance: drift of the sum towards zero, per s.
        variance: long-run variance of the change per s.
    """
    if variance <= 0.0:
        return math.inf
    exponent = 2.0 * allowance * threshold / variance
    if exponent > 600.0:
        return math.inf
    return variance / (2.0 * allowance**2) * (math.expm1(exponent) - exponent)


def threshold_for(run_length: float, allowance: float, variance: float) -> float:
    """Return the threshold that has the mean time ``run_length`` (s) to a false alarm."""
    if variance <= 0.0:
        return 0.0
    highest = variance / (2.0 * allowance) * (20.0 + math.log1p(2.0 * allowance**2 * run_length / variance))
    return float(
        brentq(lambda threshold: _log(threshold, allowance, variance, run_length), 1e-12 * highest, highest)
    )


def _log(threshold: float, allowance: float, variance: float, run_length: float) -> float:
    length = mean_run_length(threshold, allowance, variance)
    return 1.0 if math.isinf(length) else math.log(max(length, 1e-300) / run_length)


@dataclass(slots=True)
class CumulativeSum:
    """Two-sided cumulative sum of a change, in s times its unit.

    ``allowance`` is the change that is let pass, ``cap`` the largest that a single value counts for.
    ``since`` (ns) is when the larger sum left zero: the most likely onset (Page 1954).
    """

    allowance: float
    cap: float
    up: float = field(default=0.0, init=False)
    down: float = field(default=0.0, init=False)
    _up_since: int = field(default=0, init=False)
    _down_since: int = field(default=0, init=False)

    def update(self, stamp: int, change: float, seconds: float) -> None:
        """Take the change that held for ``seconds`` until ``stamp`` (ns)."""
        bounded = float(min(self.cap, max(-self.cap, change)))
        begin = stamp - round(seconds * 1e9)
        if self.up == 0.0:
            self._up_since = begin
        if self.down == 0.0:
            self._down_since = begin
        self.up = max(0.0, self.up + seconds * (bounded - self.allowance))
        self.down = max(0.0, self.down + seconds * (-bounded - self.allowance))

    def reset(self) -> None:
        """Begin anew."""
        self.up = self.down = 0.0

    @property
    def side(self) -> int:
        """1 where it went up, -1 where it went down, 0 where neither sum is above zero."""
        return int(self.up > self.down) - int(self.down > self.up)

    @property
    def since(self) -> int:
        """When the change most likely began, ns; 0 where there is none."""
        return {1: self._up_since, -1: self._down_since, 0: 0}[self.side]

    @property
    def size(self) -> float:
        """The larger of both sums."""
        return max(self.up, self.down)
