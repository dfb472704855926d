"""Context of a selection: what no stage changes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Context:
    """Records and options of a selection.

    Attributes:
        start: base from which the fit of the base starts.
        whole: stretches with windows of full length.
        regressed: as many of those as the regression takes.
        progress: takes what is done and the share of the work.
        left_out: names of stages that are not run.
        deadline: by the monotonic clock, s, after which nothing further is looked for.
    """

    start: Point
    whole: Sequence[Stretch]
    regressed: Sequence[Stretch]
    progress: Progress
    left_out: frozenset[str] = frozenset()
    deadline: float = math.inf

    @property
    def late(self) -> bool:
        """Whether the time that a search may take is over."""
        return time.monotonic() > self.deadline

    @property
    def reach(self) -> float:
        """The largest travel, m: the 99.9 % quantile."""
        return max(float(np.quantile(np.abs(s.motion.displacement), 0.999)) for s in self.whole)
