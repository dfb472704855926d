"""Not judged: blocks arrive, but for a minute no detector has been able to judge the valve."""

from __future__ import annotations

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.events.event import Finding, Severity

from .base import LINE, Detector, Judgement, Moment
from .data_fault import KIND as DATA_FAULT

#: s without any judgement after which the level is unknown, and after which the event is raised.
BLIND, REPORTED = 10.0, 60.0


class NotJudged(Detector):
    """Not judged: the time since any detector of the valve's condition could judge; rest is a judgement.

    A fault of a sensor or of the data that is raised already says why: then this event is not raised as well.
    """

    name = "not_judged"
    kind = DATA_FAULT
    looks_at = (LINE,)
    rank = 99

    def update(self, moment: Moment) -> Finding | None:
        """Judge for how long nothing was."""
        self.judgement = Judgement.JUDGED
        seconds, reason = moment.unjudged
        raised = Severity.WARNING if seconds >= REPORTED and not moment.explained else None
        return Finding(
            moment.stamp,
            raised,
            seconds == 0.0,
            "not_judged",
            Quantity("not_judged", "s", seconds, validity=Validity.VALID),
            f"nothing has been judged for {seconds:.0f} s: {reason}"
            if reason
            else "detectors judge the valve again",
        )
