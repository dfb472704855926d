"""Channel faults: what the samples show of sensors, converters and clocks; a detector for each cause."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar

from spool_core.uncertainty import Quantity, Validity
from spool_estimator.identification.channel_faults import ChannelFault

from spool_monitor.channels import ChannelLook
from spool_monitor.detectors.base import Detector, Judgement, Moment, MonitorSettings
from spool_monitor.detectors.data_fault import KIND as DATA_FAULT
from spool_monitor.event import EACH_CHANNEL, EventCause, Facts, Finding, Severity, sensor_fault

SAME_CHANNEL = sensor_fault(EventCause("same_channel", 606))
WRAP_AROUND = sensor_fault(EventCause("wrap_around", 607))
SENSITIVITY = sensor_fault(EventCause("sensitivity", 608))
AC_COUPLING = sensor_fault(EventCause("ac_coupling", 609))
#: Relative difference of two sizes in a row that are one fault.
AGREE = 0.25


class RowFault(Detector):
    """Fault that the samples themselves show; one look is enough, and one without it ends it."""

    looks_at = ("channels",)
    rank = -1
    off_delay: ClassVar[float] = 5.0

    @property
    @abstractmethod
    def cause(self) -> str:
        """Cause of its event, which is that of the fault."""

    def __init__(self, settings: MonitorSettings) -> None:
        super().__init__(settings)
        self._last: dict[str, ChannelFault | None] = {}
        self._agreed = False

    def restart(self) -> None:
        """Keep what is suspected: a gap in the data repairs no sensor."""

    def update(self, moment: Moment) -> Finding | tuple[Finding, ...] | None:
        """Judge a look at the channels, where there is a new one."""
        look = moment.channels
        if look is None:
            return None
        if moment.distrust:
            self.judgement = Judgement.NOT_JUDGED
            return None
        self.judgement, self.suspicious, self._agreed = Judgement.JUDGED, "", True
        return tuple(self._finding(moment.stamp, look.fault(self.cause, part), part) for part in self.parts)

    def _finding(self, stamp: int, found: ChannelFault | None, part: str = "") -> Finding:
        told = self._last[part] = found or self._last.get(part)
        self.suspicious = found.text if found is not None else self.suspicious
        return Finding(
            stamp,
            Severity.ALARM if found is not None and self._agreed else None,
            found is None,
            self.cause,
            Quantity(
                self.cause,
                "1" if told is None else told.unit,
                math.nan if found is None else found.value,
                validity=Validity.UNKNOWN if found is None else Validity.VALID,
            ),
            Facts(note="not_seen_any_more")
            if found is None
            else Facts.of(Quantity(found.parameter, found.unit, found.value), found.limit, found.channel),
            part=part,
        )


class SameChannel(RowFault):
    """Both channels read one sensor."""

    name = "sensor_same_channel"
    kind = SAME_CHANNEL
    cause = "same_channel"


class WrapAround(RowFault):
    """A channel jumps from one end of its range to the other."""

    name = "sensor_wrap_around"
    parts = EACH_CHANNEL
    kind = WRAP_AROUND
    cause = "wrap_around"


class Repeats(RowFault):
    """A channel repeats its samples."""

    name = "data_repeats"
    parts = EACH_CHANNEL
    kind = DATA_FAULT
    cause = "repeats"


class PairFault(RowFault):
    """Fault that both channels show of each other; two looks in a row that agree are needed to raise it."""

    rank = 2
    off_delay: ClassVar[float] = 3.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge a look at the pair, where there is a new one."""
        look = moment.channels
        if look is None or not look.paired:
            return None
        if moment.distrust or look.pair is None:
            self.judgement = Judgement.NOT_JUDGED if moment.distrust else Judgement.NOT_EXCITED
            self.suspicious = ""
            return None
        self.judgement, self.suspicious = Judgement.JUDGED, ""
        return self._judge(moment, look)

    def _judge(self, moment: Moment, look: ChannelLook) -> Finding:
        return self._finding(moment.stamp, self._compared(look))

    def _compared(self, look: ChannelLook) -> ChannelFault | None:
        """Return the fault that ``look`` shows, and take note whether it agrees with the last one."""
        found, last = look.fault(self.cause), self._last.get("")
        self._agreed = (
            found is not None and last is not None and abs(found.value - last.value) < AGREE * abs(last.value)
        )
        self._last[""] = found
        return found


class Sensitivity(PairFault):
    """Below its resonance the spool follows its body, with the ratio of both sensitivities."""

    name = "sensor_sensitivity"
    kind = SENSITIVITY
    cause = "sensitivity"


class AcCoupling(PairFault):
    """The slow part of one channel is ahead of the other's."""

    name = "sensor_ac_coupling"
    kind = AC_COUPLING
    cause = "ac_coupling"


class ClockStepped(PairFault):
    """From some moment on one channel comes later or earlier than it did.

    Neither stamps nor levels show it. It lasts until the delay is again what it was before the step.
    """

    name = "data_clock_step"
    kind = DATA_FAULT
    cause = "clock_step"
    _usual = math.nan
    _step: ChannelFault | None = None

    def _judge(self, moment: Moment, look: ChannelLook) -> Finding:
        assert look.pair is not None
        found, delay = self._compared(look), look.pair.delay
        if found is not None:
            # A start or a jolt within the readings shows as a step in one look.
            self._step = self._step or (found if self._agreed else None)
        elif self._step is None and math.isfinite(delay):
            self._usual = delay
        elif self._step is not None and math.isfinite(delay):
            moved = delay - (self._usual if math.isfinite(self._usual) else 0.0)
            if abs(moved) < 0.5 * abs(self._step.value):
                self._step = None
        self._agreed = self._step is not None
        return self._finding(moment.stamp, self._step or found)


class ClockDrifts(PairFault):
    """One channel comes ever later than the other: its clock runs slower or faster."""

    name = "data_clock_drift"
    kind = DATA_FAULT
    cause = "clock_drift"
