"""Resonance: the machine shakes near the natural frequency and the spool answers more than it is shaken."""

from __future__ import annotations

import math
from typing import ClassVar

from spool_stream.quantity import Quantity, Validity
from spool_stream.text.sentence import Account

from spool_monitor.alarms.event import Severity
from spool_monitor.drift import ALLOWANCE
from spool_monitor.settings import MonitorSettings
from spool_monitor.signals.spectrum import Line

from .base import LINE, Detector, Finding, Judgement, Moment


class Resonance(Detector):
    """Judge the dominant line against the natural frequency.

    ``resonance_band``: relative distance of the line from the natural frequency that counts as near.
    ``amplification_on`` and ``amplification_off``: spool over body acceleration that raises and clears; at
    twice the raising value it is an alarm. ``minimum_body`` (m/s^2, peak): weaker lines are not judged.
    """

    name = "resonance"
    kind = "resonance"
    needs_valve = True
    looks_at = (LINE,)
    on_delay: ClassVar[float] = 0.5
    off_delay: ClassVar[float] = 1.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self.dwell = 0.0
        self._since: int | None = None

    def update(self, moment: Moment) -> Finding | None:
        """Judge the line of ``moment``, if there is a new look."""
        if moment.distrust and (moment.line is not None or moment.silent):
            self.judgement = Judgement.NOT_JUDGED
            return Finding(moment.stamp, None, False, "", Quantity("amplification", "1"), moment.distrust)
        if moment.silent:
            self.judgement = Judgement.NOT_EXCITED
            nothing = Quantity("amplification", "1")
            return Finding(moment.stamp, None, True, "", nothing, "the body is at rest")
        if moment.line is None:
            return None
        return self._judge(moment, moment.line)

    def _judge(self, moment: Moment, line: Line) -> Finding:
        settings, natural = self.settings, moment.natural_frequency
        distance = abs(line.frequency / natural - 1.0)
        strong = line.body >= settings.minimum_body
        self.judgement = Judgement.JUDGED if strong else Judgement.NOT_EXCITED
        indicated = None
        near = distance <= settings.resonance_band and not self._softened(moment, line)
        if strong and near and line.amplification >= settings.amplification_on:
            alarm = line.amplification >= 2.0 * settings.amplification_on
            indicated = Severity.ALARM if alarm else Severity.WARNING
        released = (
            not strong
            or distance > 1.25 * settings.resonance_band
            or line.amplification < settings.amplification_off
        )
        if self._since is None or line.stamp < self._since or (released and self.dwell == 0.0):
            self._since = line.stamp
        if not released:
            self.dwell = (line.stamp - self._since) * 1e-9
        began = self.dwell

        def account() -> Account:
            expected = abs(moment.usual.transfer(line.frequency))
            return Account(
                f"body shakes at {line.frequency:.1f} Hz, natural frequency {natural:.1f} Hz: "
                f"spool amplifies {line.amplification:.1f} times ({expected:.1f} expected) and moves "
                f"{1e3 * line.relative_displacement:.2f} mm in the body",
                began=began,
            )

        if released:
            self._since, self.dwell = None, 0.0
        amplification = Quantity("amplification", "1", line.amplification, math.nan, Validity.VALID)
        return Finding(line.stamp, indicated, released, "", amplification, account)

    def _softened(self, moment: Moment, line: Line) -> bool:
        """Whether the line is near only because the spring has changed: that is the event, and says so."""
        stiffness = moment.parameters["spring_stiffness"]
        if abs(stiffness.share) < ALLOWANCE:
            return False
        healthy = moment.natural_frequency / math.sqrt(max(0.1, 1.0 + stiffness.share * stiffness.matters))
        return abs(line.frequency / healthy - 1.0) > self.settings.resonance_band
