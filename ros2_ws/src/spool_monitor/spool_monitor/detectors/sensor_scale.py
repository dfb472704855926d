"""A mis-scaled channel: the ratio of the sensitivities has changed."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from spool_stream.quantity import Quantity, Validity

from ..diagnosis import advice
from ..event import Severity
from ..response import MEMORY, Response
from ..settings import MonitorSettings
from ..signals import Signals
from .base import Detector, Finding, Judgement, Moment

#: Standard deviations that a change must exceed, and the largest share of it that a deviation may be.
SIGNIFICANCE, UNCERTAIN = 5.0, 0.6

#: Standard deviations from which a large change is suspicious, however imprecise.
DOUBTFUL = 3.0

#: Relative distance from the natural frequency that counts as near.
NEAR = 0.25

#: Gain that no healthy pair has, whatever was learned.
ABSURD = 0.35


class SensorScale(Detector):
    """Judge the gain that the response needs besides stiffness and damping.

    Well below resonance the spool follows its body whatever spring and friction do, so the gain shows there.
    Without such vibration nothing can tell, and it is not judged.
    """

    name = "sensor_scale"
    kind = "sensor_fault"
    rank = 4
    on_delay: ClassVar[float] = 2.0

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._near = -(10**18)

    def update(self, moment: Moment) -> Finding | None:
        """Judge the response of ``moment``, if there is a new one."""
        if moment.signals is None:
            return None
        if moment.distrust:
            self.judgement, self.suspicious = Judgement.NOT_JUDGED, ""
            return None
        response, limit = moment.response, self.settings.gain_change
        shaken = moment.signals.body.rms >= self.settings.minimum_body
        if response is None or not shaken:
            self._untold()
            return None
        if self._resonates(moment.signals, moment.usual):
            self._untold()
            return None
        start = moment.learned["channel_gain"]
        reference = start.value if start.frozen else 1.0
        precise = response.gain_deviation <= UNCERTAIN * limit
        # A spool that sticks at times is not linear, which a gain explains in part.
        limit = (max(limit, SIGNIFICANCE * start.spread) if start.frozen else ABSURD) + 0.3 * response.misfit
        change = response.gain / reference - 1.0
        apart = abs(change) * reference / response.gain_deviation
        if not precise and (apart < DOUBTFUL or abs(change) < limit):
            self._untold()
            return None
        self.judgement = Judgement.JUDGED if start.frozen else Judgement.LEARNING
        if not start.frozen and precise and abs(change) < ABSURD:
            start.learn(moment.stamp, response.gain)
        self.suspicious = "the ratio of the channels has changed" if abs(change) > 0.8 * limit else ""
        return Finding(
            moment.stamp,
            Severity.ALARM if abs(change) > limit and apart > SIGNIFICANCE else None,
            abs(change) < 0.6 * limit,
            "scale",
            Quantity("gain_change", "1", change, response.gain_deviation, Validity.VALID),
            f"the spool's accelerometer reads {100.0 * change:+.0f} % against the body's"
            + advice(self.kind, "scale"),
        )

    def _untold(self) -> None:
        """Say that this moment can't tell."""
        self.judgement, self.suspicious = Judgement.NOT_EXCITED, ""

    def _resonates(self, signals: Signals, usual: Response) -> bool:
        """Whether most of the spool's power is, or was until lately, near the natural frequency.

        There the height of the resonance can't be told from a gain, dry friction makes it bend, and a window
        does not resolve it.
        """
        near = np.abs(signals.frequency / usual.natural_frequency - 1.0) < NEAR
        if float(signals.spool_power[near].sum()) > 0.5 * float(signals.spool_power.sum()):
            self._near = signals.stamp
        return 0 <= signals.stamp - self._near < 4.0 * MEMORY * 1e9
