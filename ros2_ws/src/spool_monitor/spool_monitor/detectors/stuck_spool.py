"""Stuck spool: the machine shakes and the spool moves with its body."""

from __future__ import annotations

import math
from dataclasses import replace

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.channels import due_power
from spool_monitor.detectors.base import MINIMUM_BODY, Detector, Judgement, Moment, MonitorSettings, on_delay
from spool_monitor.event import EventKind, Facts, Finding, Namur, Severity

KIND = EventKind("stuck_spool", 400, Namur.FAILURE, latching=True)

#: Share of the due relative motion below which the spool is stuck, and above which it moves: chosen apart.
STUCK, MOVES = 0.2, 0.4

#: Inertia force over dry friction (rms over amplitude) from which a healthy spool surely slides.
SLIDES = 1.5

ON_DELAY = on_delay("stuck_spool", 2.0)


class StuckSpool(Detector):
    """The relative acceleration against what the reference response makes of the body's."""

    name = "stuck_spool"
    kind = KIND
    needs_valve = True
    looks_at = ("signals", "estimate")
    rank = 5
    on_delay = ON_DELAY

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._friction = 0.0

    def relearn(self) -> None:
        """Forget the healthy valve's friction."""
        super().relearn()
        self._friction = 0.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one; learn the friction from an estimate."""
        if moment.estimate is not None and not moment.distrust:
            # The dry friction per mass, m/s^2, of the healthy valve.
            coulomb, stiffness = (moment.parameters["coulomb_force"], moment.parameters["spring_stiffness"])
            if coulomb.baseline.frozen and stiffness.baseline.frozen and self._friction == 0.0:
                natural = 2.0 * math.pi * moment.reference.natural_frequency
                mass = stiffness.baseline.value / natural**2
                self._friction = max(0.0, coulomb.baseline.value) / mass
        signals = moment.signals
        if signals is None:
            return None
        if moment.distrust:
            self.judgement, self.suspicious = Judgement.NOT_JUDGED, ""
            return Finding(moment.stamp, None, False, "", Quantity("relative_motion", "1"))
        reference = moment.reference
        due = math.sqrt(due_power(signals.frequency, signals.body_power, reference.square, reference.damping))
        body = math.sqrt(signals.body_total)
        slides = body > max(self.settings[MINIMUM_BODY], SLIDES * self._friction)
        if not slides or due < max(self.settings[MINIMUM_BODY], 0.1 * body):
            self.judgement, self.suspicious = Judgement.NOT_EXCITED, ""
            return Finding(moment.stamp, None, False, "", Quantity("relative_motion", "1"))
        self.judgement = Judgement.JUDGED
        share = signals.relative_rms / due
        # A healthy one that dry friction slows down may lie between STUCK and MOVES for good.
        self.suspicious = "the spool moves with its body" if share < STUCK else ""
        moved = Quantity("relative_motion", "1", share, validity=Validity.VALID)

        def facts() -> Facts:
            shaken = Quantity("body_acceleration", "m/s^2", body, validity=Validity.VALID)
            return replace(Facts.of(moved, STUCK), evidence=(shaken,))

        stuck = Severity.ALARM if share < STUCK else None
        return Finding(moment.stamp, stuck, share > MOVES, "", moved, facts)
