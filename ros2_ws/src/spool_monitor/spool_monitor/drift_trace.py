"""Trace of the drift tests for reports: what each test saw at each estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # a report of a record runs no monitor
    from spool_estimator.estimate import Estimate

    from spool_monitor.parameter_drift import ParameterDrift

#: Points of one parameter that are kept at most, to bound the memory; of more every other one goes.
DRIFT_TRACE_MOST = 8_000


@dataclass(frozen=True, slots=True)
class DriftPoint:
    """One parameter at one estimate, as its test saw it.

    Attributes:
        stamp: ns.
        value, deviation: of the parameter as it is compared, in its unit; NaN where it is not known.
        baseline, spread: of the healthy valve, in the same unit; NaN while it is learned.
        matters: change that matters, in the same unit; a reported change of twice that is an alarm.
        change: smoothed, in units of the change that matters.
        up, down: cumulative sums of changes to both sides, s times that unit.
        threshold: sum from which a change is reported; NaN while nothing was judged.
    """

    stamp: int
    value: float
    deviation: float
    baseline: float
    spread: float
    matters: float
    change: float
    up: float
    down: float
    threshold: float


@dataclass(slots=True)
class DriftTrace:
    """Trace of all tests of one monitor, and of the natural frequency, in bounded memory.

    Attributes:
        points: of each parameter, by its name.
        natural: stamp (ns), natural frequency and its standard deviation, Hz.
    """

    points: dict[str, list[DriftPoint]] = field(default_factory=dict)
    natural: list[tuple[int, float, float]] = field(default_factory=list)
    _every: int = field(default=1, init=False)
    _count: int = field(default=0, init=False)

    def take(self, estimate: Estimate, parameters: Mapping[str, ParameterDrift]) -> None:
        """Take what the tests ``parameters`` show after ``estimate``."""
        self._count += 1
        if self._count % self._every:
            return
        for name, drift in parameters.items():
            quantity = estimate.referred_viscous_coefficient if drift.referred else estimate.parameter(name)
            size = abs(drift.baseline.value) if drift.relative else 1.0
            point = DriftPoint(
                estimate.stamp,
                quantity.value if quantity.known else math.nan,
                quantity.standard_deviation if quantity.known else math.nan,
                drift.baseline.value,
                drift.baseline.spread,
                drift.matters * size,
                drift.share,
                drift.sum.up,
                drift.sum.down,
                drift.threshold,
            )
            self.points.setdefault(name, []).append(point)
        frequency = estimate.natural_frequency
        self.natural.append((estimate.stamp, frequency.value, frequency.standard_deviation))
        if len(self.natural) > DRIFT_TRACE_MOST:
            self._every *= 2
            self.natural = self.natural[::2]
            self.points = {name: rows[::2] for name, rows in self.points.items()}
