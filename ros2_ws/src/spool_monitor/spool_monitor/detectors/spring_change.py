"""Spring change: the stiffness differs from what it was on the healthy valve."""

from __future__ import annotations

import math
from typing import ClassVar

from spool_stream.text.sentence import Account

from .base import ESTIMATE, Detector, Finding, Moment, judgement


class SpringChange(Detector):
    """Raise what the sequential test of the stiffness finds."""

    name = "spring_change"
    kind = "spring_change"
    looks_at = (ESTIMATE,)
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
            return Account(f"{stiffness.text()}{at}", began=began)

        return Finding(
            moment.stamp, stiffness.level, stiffness.released, cause, stiffness.latest_change, account
        )
