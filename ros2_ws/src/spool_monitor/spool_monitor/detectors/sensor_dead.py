"""A dead channel: one accelerometer shows next to nothing though the other one does."""

from __future__ import annotations

import math
from typing import ClassVar

from spool_stream.compiled import compiled
from spool_stream.quantity import Quantity, Validity

from ..diagnosis import advice
from ..event import Severity
from ..response import transfer
from ..window import Array
from .base import SIGNALS, Detector, Finding, Judgement, Moment

#: Share of what is due below which a channel is dead, and above which it lives.
DEAD, ALIVE = 0.12, 0.25

#: Response below which a line of the spool says nothing of the body, and share of the usual damping from
#: which both channels have something in common: then neither is dead.
FOLLOWS, COMMON = 0.3, 0.4


class SensorDead(Detector):
    """Compare each channel's level with what the usual response makes of the other one."""

    name = "sensor_dead"
    kind = "sensor_fault"
    looks_at = (SIGNALS,)
    rank = 0
    on_delay: ClassVar[float] = 1.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one."""
        signals = moment.signals
        if signals is None:
            return None
        usual = moment.usual
        due_spool, due_body, seen_body = due_powers(
            signals.frequency, signals.body_power, signals.spool_power, usual.square, usual.damping
        )
        due = {"spool": math.sqrt(due_spool), "body": math.sqrt(due_body)}
        seen = {
            "spool": 0.0 if signals.spool.constant else math.sqrt(float(signals.spool_power.sum())),
            "body": 0.0 if signals.body.constant else math.sqrt(seen_body),
        }
        shares = {name: seen[name] / due[name] for name in due if due[name] >= self.settings.minimum_body}
        if abs(signals.dissipation) > COMMON * usual.damping:
            shares = dict.fromkeys(shares, 1.0)
        self.judgement = Judgement.JUDGED if shares else Judgement.NOT_EXCITED
        name = min(shares, key=lambda one: shares[one], default="spool")
        share = shares.get(name, math.nan)
        dead = share < DEAD
        self.suspicious = f"the {name} accelerometer shows next to nothing" if share < ALIVE else ""
        return Finding(
            moment.stamp,
            Severity.ALARM if dead else None,
            bool(shares) and min(shares.values()) > ALIVE,
            "dead",
            Quantity("channel_level", "1", share, validity=Validity.VALID if shares else Validity.UNKNOWN),
            lambda: (
                f"{name} accelerometer shows {seen[name]:.2g} m/s^2 where {due[name]:.2g} m/s^2 are due"
                + advice(self.kind, "dead")
            ),
        )


@compiled
def due_powers(
    frequency: Array, body: Array, spool: Array, square: float, damping: float
) -> tuple[float, float, float]:
    """Return what the usual response makes of the powers per line: due of the spool and of the body.

    And the body's as seen where the spool follows; elsewhere the spool's noise says nothing of the body.
    """
    due_spool = due_body = seen_body = 0.0
    for i in range(frequency.size):
        power = abs(transfer(frequency[i], square, damping)) ** 2
        due_spool += body[i] * power
        if power > FOLLOWS**2:
            due_body += spool[i] / power
            seen_body += body[i]
    return due_spool, due_body, seen_body
