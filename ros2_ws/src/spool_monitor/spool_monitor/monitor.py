"""Monitor of one valve: blocks and estimates in, health and events out."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

from spool_core.block import Block
from spool_core.block_gate import BlockGate, Fault, Verdict
from spool_core.kernels.samples import OutlierFilter
from spool_core.kernels.strokes import StrokeWatch
from spool_core.text import plural
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State

from spool_monitor.detection import Detection
from spool_monitor.detectors import Judgement, check_settings
from spool_monitor.detectors.base import NATURAL_FREQUENCY, MonitorSettings
from spool_monitor.detectors.data_fault import APART, DataFaultWatch
from spool_monitor.detectors.stale import STALE_AFTER, StaleWatch
from spool_monitor.estimate_gate import EstimateGate
from spool_monitor.event import Condition, Event, Namur, Severity
from spool_monitor.parameter_drift import ALARMS, VISCOUS
from spool_monitor.window import Line

#: s, an estimator that starts with the data needs this long for its first estimate.
FIRST_ESTIMATE = 2.0

#: s beyond ``stale_after`` that a source may take to start: four nodes of a valve start within half of it.
FIRST_BLOCK = 10.0

#: What people call what is judged.
SHOWN = {
    "spring_stiffness": "stiffness",
    "viscous_coefficient": "drag",
    "coulomb_force": "dry friction",
    "resonance": "resonance",
    "stuck_spool": "sticking",
}

#: Samples that may be judged together while nothing is wrong: as many as come together.
MOST_TOGETHER = 1 << 30

#: What the detectors get where the stamps do not confirm the sample rate.
UNCONFIRMED = "the stamps do not confirm the sample rate"


@dataclass(slots=True)
class Monitor:
    """Monitor of one valve. Live node and replay use the same object with the same calls.

    Attributes:
        estimate: the last one that is used: one of a second estimator never is.

    Raises:
        InputError: a limit of ``settings`` does not exist, or contradicts another.

    """

    settings: MonitorSettings = field(default_factory=MonitorSettings)
    gate: BlockGate = field(default_factory=BlockGate)
    outliers: OutlierFilter = field(default_factory=OutlierFilter, init=False)
    strokes: StrokeWatch = field(default_factory=StrokeWatch, init=False)
    detection: Detection = field(init=False)
    estimates: EstimateGate = field(default_factory=EstimateGate, init=False)
    estimate: Estimate | None = field(default=None, init=False)
    _stale: StaleWatch = field(default_factory=StaleWatch, init=False)
    _data_faults: DataFaultWatch = field(default_factory=DataFaultWatch, init=False)
    _stamp: int = field(default=0, init=False)
    _unanswered: float = field(default=0.0, init=False)
    _nobody: str = field(default="", init=False)

    def __post_init__(self) -> None:
        check_settings(self.settings)
        self.detection = Detection(self.settings)

    def update(self, block: Block, verdict: Verdict | None = None) -> list[Event]:
        """Take one block; return what began or ended with it.

        ``verdict``: that of ``gate`` where it has judged the block; without one, the block is judged here.
        """
        verdict = verdict or self.gate.judge(block)
        before = self.gate.before
        pause = block.stamp - before[1] if before is not None and verdict is Verdict.RESTARTS else 0
        for condition in self.conditions if pause else ():
            condition.pause(pause)
        judged_at = block.stamp if verdict is not Verdict.REFUSED or before is None else self._stamp
        events = self._data_faults.judge(self.gate, judged_at)
        if verdict is Verdict.REFUSED:
            return events
        if verdict is Verdict.RESTARTS and not (self.gate.fault and self.gate.fault.loss):
            self.estimates.resume()
        # Only a loss says how long nothing came: a clock that was set or a restarted source does not.
        if self.gate.fault is Fault.DROPPED:
            self._unanswered = 0.0  # the estimator of this computer begins again as well
        if before is not None and self.gate.fault is Fault.LOST:
            silent, patience = ((block.stamp - before[1]) * 1e-9, self.settings[STALE_AFTER])
            # Blocks that came late ended a silence that was reported while it lasted.
            if silent > patience and not before[1] <= self._stale.told < block.stamp:
                events += self._stale.silent(
                    "acceleration", before[1] + round(patience * 1e9), silent, patience
                )
        restarts, raw = verdict is Verdict.RESTARTS, block
        block = self.outliers.cleaned(block, restarts=restarts)
        natural = self._natural_frequency.value
        parts = self.strokes.kept(block, raw, natural, restarts=restarts)
        whole = len(parts) == 1 and parts[0][0] is block  # a hit at a stop is no outlier
        events += self._data_faults.judge_outliers(self.outliers, block.stamp, whole=whole)
        self._stamp = block.end
        events += self._stale.arrived("acceleration", block.stamp)
        if restarts:
            self.detection.restart(block.sample_period, pause)
        self.detection.doubt = "" if self.gate.confirmed else UNCONFIRMED
        self.detection.orders.take(block)  # a stroke is none of the body
        for part, left_out in parts:
            if left_out is not None:
                self._unanswered = 0.0
                self.detection.stroke(part.sample_period, left_out)
                for condition in self._judged:
                    condition.pause(left_out)
            self._unanswered += part.duration
            events += self.detection.update(part, natural)
        if self.strokes.strokes:
            events += self.detection.update_strokes(self.strokes.strokes, natural)
        return events

    def update_estimate(self, estimate: Estimate) -> list[Event]:
        """Take one estimate; return what began or ended with it."""
        used = self.estimates.admit(estimate, self.gate.last.period if self.gate.last is not None else 0.0)
        # The time of another estimator may be any.
        at = estimate.stamp if used else self._stamp or estimate.stamp
        events = self._data_faults.judge_estimate(self.estimates, at)
        if not used:
            return events
        events += self._stale.arrived("estimate", estimate.stamp)
        self.estimate, self._unanswered = estimate, 0.0
        self._stamp = max(self._stamp, estimate.stamp)
        return events + self.detection.update_estimate(estimate, self._natural_frequency.value)

    def update_speed(self, stamp: int, rpm: float) -> None:
        """Take the speed (rev/min) of the machine's shaft at ``stamp`` (ns)."""
        self.detection.orders.take_speed(stamp, rpm)

    def update_temperature(self, stamp: int, celsius: float) -> list[Event]:
        """Take the oil's temperature at ``stamp`` (ns), deg C, which the estimator uses; return what follows.

        Before the first block nothing does: its stamp has nothing to be compared with.
        """
        if self.gate.accepted == 0:
            return []
        return self._data_faults.judge_temperature(stamp, celsius, self._stamp)

    def idle(
        self, without_blocks: float, without_estimates: float, now: int = 0, nobody: str = ""
    ) -> list[Event]:
        """Say how long (s, on a steady clock) nothing has arrived; return what follows from it.

        Before the first block it is the time since somebody publishes, and ``now`` (ns) that of the event.
        ``nobody``: the topic of blocks where nobody publishes on it. That is no fault before the first block,
        as the source may start later; the valve is unknown and the summary says why.
        """
        self._nobody = nobody
        patience = self.settings[STALE_AFTER]
        if self.gate.accepted == 0:
            if nobody or without_blocks <= patience + FIRST_BLOCK:
                return []
            refused, limit = self.gate.refused > 0, patience + FIRST_BLOCK
            return self._stale.nothing_ever(self._stamp or now, without_blocks, limit, refused=refused)
        if without_blocks > patience:
            stamp = self._stamp + round(without_blocks * 1e9)
            return self._stale.silent("acceleration", stamp, without_blocks, patience)
        # Without data there can be no estimates: the estimator is silent where it left data unanswered.
        first = FIRST_ESTIMATE if self.estimate is None else 0.0
        silent = min(without_estimates - without_blocks, self._unanswered)
        if silent > patience + first:
            return self._stale.silent("estimate", self._stamp, silent, patience + first)
        return []

    def room(self, period: float) -> int:
        """Return the samples, ``period`` s apart, that may be judged together.

        Faults of the data begin and end with a block: while one lasts each block is taken by itself, and none
        beyond the end of one that is over.
        """
        faults = [one for name, one in self._data_faults.conditions.items() if name not in APART]
        active = [one.ends for one in (*faults, *self._stale.conditions.values()) if one.active is not None]
        if not active or not period > 0.0:
            return 0 if active else MOST_TOGETHER
        return max(0, int(1e-9 * (min(one or 0 for one in active) - self._stamp) / period))

    def set_natural_frequency(self, frequency: float) -> None:
        """Take the start value (Hz) from a valve's data; estimates replace it."""
        self.settings = self.settings.changed(NATURAL_FREQUENCY, frequency)
        self.detection.configure(self.settings)

    def set_limits(self, settings: MonitorSettings) -> None:
        """Judge by other thresholds from now on; start values and what is active stay.

        Raises:
            InputError: as the constructor.

        """
        check_settings(settings)
        self.settings = settings.changed(NATURAL_FREQUENCY, self.settings[NATURAL_FREQUENCY])
        self.detection.set_limits(self.settings)

    @property
    def line(self) -> Line | None:
        """The strongest line of the body now, ``None`` where there is none."""
        return self.detection.line

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """All that can be raised, each under its own name; a restart restores those that were."""
        return (*self._judged, *self._stale.conditions.values())

    @property
    def _judged(self) -> list[Condition]:
        return [*self.detection.conditions.values(), *self._data_faults.conditions.values()]

    @property
    def level(self) -> HealthLevel:
        """Level of :attr:`health`, without the rest of it."""
        active = [condition for condition in self._judged if condition.active is not None]
        return self._level(active, self._stale.active)

    @property
    def health(self) -> Health:
        """The present judgement."""
        active = [condition for condition in self._judged if condition.active is not None]
        stale = self._stale.active
        level = self._level(active, stale)
        parameters = self.detection.parameters
        viscous, coulomb = (parameters["viscous_coefficient"], parameters["coulomb_force"])
        frozen = all(one.baseline.frozen for one in (viscous, coulomb))
        baseline = BaselineState.FROZEN if frozen else BaselineState.LEARNING
        line = self.line
        known = Validity.UNKNOWN if line is None or stale else Validity.VALID
        # The worst status that applies; what is still being learned is a function check.
        learning = Namur.NORMAL if frozen else Namur.FUNCTION_CHECK
        silent = Namur.FAILURE if level is HealthLevel.STALE else Namur.NORMAL
        raised = (one.declared.cause(one.cause).namur for one in self.conditions if one.active is not None)
        namur = Namur.UNKNOWN if level is HealthLevel.UNKNOWN else max(learning, silent, *raised)
        summary, strokes = self._summary(active, stale, baseline), self.strokes
        if strokes.count:
            times = plural(strokes.count, "time")
            summary += f"; switched {times} today, judged {strokes.share:.0%} of the time"
            for one in self.detection.detectors:
                if one.shown:
                    now, healthy, _, high = (1e3 * value for value in one.shown.values())
                    name = one.name.replace("_", " ")
                    summary += f"; {name} {now:.1f} ms (healthy {healthy:.1f} ms, limit {high:.1f} ms)"
        return Health(
            stamp=self._stamp,
            level=level,
            baseline=BaselineState.UNKNOWN if self.estimate is None else baseline,
            summary=summary,
            active=tuple(dict.fromkeys([*("stale" for _ in stale[:1]), *(one.kind for one in active)])),
            dominant_frequency=_seen("dominant_frequency", "Hz", line.frequency if line else None, known),
            amplification=_seen("amplification", "1", line.amplification if line else None, known),
            natural_frequency=self._natural_frequency,
            viscous_drift=viscous.change,
            coulomb_drift=coulomb.change,
            judgements=tuple(self.detection.judgements.items()),
            namur=namur,
        )

    def _level(self, active: list[Condition], stale: list[str]) -> HealthLevel:
        # Who joins a dead valve late hears the held estimate and no silence that could be timed.
        if stale or (self.estimate is not None and self.estimate.state is State.STALE):
            return HealthLevel.STALE
        if active:
            worst = max(condition.active for condition in active if condition.active is not None)
            return HealthLevel.ALARM if worst is Severity.ALARM else HealthLevel.WARNING
        nothing = self.estimate is None and self.line is None
        return HealthLevel.UNKNOWN if nothing or self.detection.blind else HealthLevel.OK

    @property
    def _natural_frequency(self) -> Quantity:
        if self.estimate is not None and self.estimate.natural_frequency.known:
            return self.estimate.natural_frequency
        configured = self.settings[NATURAL_FREQUENCY]
        if configured <= 0.0:
            return Quantity("natural_frequency", "Hz")
        return Quantity("natural_frequency", "Hz", configured, validity=Validity.HELD)

    def _summary(self, active: list[Condition], stale: list[str], baseline: BaselineState) -> str:
        if stale and self._stale.never_seen:
            return "acceleration never seen: check the topic name"
        if stale:
            return "no " + " and no ".join(stale)
        if active:
            hidden = self._unjudged() if self.detection.distrust else ""
            return ", ".join(one.title for one in active) + hidden
        if self.gate.accepted == 0:
            missing = f"nobody publishes on {self._nobody}: start the source or check its topic name"
            return missing if self._nobody else "waiting for data"
        if self.detection.blind:
            return f"not judged: {self.detection.blind}"
        if self.estimate is None:
            return "waiting for estimates"
        if self.strokes.away:
            return "switched: the spool is away from the position that is judged"
        state = self.estimate.state.name.lower().replace("_", " ")
        return f"{state}, baseline {baseline.text}{self._unjudged()}"

    def _unjudged(self) -> str:
        """Which parameters are not judged although there are estimates, or with a wider limit, and why."""
        distrust = self.detection.distrust
        if self.estimate is None or (self.estimate.state is not State.TRACKING and not distrust):
            return ""
        oil = "unknown" if not self.estimate.oil_temperature.known else "uncertain after a large change"
        told: dict[str, list[str]] = {}
        for test, judgement in self.detection.judgements.items():
            name = test.partition("/")[2]
            drift = self.detection.parameters.get(name)
            if drift is None or judgement is Judgement.LEARNING:
                if distrust and test in SHOWN and judgement is Judgement.NOT_JUDGED:
                    told.setdefault(f"not judged: {distrust}", []).append(SHOWN[test])
                continue
            reason = distrust or "it is too uncertain"
            wide = name == VISCOUS and (drift.assumed or drift.sum.allowance > ALARMS)
            if drift.incomparable or wide:
                reason = f"the oil temperature is {oil}" if name == VISCOUS else "its limit exceeds its value"
            if judgement is not Judgement.JUDGED:
                told.setdefault(f"not judged: {reason}", []).append(SHOWN[name])
            elif wide:
                told.setdefault(f"judged with a wider limit: {reason}", []).append(SHOWN[name])
        return "".join(f"; {', '.join(names)} {verdict}" for verdict, names in told.items())


class HealthLevel(enum.IntEnum):
    """Level of a valve's health; the numbers are those of ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    OK = 1
    WARNING = 2
    ALARM = 3
    STALE = 4


class BaselineState(enum.IntEnum):
    """State of the baseline; the numbers are those of ``spool_msgs/msg/ValveHealth``.

    FROZEN means that the start values are learned and fixed. Whether somebody confirmed them is the stage of
    the kept :class:`~.state_file.BaselineRecord`, and the text does not claim it.
    """

    UNKNOWN = 0
    LEARNING = 1
    FROZEN = 2

    @property
    def text(self) -> str:
        """What people read: unknown, learning or learned."""
        return "learned" if self is BaselineState.FROZEN else self.name.lower()


@dataclass(frozen=True, slots=True)
class Health:
    """Health of the valve at ``stamp`` (ns); fields as in ``ValveHealth``."""

    stamp: int
    level: HealthLevel
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


def _seen(name: str, unit: str, value: float | None, validity: Validity) -> Quantity:
    return Quantity(name, unit) if value is None else Quantity(name, unit, value, validity=validity)
