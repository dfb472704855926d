"""Stroke times: a solenoid's stroke takes another time than on the healthy valve.

Varnish and tired springs show there first. A median of some strokes is judged by the drift test, as an
estimate that forgets over half of the time between two. What the drag changed since the start is let pass.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from spool_core.kernels.strokes import Stroke
from spool_core.numbers import MEDIAN_TO_DEVIATION
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State

from spool_monitor.detectors.base import (
    FALSE_ALARM_INTERVAL,
    Detector,
    Judgement,
    Moment,
    MonitorLimit,
    MonitorSettings,
)
from spool_monitor.event import EventCause, EventKind, Finding, Namur
from spool_monitor.parameter_drift import VISCOUS, ParameterDrift
from spool_monitor.state_file import Baseline

KIND = EventKind(
    "stroke", 450, Namur.MAINTENANCE_REQUIRED, causes=(EventCause("slower", 451), EventCause("faster", 452))
)

STROKE_CHANGE = MonitorLimit("stroke_change", 0.2, "Relative change of a time to act on.", "1", 0.01, 10.0)

#: Strokes of a mean, and means by which the scatter is followed: chosen, more scatter less and tell later.
STROKES_OF_MEAN, FOLLOWED = 8, 4.0
#: Standard deviation of a median over that of a mean, for normal values.
MEDIAN = math.sqrt(0.5 * math.pi)
#: Share of the solenoid's force that the drag may take: more would make a stroke that does not arrive.
DRAG_SHARE = 0.5

_UNKNOWN = Quantity("", "")


class StrokeTest(Detector):
    """Drift test of one time of the strokes."""

    kind = KIND
    looks_at = ("strokes", "estimate")
    rank = 8

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self.relearn()

    @abstractmethod
    def time(self, stroke: Stroke) -> float:
        """Return the time (s) of ``stroke`` that is judged, NaN where it has none."""

    def relearn(self) -> None:
        """Forget the strokes and the drag of the healthy valve."""
        super().relearn()
        self._taken: list[float] = []
        self._since, self._variance, self._drag, self._healthy = 0, math.nan, math.nan, math.nan
        self._drift = ParameterDrift(self.name, self.settings[STROKE_CHANGE], True, Baseline(math.inf))

    def update(self, moment: Moment) -> Finding | None:
        """Take the strokes of ``moment``; judge where they complete a mean."""
        if moment.estimate is not None and moment.estimate.parameter(VISCOUS).known:
            self._drag = moment.estimate.parameter(VISCOUS).value
        self._taken += [time for time in map(self.time, moment.strokes) if math.isfinite(time)]
        if len(self._taken) < STROKES_OF_MEAN:
            return None
        self._judge(moment)
        drift = self._drift
        self.judgement = Judgement.JUDGED if drift.baseline.frozen else Judgement.LEARNING
        cause = "faster" if drift.share < 0.0 else "slower"
        return Finding(
            moment.stamp, drift.level, drift.released, cause, drift.latest_change, drift.facts, drift.hurries,
            drift.eased,
        )  # fmt: skip

    @property
    def shown(self) -> dict[str, float]:
        """Time now, of the healthy valve, and limits of the warning, s, by ends of their names."""
        drift = self._drift
        if not drift.baseline.frozen or not drift.quantity.known:
            return {}
        low, high = drift.bounds
        return {"": drift.quantity.value, "_healthy": drift.baseline.value, "_low": low, "_high": high}

    def _judge(self, moment: Moment) -> None:
        """Show the mean to the drift test: a median, as single strokes stand out."""
        taken, self._taken = np.array(self._taken), []
        middle = float(np.median(taken))
        variance = (MEDIAN_TO_DEVIATION * float(np.median(np.abs(taken - middle)))) ** 2
        known = not math.isnan(self._variance)
        self._variance += (variance - self._variance) / FOLLOWED if known else 0.0
        self._variance = self._variance if known else variance
        seconds = (moment.stamp - self._since) * 1e-9 if self._since else math.inf
        self._since = moment.stamp
        drift = self._drift
        drift.baseline = moment.learned[self.name]
        drift.matters = self.settings[STROKE_CHANGE]
        drift.run_length = self.settings[FALSE_ALARM_INTERVAL] * 86400.0
        if not drift.baseline.frozen:
            self._healthy = self._drag
        thicker = abs(self._drag / self._healthy - 1.0)
        drift.tolerance = DRAG_SHARE * thicker / drift.matters if math.isfinite(thicker) else 0.0
        deviation = MEDIAN * math.sqrt(self._variance / taken.size)
        drift.update(
            _estimate(moment.stamp, Quantity(self.name, "s", middle, deviation, Validity.VALID), seconds)
        )


class StrokeTime(StrokeTest):
    """Time that the spool travels out of the position in which the valve is judged."""

    name = "stroke_time"
    learns: ClassVar[Mapping[str, str]] = {"stroke_time": "s"}

    def time(self, stroke: Stroke) -> float:
        """Return the travel time of a stroke out."""
        return stroke.travel_time if stroke.out else math.nan


class ReturnTime(StrokeTest):
    """Time that the springs take to bring the spool back."""

    name = "return_time"
    learns: ClassVar[Mapping[str, str]] = {"return_time": "s"}

    def time(self, stroke: Stroke) -> float:
        """Return the travel time of a stroke back."""
        return math.nan if stroke.out else stroke.travel_time


class StrokeDelay(StrokeTest):
    """Time from the command to the first motion out."""

    name = "stroke_delay"
    learns: ClassVar[Mapping[str, str]] = {"stroke_delay": "s"}

    def time(self, stroke: Stroke) -> float:
        """Return the delay of a stroke out."""
        return stroke.delay if stroke.out else math.nan


def _estimate(stamp: int, time: Quantity, seconds: float) -> Estimate:
    """Return what the drift test takes: one valid value, the others unknown."""
    unknown = Quantity("spring_stiffness", "N/m")
    return Estimate(
        stamp, "stroke", State.TRACKING, 0, 0, 0.0, 0.5 * min(seconds, 1e6), (time, unknown),
        _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN,
    )  # fmt: skip
