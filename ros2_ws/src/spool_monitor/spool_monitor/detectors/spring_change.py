"""Spring change: the stiffness differs from what it was on the healthy valve."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from spool_monitor.detectors.base import Detector, DriftTest, Moment, MonitorLimit, judgement, on_delay
from spool_monitor.event import EventCause, EventKind, Facts, Finding, Namur, Severity

KIND = EventKind(
    "spring_change",
    300,
    Namur.MAINTENANCE_REQUIRED,
    causes=(
        EventCause("softer", 301),
        EventCause("stiffer", 302),
        EventCause("sensor_or_spring", 303, open=True),
    ),
)

STIFFNESS_CHANGE = MonitorLimit("stiffness_change", 0.1, "Relative change to act on.", "1", 0.001, 10.0)

#: A sensor that changes looks like a drift at first.
ON_DELAY = on_delay("spring_change", 2.0)


class SpringChange(Detector):
    """What the sequential test of the stiffness finds."""

    name = "spring_change"
    kind = KIND
    looks_at = ("estimate",)
    drifts = (DriftTest("spring_stiffness", "N/m", STIFFNESS_CHANGE),)
    on_delay = ON_DELAY
    off_delay: ClassVar[float] = 5.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the estimate of ``moment``, if there is a new one."""
        if moment.estimate is None:
            return None
        stiffness = moment.parameters["spring_stiffness"]
        self.judgement = judgement(moment.distrust, (stiffness,))
        cause = "softer" if stiffness.share < 0.0 else "stiffer"
        level = stiffness.level
        if moment.gain.bends or moment.gain.unseen:
            cause, level = "sensor_or_spring", level and Severity.WARNING
        natural = moment.estimate.natural_frequency

        def facts() -> Facts:
            return replace(stiffness.facts(), evidence=(natural,) if natural.known else ())

        return Finding(
            moment.stamp, level, stiffness.released or moment.gain.breaks, cause, stiffness.latest_change,
            facts, stiffness.hurries, stiffness.eased, side=int(math.copysign(1.0, stiffness.share)),
        )  # fmt: skip
