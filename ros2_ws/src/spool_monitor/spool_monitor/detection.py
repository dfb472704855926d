"""Detection: all detectors of one valve, shown each moment of its data; their conditions make the events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from spool_core.block import Block
from spool_core.kernels.strokes import Stroke
from spool_core.system import BUDGET
from spool_estimator.estimate import Estimate

from spool_monitor.channels import ChannelWatch, GainChange, ResponseTracker, Signals, ValveResponse, look
from spool_monitor.detectors import Detector, Judgement, Moment, detectors
from spool_monitor.detectors.base import (
    BASELINE_TIME,
    BLIND,
    FALSE_ALARM_INTERVAL,
    MINIMUM_BODY,
    NATURAL_FREQUENCY,
    MonitorSettings,
    NotJudged,
    judgement,
)
from spool_monitor.detectors.unknowable import unknowable
from spool_monitor.event import Condition, Event, Finding, condition_name
from spool_monitor.orders import OrderTracker
from spool_monitor.parameter_drift import VISCOSITY_PER_KELVIN, VISCOUS, ParameterDrift, gain_effect
from spool_monitor.state_file import Baseline
from spool_monitor.warming import OilLevel, ThermometerLag
from spool_monitor.window import Line, WindowTracker, find_line

#: s after the last suspicion before parameters are judged again, in memories of the estimator.
WARY = 2.5

#: Damping ratio of a valve that is not known yet: soft springs in HL68 have 0.24, the most of the paper's.
ASSUMED_DAMPING = 0.25

#: Change of stiffness that dry friction can feign, each in units of what matters.
STICKING = 0.5

#: Dry friction over rms inertia force from which a spool sticks too much to tell its stiffness.
STICKS = 0.55

#: What a detector that can judge says; a machine at rest and a healthy valve that is learned are judged, too.
JUDGES = (Judgement.JUDGED, Judgement.LEARNING, Judgement.NOT_EXCITED)

#: s of blocks without a whole window among them from which gaps keep every detector from judging.
NO_WINDOW = 2.0

#: Share of a change (by its logarithm) that the reference follows with each window: chosen slow.
FOLLOWS = 0.1

#: K by which oil can be colder than when the drag was seen; what says more is no thermometer.
COLDER_MOST = 50.0


@dataclass(slots=True)
class Detection:
    """Shows blocks and estimates to the detectors.

    Attributes:
        parameters: tests of the estimated parameters, by name.
        learned: start values of what the channels show, by name.
        units: of both, by name.
        conditions: delays and state of each fault's event, by the detector's name and the fault's part.
        orders: speed and body of the last seconds, and what turns with the shaft.
        doubt: why nothing that depends on time or frequency can be judged now, empty where it can.

    """

    settings: MonitorSettings
    windows: WindowTracker = field(default_factory=WindowTracker)
    response: ResponseTracker = field(default_factory=ResponseTracker)
    channels: ChannelWatch = field(default_factory=ChannelWatch)
    orders: OrderTracker = field(default_factory=OrderTracker)
    reference: ValveResponse = field(init=False)
    detectors: tuple[Detector, ...] = field(init=False)
    parameters: dict[str, ParameterDrift] = field(init=False)
    learned: dict[str, Baseline] = field(init=False)
    units: dict[str, str] = field(init=False)
    conditions: dict[str, Condition] = field(init=False)
    _conditions_of: dict[str, list[Condition]] = field(init=False)
    doubt: str = ""
    gain: GainChange = field(default_factory=GainChange, init=False)
    _unjudged: tuple[float, str] = field(default=(0.0, ""), init=False)
    _judged_at: int | None = field(default=None, init=False)
    _windowed_at: int = field(default=0, init=False)
    line: Line | None = field(default=None, init=False)
    _suspicions: dict[str, tuple[int, Detector, str]] = field(default_factory=dict, init=False)
    _memory: float = field(default=4.0, init=False)
    _stamp: int = field(default=0, init=False)
    _celsius: float = field(default=math.nan, init=False)
    _followed_at: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        settings = self.settings
        self.reference = configured(settings[NATURAL_FREQUENCY])
        self.detectors = detectors(settings)
        self.conditions = {
            condition_name(one.name, part): Condition(
                one.kind, one.delay, one.off_delay, one.fault(part).partition("/")[2], one.stays
            )
            for one in self.detectors
            for part in one.parts
        }
        self._conditions_of = {
            one.name: [self.conditions[condition_name(one.name, part)] for part in one.parts]
            for one in self.detectors
        }
        duration = settings[BASELINE_TIME]
        self.units = {name: unit for one in self.detectors for name, unit in one.learns.items()}
        self.learned = {name: Baseline(duration) for name in self.units}
        self.parameters = {}
        for one in self.detectors:
            for test in one.drifts:
                relative = test.limit.unit == "1"
                drift = ParameterDrift(test.parameter, settings[test.limit], relative, Baseline(duration))
                self.parameters[test.parameter] = drift
                self.units[test.parameter] = test.unit
        self.set_limits(settings)

    @property
    def distrust(self) -> str:
        """Why parameters can't be judged now, empty where they can."""
        judge = next(one for one in self.detectors if one.name == "friction_drift")
        return self._distrust(self._stamp, judge)

    @property
    def judgements(self) -> dict[str, Judgement]:
        """How far each detector can judge now, by its name; each parameter, as ``detector/parameter``."""
        found = {one.name: one.judgement for one in self.detectors}
        for one in self.detectors:
            for test in one.drifts:
                seen = one.judgement is not Judgement.UNKNOWN
                own = judgement(self.distrust, [self.parameters[test.parameter]]) if seen else one.judgement
                found[condition_name(one.name, test.parameter)] = own
        return found

    def configure(self, settings: MonitorSettings) -> None:
        """Take new settings, of which only the configured natural frequency differs."""
        self.settings = settings
        if math.isnan(self.reference.misfit):
            self.reference = configured(settings[NATURAL_FREQUENCY])

    def set_limits(self, settings: MonitorSettings) -> None:
        """Judge by other thresholds from now on; sums of changes whose size is another one start again."""
        self.settings = settings
        for one in self.detectors:
            one.settings = settings
            for condition in self.conditions_of(one):
                condition.on_delay = one.delay
            for test in one.drifts:
                drift, matters = self.parameters[test.parameter], settings[test.limit]
                drift.run_length = settings[FALSE_ALARM_INTERVAL] * 86400.0
                if drift.matters != matters:
                    drift.matters = matters
                    drift.reset()

    def relearn(self) -> None:
        """Forget what the healthy valve is, as after a repair or with another valve."""
        self.reference, self._followed_at = configured(self.settings[NATURAL_FREQUENCY]), None
        self.response.restart()
        for one in self.detectors:
            one.relearn()
        for drift in self.parameters.values():
            drift.reset()
            drift.baseline.restart()
            drift.referred, drift.temperature = False, math.nan
            drift.oil, drift.lag = OilLevel(), ThermometerLag()
            drift.sensitivity = math.nan
        for start in self.learned.values():
            start.restart()

    def restart(self, period: float, pause: int = 0) -> None:
        """Start again at the first samples, or after missing ones, ``period`` s apart.

        ``pause`` (ns) lies between the last sample and the next one, by their stamps: it counts as no time in
        which there was something to judge. It is negative where a clock was set back.
        """
        self._pause(pause)
        self.response.restart()
        self.windows.restart(period)
        self.channels.restart(period)
        self.orders.restart(period)
        for one in self.detectors:
            one.restart()

    def stroke(self, period: float, pause: int) -> None:
        """Skip the ``pause`` (ns) around a stroke; earlier judgements stay valid."""
        self._pause(pause)
        self.windows.restart(period)
        self.channels.restart(period)

    def update_strokes(self, strokes: Sequence[Stroke], natural_frequency: float) -> list[Event]:
        """Take the strokes that ended; return what began or ended with them."""
        return self._show(strokes[-1].stamp, natural_frequency, strokes=tuple(strokes))

    def _pause(self, pause: int) -> None:
        self._windowed_at += pause
        if self._judged_at is not None:
            self._judged_at += pause
        for drift in self.parameters.values():
            drift.pause(pause)
        for name, (stamp, doubting, reason) in self._suspicions.items():
            self._suspicions[name] = stamp + pause, doubting, reason

    def update(self, block: Block, natural_frequency: float) -> list[Event]:
        """Take a block that continues the last one; return what began or ended with it."""
        events: list[Event] = []
        for window in self.windows.update(block, thinned=BUDGET.behind):
            self._stamp = window.stamp
            seen = self.channels.update(window, self.windows.fresh)
            if seen is not None:
                events += self._show(window.stamp, natural_frequency, channels=seen)
            # Levels are looked at in every other window: what they tell takes seconds to be believed.
            if window.number % 2 == 0:
                events += self._show_signals(look(window), natural_frequency)
            self.line = find_line(window)
            self._windowed_at = window.stamp
            self._look_for_judges(window.stamp)
            silent = self.line is None
            events += self._show(window.stamp, natural_frequency, line=self.line, silent=silent)
        self._stamp = block.end
        if not 0 <= block.end - self._windowed_at < NO_WINDOW * 1e9:
            # There is nothing to see but the time without windows, for the detector of blindness.
            self._windowed_at = self._windowed_at or block.end
            self._look_for_judges(block.end, "the data have a gap in every second")
            moment = self._moment(block.end, natural_frequency)
            for one in self.detectors:
                if isinstance(one, NotJudged):
                    events += self.conditions[one.name].judge(one.update(moment))
        return events

    def conditions_of(self, detector: Detector) -> list[Condition]:
        """Return the conditions of ``detector``, one for each of its faults."""
        return self._conditions_of[detector.name]

    @property
    def blind(self) -> str:
        """Why no detector has been able to judge the valve for ``BLIND`` s, empty where one has."""
        seconds, reason = self._unjudged
        return reason if seconds > BLIND else ""

    def _look_for_judges(self, stamp: int, reason: str = "") -> None:
        """Note at ``stamp`` (ns) for how long no detector of the valve's condition has judged, and why."""
        condition = [one for one in self.detectors if one.kind.task == "condition"]
        judged = not reason and any(one.judgement in JUDGES for one in condition)
        if judged or self._judged_at is None or stamp < self._judged_at:
            self._judged_at = stamp
        if not reason:
            reason = self.distrust
            if not reason and self.reference.natural_frequency == 0.0:
                reason = "the valve's natural frequency is not known"
        seconds = 1e-9 * (stamp - self._judged_at)
        self._unjudged = (0.0, "") if judged else (seconds, reason or "no detector has enough data")

    def update_estimate(self, estimate: Estimate, natural_frequency: float) -> list[Event]:
        """Take an estimate; return what began or ended with it."""
        self._memory, self._celsius = estimate.memory, estimate.oil_temperature.value
        self.channels.take_residual(estimate.residual.value)
        if self.reference.natural_frequency == 0.0 and estimate.natural_frequency.known:
            self.reference = configured(estimate.natural_frequency.value)
        self._stamp = max(self._stamp, estimate.stamp)
        distrust = bool(self.distrust)
        # A spool that sticks more of the time also looks as if it had another spring.
        dry = max(0.0, self.parameters["coulomb_force"].share)
        for parameter in self.parameters.values():
            parameter.tolerance = 0.0
        self.parameters["spring_stiffness"].tolerance = STICKING * dry
        natural = 2.0 * math.pi * estimate.natural_frequency.value
        mass = estimate.parameter("spring_stiffness").value / natural**2
        # Dry friction may hold the spool for so long that little is seen of its spring.
        sticks = estimate.parameter("coulomb_force").value > STICKS * mass * estimate.excitation.value
        for name, parameter in self.parameters.items():
            parameter.tolerance += gain_effect(name, estimate) * self.gain.beyond / parameter.matters
            if name == "spring_stiffness" and sticks:
                parameter.judged = False
            else:
                parameter.update(estimate, distrust=distrust)
        return self._show(estimate.stamp, natural_frequency, estimate=estimate)

    def _show_signals(self, signals: Signals, natural_frequency: float) -> list[Event]:
        shaken = signals.body.rms >= self.settings[MINIMUM_BODY]
        known = shaken and self.reference.natural_frequency > 0.0
        old = self._reference_now()
        response = self.response.update(signals, old) if known else None
        if not shaken:
            self.response.restart()
        events = self._show(signals.stamp, natural_frequency, signals=signals, response=response)
        if response is not None and not self.distrust and 0.7 < response.gain < 1.4:
            # The reference follows what was measured slowly, and never beyond what a valve has.
            ratio = response.natural_frequency / old.natural_frequency
            if not response.misfit > 0.5 and 0.5 < ratio < 2.0:
                self._followed_at = self._celsius
                self.reference = replace(
                    old,
                    natural_frequency=old.natural_frequency * ratio**FOLLOWS,
                    damping=old.damping * min(2.0, max(0.5, response.damping / old.damping)) ** FOLLOWS,
                    misfit=response.misfit,
                )
        return events

    def _reference_now(self) -> ValveResponse:
        """Return the reference with the drag of the oil where that is colder than when the drag was seen."""
        seen = self.parameters[VISCOUS].temperature if self._followed_at is None else self._followed_at
        colder = seen - self._celsius
        if not colder > 0.0:
            return self.reference
        thicker = math.exp(VISCOSITY_PER_KELVIN * min(colder, COLDER_MOST))
        return replace(self.reference, damping=thicker * self.reference.damping)

    def _moment(self, stamp: int, natural_frequency: float) -> Moment:
        # A fault of a sensor or of the data that is raised says why nothing is judged.
        explained = any(
            condition.active is not None
            for name, condition in self.conditions.items()
            if condition.declared.task == "data" and name != NotJudged.name
        )
        return Moment(
            stamp, natural_frequency, self._reference_now(), self.parameters, self.learned,
            unjudged=self._unjudged, explained=explained, orders=self.orders, gain=self.gain,
        )  # fmt: skip

    def _show(self, stamp: int, natural_frequency: float, **new: Any) -> list[Event]:
        """Show the moment with what is ``new`` to those who look at the first of that."""
        what = next(iter(new))
        moment = self._moment(stamp, natural_frequency)._replace(**new)
        events: list[Event] = []
        described = moment.described
        for one in self.detectors:
            found: Finding | tuple[Finding, ...] | None = None
            if one.needs_valve and not described:
                one.judgement, one.suspicious = Judgement.NOT_JUDGED, ""
            elif what in one.looks_at:
                one.held = one.stays and any(each.holds for each in self.conditions_of(one))
                distrust = self._distrust(stamp, one)
                found = one.update(moment._replace(distrust=distrust) if distrust else moment)
            findings = () if found is None else (found,) if isinstance(found, Finding) else found
            for finding in findings:
                events += self.conditions[condition_name(one.name, finding.part)].judge(finding)
            lasts = False
            for each in self._conditions_of[one.name]:
                if each.active is not None:
                    unjudged = one.judgement is not Judgement.JUDGED
                    lasts |= unjudged or each.holds or not all(found.released for found in findings)
            if one.suspicious or lasts:
                reason = one.suspicious or f"{one.name.replace('_', ' ')} is active"
                self._suspicions[one.name] = (stamp, one, reason)
            elif one.refuted:
                self._suspicions.pop(one.name, None)
        return events

    def _distrust(self, now: int, judge: Detector) -> str:
        """Return why ``judge`` can't believe what it sees at ``now`` (ns), empty if it can."""
        if self.doubt:
            return self.doubt
        for stamp, doubting, reason in self._suspicions.values():
            lasts = 0 <= now - stamp <= WARY * self._memory * 1e9
            # Of two that hide each other the one that was raised first is believed.
            first = doubting.rank < judge.rank or self._raised(doubting) > self._raised(judge)
            if lasts and first and unknowable(judge.fault(), doubting.fault()):
                return reason
        return ""

    def _raised(self, detector: Detector) -> bool:
        return any(each.active is not None for each in self.conditions_of(detector))


def configured(natural_frequency: float) -> ValveResponse:
    """Return the response of a valve of which only the natural frequency (Hz) is known."""
    damping = 2.0 * ASSUMED_DAMPING * 2.0 * math.pi * natural_frequency
    return ValveResponse(natural_frequency, damping, 1.0, math.inf, math.nan, math.nan)
