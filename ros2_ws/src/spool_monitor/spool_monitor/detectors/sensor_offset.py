"""Offset: the mean of one channel moves against the other's, which no vibration does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.event import EventCause, Facts, Finding, Severity

from .base import SIGNALS, Detector, Judgement, Moment, MonitorLimit, MonitorSettings
from .sensor_fault import sensor_fault

KIND = sensor_fault(EventCause("offset", 603))

OFFSET_CHANGE = MonitorLimit("offset_change", 0.5, "Change of a channel's mean.", "m/s^2", 0.01, 1e3)

#: Windows that the mean is smoothed over.
SMOOTHING = 4.0


class SensorOffset(Detector):
    """The difference of the channels' means against what it was; a tilt moves both alike."""

    name = "sensor_offset"
    kind = KIND
    looks_at = (SIGNALS,)
    rank = 2
    learns: ClassVar[Mapping[str, str]] = {"body_mean": "m/s^2", "spool_mean": "m/s^2"}
    on_delay: ClassVar[float] = 3.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._means = {"body": math.nan, "spool": math.nan}

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one."""
        signals = moment.signals
        if signals is None:
            return None
        if moment.distrust:
            self.judgement = Judgement.NOT_JUDGED
            return None
        for name, channel in (("body", signals.body), ("spool", signals.spool)):
            old = self._means[name]
            self._means[name] = channel.mean if math.isnan(old) else old + (channel.mean - old) / SMOOTHING
        starts = {name: moment.learned[f"{name}_mean"] for name in self._means}
        if not all(start.frozen for start in starts.values()):
            for name, start in starts.items():
                start.learn(moment.stamp, self._means[name])
            self.judgement = Judgement.LEARNING
            return None
        self.judgement = Judgement.JUDGED
        moved = {name: self._means[name] - starts[name].value for name in starts}
        apart = moved["spool"] - moved["body"]
        spread = math.hypot(*(start.spread for start in starts.values()))
        limit = max(self.settings[OFFSET_CHANGE], 8.0 * spread)
        name = max(moved, key=lambda one: abs(moved[one]))
        offset = Quantity("offset_change", "m/s^2", moved[name], spread, Validity.VALID)

        def facts() -> Facts:
            mean = Quantity(f"{name}_mean", "m/s^2", self._means[name], validity=Validity.VALID)
            own = Facts.of(offset, math.copysign(limit, moved[name]), name)
            return replace(own, evidence=(mean,))

        # A constant is filtered away before anything is estimated: parameters may still be judged.
        return Finding(
            moment.stamp,
            Severity.WARNING if abs(apart) >= limit else None,
            abs(apart) < 0.6 * limit,
            "offset",
            offset,
            facts,
        )

    def restart(self) -> None:
        """Begin the smoothing again."""
        super().restart()
        self._means = dict.fromkeys(self._means, math.nan)
