"""Spring change: the stiffness differs from what it was on the healthy valve."""

from __future__ import annotations

import math
from typing import ClassVar

from spool_core.text import Account

from spool_monitor.detectors.base import MonitorLimit
from spool_monitor.event import EventCause, EventKind, Finding, Namur

from .base import ESTIMATE, Detector, DriftTest, Moment, judgement

KIND = EventKind(
    "spring_change",
    300,
    Namur.MAINTENANCE_REQUIRED,
    causes=(
        EventCause(
            "softer",
            301,
            "A centring spring has lost stiffness, or one of the pair is broken.",
            "replace both springs",
        ),
        EventCause(
            "stiffer",
            302,
            "The spool is held by more than its springs, or other springs were fitted.",
            "check which springs are fitted and whether one is coil-bound or dirty",
        ),
    ),
)

STIFFNESS_CHANGE = MonitorLimit("stiffness_change", 0.1, "Relative change that warns.", "1", 0.001, 10.0)


class SpringChange(Detector):
    """Spring change: what the sequential test of the stiffness finds."""

    name = "spring_change"
    kind = KIND
    looks_at = (ESTIMATE,)
    drifts = (DriftTest("spring_stiffness", "N/m", STIFFNESS_CHANGE),)
    on_delay: ClassVar[float] = 3.0
    off_delay: ClassVar[float] = 5.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the estimate of ``moment``, if there is a new one."""
        if moment.estimate is None:
            return None
        stiffness = moment.parameters["spring_stiffness"]
        self.judgement = judgement(moment, (stiffness,))
        cause = "softer" if stiffness.share < 0.0 else "stiffer"
        natural = moment.estimate.natural_frequency.value

        def account() -> Account:
            began = 1e-9 * (moment.stamp - stiffness.since) if stiffness.since else math.nan
            at = f", natural frequency now {natural:.1f} Hz" if math.isfinite(natural) else ""
            return Account(
                f"{stiffness.text()}{at}",
                began=began,
                sure=stiffness.sure,
                outlook=stiffness.outlook,
                hurries=stiffness.hurries,
            )

        return Finding(
            moment.stamp, stiffness.level, stiffness.released, cause, stiffness.latest_change, account
        )
