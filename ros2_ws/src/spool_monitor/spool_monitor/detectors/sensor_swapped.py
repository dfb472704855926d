"""Swapped channels: the relative motion gives energy away instead of taking it, as no passive valve does."""

from __future__ import annotations

from typing import ClassVar

from spool_stream.quantity import Quantity, Validity
from spool_stream.text.sentence import Account

from spool_monitor.alarms.event import Severity

from .base import SIGNALS, Detector, Finding, Judgement, Moment

#: Damping against the usual one below which the channels are exchanged, and above which they are not.
NEGATIVE, POSITIVE = -0.3, 0.0


class SensorSwapped(Detector):
    """Judge the sign of the power that the relative motion takes; exchanged channels turn it round."""

    name = "sensor_swapped"
    kind = "sensor_fault"
    needs_valve = True
    looks_at = (SIGNALS,)
    rank = 3
    on_delay: ClassVar[float] = 1.5

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one."""
        if moment.signals is None:
            return None
        if moment.distrust:
            self.judgement, self.suspicious = Judgement.NOT_JUDGED, ""
            return None
        moving = moment.signals.relative_rms >= self.settings.minimum_body
        if not moving:
            self.judgement = Judgement.NOT_EXCITED
            self.suspicious = ""
            return None
        self.judgement = Judgement.JUDGED
        share = moment.signals.dissipation / moment.usual.damping
        self.suspicious = "the relative motion gives energy away" if share < 0.5 * NEGATIVE else ""
        return Finding(
            moment.stamp,
            Severity.ALARM if share < NEGATIVE else None,
            share > POSITIVE,
            "swapped",
            Quantity("dissipation", "1", share, validity=Validity.VALID),
            lambda: Account(
                f"the relative motion shows {share:.2f} of the usual damping",
                "body and spool are exchanged, or one is turned round",
            ),
        )
