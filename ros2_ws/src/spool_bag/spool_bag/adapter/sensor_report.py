"""Sensor report: how the sources are, in a level, a line and values by key."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from spool_core.alignment.aligner import CLOCK_STEP, Aligner, Channel
from spool_core.alignment.sensor_clock import LEAST_STEP
from spool_core.alignment.sensor_stream import Refusal
from spool_core.block import RecentCounts
from spool_core.node.diagnostics import Level, Status, key
from spool_core.text import plural

#: Relative departure of the stamps from ``sample_rate`` that is a fault: the one at which
#: :class:`spool_core.rate_check.RateCheck` refuses blocks.
WRONG_RATE = 0.0025


#: Looks after which a step of one clock is reported: both may have been set, and one is seen first.
SETTLED_LOOKS = 4


@dataclass(slots=True)
class SensorReport:
    """Sensor report: ``silent`` s since a sensor's last message; ``unusable`` messages, the last reason.

    ``unpaired``: looks in a row at which one clock was set against the other.
    """

    topics: dict[Channel, str]
    stale_after: float
    silent: dict[Channel, float] = field(default_factory=lambda: dict.fromkeys(Channel, math.inf))
    unusable: dict[Channel, int] = field(default_factory=lambda: dict.fromkeys(Channel, 0))
    reason: dict[Channel, str] = field(default_factory=lambda: dict.fromkeys(Channel, ""))
    listeners: int = 0
    recent: RecentCounts = field(default_factory=RecentCounts)
    unpaired: int = 0
    _counted: tuple[int, int] = (0, 0)
    _unusable_before: dict[Channel, int] = field(default_factory=lambda: dict.fromkeys(Channel, 0))

    def advance(self, aligner: Aligner, seconds: float) -> None:
        """Count what was lost and refused in the ``seconds`` since it was asked last."""
        lost = sum(stream.lost for stream in aligner.streams.values())
        refused = sum(stream.refused.total() for stream in aligner.streams.values())
        refused += sum(self.unusable.values())
        self.recent.advance(seconds)
        self.recent.count(max(0, lost - self._counted[0]), max(0, refused - self._counted[1]))
        self._counted = lost, refused
        fault = aligner.fault
        self.unpaired = self.unpaired + 1 if fault is not None and fault.cause == CLOCK_STEP else 0

    def status(self, aligner: Aligner, now: int) -> Status:
        """Return the state of the sensors at ``now`` (ns, on the clock that stamps them)."""
        level, message = self._judgement(aligner)
        return Status("sensors", level, message, self._values(aligner, now))

    def _judgement(self, aligner: Aligner) -> tuple[Level, str]:
        faults = [self._silence(aligner, channel) for channel in Channel]
        for found in (*faults, self._mismatch(aligner)):
            if found is not None:
                return found
        if not aligner.settled or aligner.fault is not None:
            return Level.WARNING, "finding the sensors' rates"
        if self.recent.lost or self.recent.refused:
            why = next((text for text in self.reason.values() if text), "")
            text = (
                f"{plural(self.recent.lost, 'sample')} lost, {self.recent.refused} refused in the last minute"
            )
            return Level.WARNING, f"{text}: {why}" if why else text
        if aligner.wandered:
            text = f"{1e3 * abs(aligner.wandered):.2g} ms apart by now"
            return Level.WARNING, f"the sensors' clocks drift against each other, {text}: synchronise them"
        drift = "" if math.isnan(aligner.drift) else f", drift {1e6 * aligner.drift:+.1f} ppm"
        steps = max(stream.found.resolution if stream.found else 0.0 for stream in aligner.streams.values())
        coarse = f", stamps in steps of {1e3 * steps:g} ms" if 1e9 * steps >= LEAST_STEP else ""
        return Level.OK, f"{aligner.sample_rate:.6g} Hz{drift}{coarse}"

    def _silence(self, aligner: Aligner, channel: Channel) -> tuple[Level, str] | None:
        stream, silent = aligner.streams[channel], self.silent[channel]
        if silent <= self.stale_after:
            return None
        if stream.received == 0:
            if self.unusable[channel]:
                return Level.ERROR, f"{channel.value}: {self.reason[channel]}"
            return Level.WARNING, f"{channel.value}: nothing came on {self.topics[channel]} so far"
        return Level.STALE, f"{channel.value}: nothing on {self.topics[channel]} for {silent:.1f} s"

    def _mismatch(self, aligner: Aligner) -> tuple[Level, str] | None:
        """Return what keeps the two from being one stream, or ``None``."""
        settings = aligner.settings
        for channel, stream in aligner.streams.items():
            if stream.clock is None and stream.refused[Refusal.RATE]:
                return Level.ERROR, f"{channel.value}: {Refusal.RATE.value}"
            if stream.clock is None and stream.doubt:
                advice = "let the driver stamp each sample, or set stamps to arrival"
                return (
                    Level.ERROR,
                    f"{channel.value}: its stamps show no sample rate ({stream.doubt}): {advice}",
                )
            rate = stream.clock.rate if stream.clock is not None else math.nan
            if settings.sample_rate > 0.0 and abs(rate / settings.sample_rate - 1.0) > WRONG_RATE:
                wanted = f"sample_rate says {settings.sample_rate:.6g} Hz: set it to 0 or to what is right"
                return Level.ERROR, f"{channel.value}: its stamps show {rate:.6g} Hz, {wanted}"
        fault = aligner.fault
        if fault is not None and (fault.cause != CLOCK_STEP or self.unpaired >= SETTLED_LOOKS):
            return Level.ERROR, fault.text
        if abs(aligner.apart) > settings.longest_wait:
            advice = "synchronise their clocks, or set stamps to arrival"
            return Level.ERROR, f"the sensors' stamps are {abs(aligner.apart):.6g} s apart: {advice}"
        return None

    def _values(self, aligner: Aligner, now: int) -> dict[str, object]:
        values: dict[str, object] = {}
        for channel, stream in aligner.streams.items():
            name, clock = channel.value, stream.clock
            values |= {
                key(f"{name}_rate", "Hz"): clock.rate if clock else math.nan,
                key(f"{name}_jitter", "s"): 1e-9 * clock.jitter if clock else math.nan,
                key(f"{name}_step_limit", "s"): 1e-9 * stream.step_limit,
                f"{name}_received": stream.received,
                f"{name}_lost": stream.lost,
                f"{name}_restarts": stream.restarts,
                f"{name}_clock_steps": stream.steps,
                **{f"{name}_refused_{one.name.lower()}": stream.refused[one] for one in Refusal},
                f"{name}_unusable": self.unusable[channel],
                key(f"{name}_silent", "s"): self.silent[channel],
                key(f"{name}_age", "s"): 1e-9 * (now - stream.newest) if stream.newest else math.nan,
            }
        return values | {
            key("sample_rate", "Hz"): aligner.sample_rate,
            key("offset", "s"): aligner.offset,
            key("drift", "ppm"): 1e6 * aligner.drift,
            key("spool_behind", "s"): aligner.apart,
            key("clock_step", "s"): aligner.clock_step,
            key("wandered", "s"): aligner.wandered,
            "late_samples": aligner.late,
            "blocks_sent": aligner.sent,
            "blocks_dropped": aligner.dropped,
            "listeners": self.listeners,
        }
