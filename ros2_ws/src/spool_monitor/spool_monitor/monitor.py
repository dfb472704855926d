"""The monitor's core: blocks and estimates in, events and health out, no clock of its own."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field, replace

from spool_estimator.estimate import Estimate, State
from spool_stream.block import Block
from spool_stream.block_gate import BlockGate, Fault, Verdict
from spool_stream.quantity import Quantity, Validity

from spool_monitor.alarms.alarm_code import Namur, namur
from spool_monitor.alarms.event import Condition, Event, EventState, Severity
from spool_monitor.signals.spectrum import Line

from .detection import Detection
from .detectors import Judgement
from .settings import MonitorSettings

#: s, an estimator that starts with the data needs this long for its first estimate.
FIRST_ESTIMATE = 2.0

#: s beyond ``stale_after`` that a source may take to start: four nodes of a valve start within half of it.
FIRST_BLOCK = 10.0

#: Cause of ``stale`` where no block has ever come.
NEVER_SEEN = "never_seen"

#: Causes of ``data_fault`` that stand for themselves, and those that make what is seen worthless.
SEPARATE, WORTHLESS = ("rate", "source"), ("rate",)

#: What the detectors are told where the stamps do not confirm the sample rate.
UNCONFIRMED = "the stamps do not confirm the sample rate"


class Level(enum.IntEnum):
    """The numbers are those of ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    OK = 1
    WARNING = 2
    ALARM = 3
    STALE = 4


class BaselineState(enum.IntEnum):
    """The numbers are those of ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    LEARNING = 1
    FROZEN = 2


@dataclass(frozen=True, slots=True)
class Health:
    """What the monitor makes of the valve at ``stamp`` (ns); fields as in ``ValveHealth``."""

    stamp: int
    level: Level
    baseline: BaselineState
    summary: str
    active: tuple[str, ...]
    dominant_frequency: Quantity
    amplification: Quantity
    natural_frequency: Quantity
    viscous_drift: Quantity
    coulomb_drift: Quantity
    judgements: tuple[tuple[str, Judgement], ...]
    namur: Namur = Namur.UNKNOWN


@dataclass(slots=True)
class Monitor:
    """Watch one valve. Live node and replay drive the same object with the same calls."""

    settings: MonitorSettings = field(default_factory=MonitorSettings)
    gate: BlockGate = field(default_factory=BlockGate)
    detection: Detection = field(init=False)
    estimate: Estimate | None = field(default=None, init=False)
    _stale: dict[str, Condition] = field(init=False)
    _data_faults: dict[str, Condition] = field(init=False)
    _stamp: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.detection = Detection(self.settings)
        self._stale = {
            source: Condition("stale", 0.0, 0.0, source) for source in ("acceleration", "estimate")
        }
        self._data_faults = {source: Condition("data_fault", 0.0, 5.0, source) for source in ("", *SEPARATE)}

    def update(self, block: Block) -> list[Event]:
        """Take one block; return what began or ended with it."""
        verdict = self.gate.judge(block)
        before = self.gate.before
        events = self._judge_data(
            block.stamp if verdict is not Verdict.REFUSED or before is None else self._stamp
        )
        if verdict is Verdict.REFUSED:
            return events
        # Only a loss says how long nothing came: a clock that was set, or a source that began anew, does not.
        if before is not None and self.gate.fault is Fault.LOST:
            silent = (block.stamp - before[1]) * 1e-9
            if silent > self.settings.stale_after:
                due = before[1] + round(self.settings.stale_after * 1e9)
                events += self._silence("acceleration", due, silent)
        self._stamp = block.end
        if self._stale["acceleration"].active is not None:
            events += self._stale["acceleration"].clear(
                block.stamp, _seconds(0.0), "acceleration arrives again"
            )
        if verdict is Verdict.RESTARTS:
            self.detection.restart(block.sample_period)
        self.detection.doubt = "" if self.gate.confirmed else UNCONFIRMED
        return events + self.detection.update(block, self._natural_frequency.value)

    def update_estimate(self, estimate: Estimate) -> list[Event]:
        """Take one estimate; return what began or ended with it."""
        events = self._stale["estimate"].clear(estimate.stamp, _seconds(0.0), "estimates arrive again")
        self.estimate = estimate
        self._stamp = max(self._stamp, estimate.stamp)
        return events + self.detection.update_estimate(estimate, self._natural_frequency.value)

    def idle(self, without_blocks: float, without_estimates: float, now: int = 0) -> list[Event]:
        """Say how long (s, on a steady clock) nothing has arrived; return what follows from it.

        Before the first block it is the time since the monitor listens, and ``now`` (ns) that of the event.
        """
        events: list[Event] = []
        if self.gate.accepted == 0:
            if without_blocks > self.settings.stale_after + FIRST_BLOCK:
                events += self._never_seen(self._stamp or now, without_blocks)
            return events
        patience = self.settings.stale_after + (FIRST_ESTIMATE if self.estimate is None else 0.0)
        if without_blocks > self.settings.stale_after:
            events += self._silence("acceleration", self._stamp + round(without_blocks * 1e9), without_blocks)
        # Without blocks there can be no estimates: only silence beyond that is the estimator's.
        elif without_estimates - without_blocks > patience:
            events += self._silence("estimate", self._stamp, without_estimates)
        return events

    @property
    def calm(self) -> bool:
        """Whether nothing is wrong with the data, so that a block is judged by its samples alone."""
        conditions = (*self._data_faults.values(), *self._stale.values())
        return all(condition.active is None for condition in conditions)

    def set_natural_frequency(self, frequency: float) -> None:
        """Take the start value (Hz) from a valve's data; estimates replace it."""
        self.settings = replace(self.settings, natural_frequency=frequency)
        self.detection.configure(self.settings)

    def set_limits(self, settings: MonitorSettings) -> None:
        """Judge by other thresholds from now on; start values and what is active stay."""
        self.settings = replace(settings, natural_frequency=self.settings.natural_frequency)
        self.detection.set_limits(self.settings)

    @property
    def line(self) -> Line | None:
        """The strongest line of the body now, ``None`` where there is none."""
        return self.detection.line

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """All that can be raised, each under a name of its own; a restart restores those that were."""
        return (*self._judged, *self._stale.values())

    @property
    def _judged(self) -> list[Condition]:
        return [*self.detection.conditions.values(), *self._data_faults.values()]

    @property
    def health(self) -> Health:
        """The present judgement."""
        active = [condition for condition in self._judged if condition.active is not None]
        stale = [source for source, condition in self._stale.items() if condition.active is not None]
        # Who joins a dead valve late hears the held estimate and no silence that could be timed.
        held = self.estimate is not None and self.estimate.state is State.STALE
        if stale or held:
            level = Level.STALE
        elif active:
            worst = max(condition.active for condition in active if condition.active is not None)
            level = Level.ALARM if worst is Severity.ALARM else Level.WARNING
        elif self.estimate is None and self.line is None:
            level = Level.UNKNOWN
        else:
            level = Level.OK
        viscous, coulomb, _ = self.detection.parameters.values()
        frozen = all(one.baseline.frozen for one in (viscous, coulomb))
        baseline = BaselineState.FROZEN if frozen else BaselineState.LEARNING
        line = self.line
        known = Validity.UNKNOWN if line is None or stale else Validity.VALID
        return Health(
            stamp=self._stamp,
            level=level,
            baseline=BaselineState.UNKNOWN if self.estimate is None else baseline,
            summary=self._summary(active, stale, baseline),
            active=tuple(dict.fromkeys([*("stale" for _ in stale[:1]), *(one.kind for one in active)])),
            dominant_frequency=_seen("dominant_frequency", "Hz", line.frequency if line else None, known),
            amplification=_seen("amplification", "1", line.amplification if line else None, known),
            natural_frequency=self._natural_frequency,
            viscous_drift=viscous.change,
            coulomb_drift=coulomb.change,
            judgements=tuple(self.detection.judgements.items()),
            namur=_namur(level, baseline, [one for one in self.conditions if one.active is not None]),
        )

    @property
    def _natural_frequency(self) -> Quantity:
        if self.estimate is not None and self.estimate.natural_frequency.known:
            return self.estimate.natural_frequency
        configured = self.settings.natural_frequency
        if configured <= 0.0:
            return Quantity("natural_frequency", "Hz")
        return Quantity("natural_frequency", "Hz", configured, validity=Validity.HELD)

    def _summary(self, active: list[Condition], stale: list[str], baseline: BaselineState) -> str:
        if stale and self._stale["acceleration"].cause == NEVER_SEEN:
            return "acceleration never seen: check the topic name"
        if stale:
            return "no " + " and no ".join(stale)
        if active:
            return ", ".join(
                one.kind.replace("_", " ") + (f" ({one.cause.replace('_', ' ')})" if one.cause else "")
                for one in active
            )
        if self.gate.accepted == 0:
            return "waiting for data"
        if self.estimate is None:
            return "waiting for estimates"
        state = self.estimate.state.name.lower().replace("_", " ")
        return f"{state}, baseline {baseline.name.lower()}"

    def _silence(self, source: str, stamp: int, seconds: float) -> list[Event]:
        message = f"no {source} for {seconds:.1f} s"
        return self._stale[source].judge(
            stamp, Severity.ALARM, released=False, cause=source, quantity=_seconds(seconds), message=message
        )

    def _never_seen(self, stamp: int, seconds: float) -> list[Event]:
        message = f"acceleration never seen in {seconds:.0f} s"
        cause = NEVER_SEEN
        if self.gate.refused:
            message, cause = f"no usable acceleration in {seconds:.0f} s", "acceleration"
        return self._stale["acceleration"].judge(
            stamp, Severity.ALARM, released=False, cause=cause, quantity=_seconds(seconds), message=message
        )

    def _judge_data(self, stamp: int) -> list[Event]:
        """Judge what the gate found wrong with the newest block."""
        fault = self.gate.fault
        cause = "" if fault is None else fault.cause
        events: list[Event] = []
        for source, condition in self._data_faults.items():
            new = cause != "" and source == (cause if cause in SEPARATE else "")
            if new or condition.active is not None:
                severity = Severity.ALARM if cause in WORTHLESS else Severity.WARNING
                events += condition.judge(
                    stamp,
                    severity if new else None,
                    released=not new,
                    cause=cause if new else "",
                    quantity=Quantity(
                        "faulty_blocks",
                        "1",
                        float(self._faulty(cause or condition.cause)),
                        validity=Validity.VALID,
                    ),
                    message=self._data(fault if new else None),
                )
        return events

    def _faulty(self, cause: str) -> int:
        """Return how many blocks were faulty for ``cause``; of those that were lost, how many."""
        if cause == "lost":
            return self.gate.lost
        return sum(count for fault, count in self.gate.faults.items() if fault.cause == cause)

    def _data(self, fault: Fault | None) -> str:
        """Return what is wrong with the data in words."""
        gate = self.gate
        counts = f"{gate.lost} blocks lost, {gate.refused} refused since the start"
        if fault is None:
            return counts
        said = fault.value
        if fault is Fault.RATE and math.isfinite(gate.rate.departure):
            said = f"sample_period is {100.0 * gate.rate.departure:+.2g} % off what the stamps show"
        if fault is Fault.FOREIGN:
            said = f"frame_id says {gate.other!r} on the topic of {gate.source!r}"
        return f"{said}; {counts}"


def _namur(level: Level, baseline: BaselineState, active: list[Condition]) -> Namur:
    """Return the worst status that applies; what is still being learned is a function check."""
    if level is Level.UNKNOWN:
        return Namur.UNKNOWN
    learning = Namur.NORMAL if baseline is BaselineState.FROZEN else Namur.FUNCTION_CHECK
    silent = Namur.FAILURE if level is Level.STALE else Namur.NORMAL
    return max(learning, silent, *(namur(one.kind, one.cause) for one in active), Namur.NORMAL)


def _seconds(value: float) -> Quantity:
    return Quantity("silence", "s", value, validity=Validity.VALID)


def _seen(name: str, unit: str, value: float | None, validity: Validity) -> Quantity:
    return Quantity(name, unit) if value is None else Quantity(name, unit, value, validity=validity)


__all__ = [
    "BaselineState",
    "Event",
    "EventState",
    "Health",
    "Level",
    "Monitor",
    "MonitorSettings",
    "Severity",
]
