"""Scale fault: the ratio of the sensitivities has changed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State

from spool_monitor.channels import MEMORY, Signals, ValveResponse
from spool_monitor.event import EventCause, Facts, Finding, Severity

from .base import ESTIMATE, MINIMUM_BODY, SIGNALS, Detector, Judgement, Moment, MonitorLimit, MonitorSettings
from .sensor_fault import sensor_fault

KIND = sensor_fault(EventCause("scale", 605))

GAIN_CHANGE = MonitorLimit("gain_change", 0.1, "Relative change of a channel's gain.", "1", 0.02, 1.0)

#: What the estimator's model leaves unexplained on top of the reference: least share, and over the reference
#: share, from which no valve explains the channels any more.
UNEXPLAINED, TIMES_REFERENCE = 0.07, 2.5

#: It jumps there from less than this share of it within two estimates: a valve that changes faster than the
#: estimator follows leaves more and more. One that jumps itself is explained again by the second in a row.
BEFORE, IN_A_ROW = 0.35, 2

#: Estimates in a row without any model, after there was one, that show the same.
LOST = 4

#: Windows or estimates over which the reference is followed, and the slow pace where the gain moved.
FOLLOWED, SLOWLY = 20.0, 100.0

#: Standard deviation of the gain above which it says nothing.
IMPRECISE = 0.3

#: Relative distance from the natural frequency that counts as near, shares of the body's and the spool's
#: power there from which the machine shakes the valve at resonance, and s for which that bends the response.
NEAR, SHAKEN, ANSWERED, BENT = 0.17, 0.1, 0.5, 4.0 * MEMORY

#: Of the misfit of the linear response, what a gain may explain, and share of the limit that is suspicious.
MISFIT, SUSPICIOUS = 0.15, 0.6


class SensorScale(Detector):
    """The gain that the response needs besides stiffness and damping, against what it was.

    A change of the gain alone proves nothing: dry friction and the machine's speed bend a linear response.
    But where stiffness, damping and dry friction can't explain the channels any more either, it does. Above
    resonance, where a gain passes for another spring, this needs some vibration below it.
    """

    name = "sensor_scale"
    kind = KIND
    needs_valve = True
    looks_at = (SIGNALS, ESTIMATE)
    rank = 4
    learns: ClassVar[Mapping[str, str]] = {"channel_gain": "1"}
    on_delay: ClassVar[float] = 2.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._reference_residual = math.nan
        self._recent = math.nan
        self._unexplained = self._lost = 0
        self._before = (0.0, 0.0)
        self._found = False
        self._near = -(10**18)

    def update(self, moment: Moment) -> Finding | None:
        """Judge the response of ``moment``, if there is a new one; take note of an estimate's residual."""
        if moment.distrust:
            self._unexplained = self._lost = 0
            if moment.signals is not None:
                self.judgement, self.suspicious = Judgement.NOT_JUDGED, ""
            return None
        if moment.estimate is not None:
            self._compare(moment.estimate)
        if moment.signals is None:
            return None
        shaken = moment.signals.body.rms >= self.settings[MINIMUM_BODY]
        response = moment.response
        told = response is not None and response.gain_deviation < IMPRECISE
        if response is None or not told or not shaken or self._resonates(moment.signals, moment.reference):
            self.judgement, self.suspicious = Judgement.NOT_EXCITED, ""
            return None
        if math.isnan(self._reference_residual):
            self.judgement, self.suspicious = Judgement.LEARNING, ""
            return None
        return self._judge(moment, response)

    def restart(self) -> None:
        """Take note that samples are missing."""
        super().restart()
        self._unexplained = self._lost = 0

    def _compare(self, estimate: Estimate) -> None:
        """Count the estimates in a row that leave more unexplained than the reference."""
        residual = estimate.residual.value
        lost = estimate.state is State.LEARNING and not math.isnan(self._reference_residual)
        self._lost = self._lost + 1 if lost else 0
        if estimate.state is not State.TRACKING or not math.isfinite(residual):
            return
        reference = self._reference_residual
        if math.isnan(reference):
            self._reference_residual = residual
            return
        more = math.sqrt(max(0.0, residual**2 - reference**2))
        limit = max(UNEXPLAINED, TIMES_REFERENCE * reference)
        jumps = min(self._before) < BEFORE * limit < limit < more
        if jumps or (self._unexplained > 0 and more > 0.5 * limit):
            self._unexplained += 1
        else:
            self._unexplained = 0
            self._reference_residual += (min(residual, 2.0 * reference) - reference) / FOLLOWED
        self._before = (self._before[1], more)

    def _judge(self, moment: Moment, response: ValveResponse) -> Finding:
        start = moment.learned["channel_gain"]
        if math.isnan(self._recent):
            self._recent = start.value if start.frozen else response.gain
        change = response.gain / self._recent - 1.0
        limit = self.settings[GAIN_CHANGE] + MISFIT * response.misfit
        proven = self._unexplained >= IN_A_ROW or self._lost >= LOST
        if proven and abs(change) > limit:
            self._found = True
        elif abs(change) < SUSPICIOUS * limit:
            self._found = False
        # A valve that changes faster than the response follows bends it for a moment only.
        self.refuted = not self._found and abs(change) < SUSPICIOUS * limit
        if self._unexplained == self._lost == 0 and not self._found:
            pace = FOLLOWED if abs(change) < SUSPICIOUS * limit else SLOWLY
            self._recent += (response.gain - self._recent) / pace
            start.learn(moment.stamp, response.gain)
        self.judgement = Judgement.JUDGED
        doubtful = (proven or self._found) and abs(change) > SUSPICIOUS * limit
        self.suspicious = "the ratio of the channels has changed" if doubtful else ""
        gain = Quantity("gain_change", "1", change, response.gain_deviation, Validity.VALID)
        return Finding(
            moment.stamp,
            Severity.ALARM if self._found and abs(change) > limit else None,
            not self._found,
            "scale",
            gain,
            lambda: Facts.of(gain, math.copysign(limit, change), "spool"),
        )

    def _resonates(self, signals: Signals, reference: ValveResponse) -> bool:
        """Whether the machine shakes the valve, or did until lately, near its natural frequency.

        There the height of the resonance can't be told from a gain, dry friction makes it bend, and a window
        does not resolve it.
        """
        low, high = (reference.natural_frequency * (1.0 + side * NEAR) for side in (-1.0, 1.0))
        near = slice(*np.searchsorted(signals.frequency, (low, high)))
        shaken = float(signals.body_power[near].sum()) > SHAKEN * signals.body_total
        if shaken and float(signals.spool_power[near].sum()) > ANSWERED * signals.spool_total:
            self._near = signals.stamp
        return 0 <= signals.stamp - self._near < BENT * 1e9
