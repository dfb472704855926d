"""Resonance: the machine shakes near the natural frequency and the spool answers more than it is shaken."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from spool_core.errors import InputError
from spool_core.uncertainty import Quantity, Validity

from spool_monitor.detectors.base import (
    MINIMUM_BODY,
    Detector,
    Judgement,
    Moment,
    MonitorLimit,
    MonitorSettings,
    on_delay,
)
from spool_monitor.event import EventKind, Facts, Finding, Namur, Severity
from spool_monitor.window import Line

KIND = EventKind("resonance", 100, Namur.OUT_OF_SPECIFICATION)

RESONANCE_BAND = MonitorLimit(
    "resonance_band", 0.15, "Relative distance that counts as near resonance.", "1", 0.01, 1.0
)
AMPLIFICATION_ON = MonitorLimit(
    "amplification_on", 1.8, "Ratio spool/body that raises resonance.", "1", 1.0, 100.0
)
AMPLIFICATION_OFF = MonitorLimit(
    "amplification_off", 1.5, "Ratio that clears resonance, below amplification_on.", "1", 0.5, 100.0
)

#: Bands of resonance from the natural frequency at which a line has left it: chosen, a quarter of hysteresis.
LEAVES = 1.25


#: Change of the stiffness, over the one that matters, that may bring a line near.
SOFTENED = 0.65

ON_DELAY = on_delay("resonance", 0.5)


class Resonance(Detector):
    """The dominant line near the natural frequency; at twice ``AMPLIFICATION_ON`` it is an alarm.

    Below twice ``AMPLIFICATION_OFF`` it is a warning again.

    Lines of the body that are weaker than ``MINIMUM_BODY`` are not judged.
    """

    name = "resonance"
    kind = KIND
    needs_valve = True
    looks_at = ("line",)
    on_delay = ON_DELAY
    off_delay: ClassVar[float] = 1.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self.dwell = 0.0
        self._since: int | None = None

    @classmethod
    def check(cls, settings: MonitorSettings) -> None:
        """Refuse thresholds in the wrong order; see the base class."""
        on, off = settings[AMPLIFICATION_ON], settings[AMPLIFICATION_OFF]
        if off >= on:
            raise InputError(
                f"amplification_off ({off:g}) must lie below amplification_on ({on:g}): "
                "otherwise an event would clear immediately"
            )

    def update(self, moment: Moment) -> Finding | None:
        """Judge the line of ``moment``, if there is a new look."""
        if moment.distrust and (moment.line is not None or moment.silent):
            self.judgement = Judgement.NOT_JUDGED
            return Finding(moment.stamp, None, False, "", Quantity("amplification", "1"))
        if moment.silent:
            self.judgement = Judgement.NOT_EXCITED
            nothing = Quantity("amplification", "1")
            return Finding(moment.stamp, None, True, "", nothing, Facts(note="at_rest"))
        line = moment.line
        if line is None:
            return None
        settings, natural = self.settings, moment.natural_frequency
        band, raises = settings[RESONANCE_BAND], settings[AMPLIFICATION_ON]
        distance = abs(line.frequency / natural - 1.0)
        strong = line.body >= settings[MINIMUM_BODY]
        self.judgement = Judgement.JUDGED if strong else Judgement.NOT_EXCITED
        indicated = None
        near = distance <= band and not self._softened(moment, line)
        if strong and near and line.amplification >= raises:
            indicated = Severity.ALARM if line.amplification >= 2.0 * raises else Severity.WARNING
        weak = line.amplification < settings[AMPLIFICATION_OFF]
        released = not strong or weak or distance > LEAVES * band
        if self._since is None or line.stamp < self._since or (released and self.dwell == 0.0):
            self._since = line.stamp
        if not released:
            self.dwell = (line.stamp - self._since) * 1e-9
        began = line.stamp - round(self.dwell * 1e9)
        eased = released or line.amplification < 2.0 * settings[AMPLIFICATION_OFF]
        amplification = Quantity("amplification", "1", line.amplification, math.nan, Validity.VALID)
        frequency = Quantity("dominant_frequency", "Hz", line.frequency, math.nan, Validity.VALID)
        compared, limit = amplification, 2.0 * raises if indicated is Severity.ALARM else raises
        if released and strong and not weak:
            edge = 1.0 + math.copysign(LEAVES * band, line.frequency - natural)
            compared, limit = frequency, edge * natural

        def facts() -> Facts:
            further = (
                ("natural_frequency", "Hz", natural),
                ("expected_amplification", "1", abs(moment.reference.transfer(line.frequency))),
                ("relative_displacement", "m", line.relative_displacement),
            )
            evidence = (frequency, *(Quantity(*one, validity=Validity.VALID) for one in further))
            note, subject = "" if strong else "at_rest", ""
            if not released and moment.orders is not None:
                found, note = moment.orders.named(line.frequency, line.stamp)
                if found is not None:
                    subject = found.component
                    known = Validity.VALID
                    evidence += (
                        Quantity("order", "1", found.order, validity=known),
                        Quantity("speed", "rev/min", found.rpm, validity=known),
                    )
            return replace(Facts.of(compared, limit, subject, note), began=began, evidence=evidence)

        if released:
            self._since, self.dwell = None, 0.0
        return Finding(line.stamp, indicated, released, "", amplification, facts, eased=eased)

    def _softened(self, moment: Moment, line: Line) -> bool:
        """Whether the line is near only because the spring has changed: that is the event, and says so."""
        stiffness = moment.parameters["spring_stiffness"]
        if abs(stiffness.share) < SOFTENED:
            return False
        healthy = moment.natural_frequency / math.sqrt(max(0.1, 1.0 + stiffness.share * stiffness.matters))
        return abs(line.frequency / healthy - 1.0) > self.settings[RESONANCE_BAND]
