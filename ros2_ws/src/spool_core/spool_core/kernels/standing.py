"""Frozen acquisition: channels whose samples do not change."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spool_core.block import Samples

from .compiled import compiled

#: s for which both channels, or one of them, may stand still. A vibration of 5 Hz that a coarse converter
#: reads stands at its tops for up to 30 ms; one channel alone may clip, at its tops as well.
BOTH_STAND, ONE_STANDS = 0.05, 0.2
#: Equal samples in a row at least, and shares of the times above from which the newest samples are doubtful.
LEAST, DOUBTFUL = 8, 0.1
BODY, SPOOL, BOTH = range(3)


class StandingArrays(NamedTuple):
    """Arrays of a :class:`StandingWatch`, which kernels move on in place."""

    trailing: NDArray[np.int64]
    longest: NDArray[np.int64]
    last: Samples
    limits: NDArray[np.int64]


@dataclass(slots=True)
class StandingWatch:
    """Standing watch: counts for how long body, spool and both have not changed, however they are split.

    Attributes:
        trailing: changes that did not happen up to the newest sample: of body, of spool, of both, shape (3,).
        longest: the most of them in a row within the samples taken last, with those before, shape (3,).

    """

    sample_period: float
    trailing: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    longest: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    _last: Samples = field(default_factory=lambda: np.full(2, np.nan, np.float32))
    _limits: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        counts = [round(time / self.sample_period) for time in (ONE_STANDS, ONE_STANDS, BOTH_STAND)]
        self._limits = np.maximum(counts, LEAST)

    def reset(self) -> None:
        """Forget every sample."""
        self._last.fill(np.nan)
        self.trailing.fill(0)
        self.longest.fill(0)

    def take(self, samples: Samples) -> None:
        """Take samples of shape (2, n), m/s^2."""
        scan(samples, self.arrays)

    @property
    def arrays(self) -> StandingArrays:
        """What the kernels move on in place."""
        return StandingArrays(self.trailing, self.longest, self._last, self._limits)

    @property
    def stands(self) -> bool:
        """Whether among the samples taken last some are of an acquisition that stands still."""
        return bool((self.longest >= self._limits).any())

    @property
    def doubtful(self) -> bool:
        """Whether the newest samples may be the first ones of a standstill."""
        return bool((self.trailing >= np.maximum(3, DOUBTFUL * self._limits)).any())

    @property
    def age(self) -> float:
        """Time since the standstill that lasts began, s; 0 where none does."""
        standing = self.trailing[self.trailing >= self._limits]
        return float(standing.max()) * self.sample_period if standing.size else 0.0


@compiled
def scan(samples: Samples, watch: StandingArrays) -> bool:
    """Take samples as :class:`StandingWatch` does; return whether some are of a standstill."""
    trailing, longest, last, limits = watch
    longest[:] = 0
    for i in range(samples.shape[1]):
        body, spool = samples[BODY, i] == last[BODY], samples[SPOOL, i] == last[SPOOL]
        trailing[BODY] = trailing[BODY] + 1 if body else 0
        trailing[SPOOL] = trailing[SPOOL] + 1 if spool else 0
        trailing[BOTH] = trailing[BOTH] + 1 if body and spool else 0
        for which in range(3):
            longest[which] = max(longest[which], trailing[which])
        last[BODY], last[SPOOL] = samples[BODY, i], samples[SPOOL, i]
    stands = False
    for which in range(3):
        stands = stands or longest[which] >= limits[which]
    return stands
