"""Run of one valve-day: the cores of estimator and monitor over simulated operation, in one thread.

What is real and what is surrogate: the monitor, its state files, the watch for a model gap, the oil's law and
all detectors are the ones that ship. Around events the real estimator gets simulated blocks, and so does the
monitor. In between the monitor gets estimates of the surrogate and no blocks.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from spool_core.block import Block
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.gap_watch import GapWatch
from spool_estimator.identification.oil import LAG, USUAL_DEVIATION
from spool_monitor.detectors import MonitorSettings
from spool_monitor.detectors.resonance import RESONANCE_BAND
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_monitor.valve_state import ValveState
from spool_sim.lubrication import OilTable
from spool_sim.simulator import DEFAULT_START_STAMP

from spool_operation.faults import Hurt
from spool_operation.peers import judged_share
from spool_operation.surrogate import Surrogate, SurrogateRow, errors, load_surrogate
from spool_operation.world import BLOCKS, Hold, ValveDay, draw_day, features

SECOND = 1_000_000_000
#: s of blocks that only the estimator gets before the monitor sees them: it forgets over 4 s.
RUN_IN = 12
#: s between two estimates that are shown while the machine stands: all are alike.
STANDING = 60
#: s of the baseline's commissioning, and between it and the day: from then on the state comes from the file.
COMMISSIONING, SINCE = 40, 30 * 86_400
#: s around lost data, and around a machine that is started, in which their events are no false alarms.
FOLLOWS = 15.0
#: The drift tests, in the order of the rows of a trace.
TRACED = ("spring_stiffness", "viscous_coefficient", "coulomb_force")
#: Causes that leave the right one open.
LEAVES_OPEN = ("oil_or_wear", "sensor_or_friction", "sensor_or_spring")


@dataclass(frozen=True, slots=True)
class RaisedEvent:
    """Event as it was raised: s of the day, kind, cause, and whether it is an alarm."""

    at: float
    kind: str
    cause: str
    alarm: bool


@dataclass(frozen=True, slots=True)
class DayOutcome:
    """What the monitor made of a valve-day.

    Attributes:
        seed, faulty: the day.
        name, speed, severity: of its fault.
        found: the event that names the fault, ``None`` where it was missed.
        right: whether the first event of the fault's kind that leaves no cause open names the right one.
        delay: s from when the change is as large as it has to be found to ``found``.
        since_begin: the same from the fault's begin.
        false: what else was raised.
        thermometer: whether the oil's temperature was measured.
        running, blocks: s of production, and of real blocks.
        cost: s of computing.
        state: bytes of the state files at the end.

    """

    seed: int
    faulty: bool
    name: str = ""
    speed: str = ""
    severity: float = 0.0
    found: RaisedEvent | None = None
    right: bool = False
    delay: float = math.nan
    since_begin: float = math.nan
    false: tuple[RaisedEvent, ...] = ()
    thermometer: bool = True
    running: float = 0.0
    blocks: float = 0.0
    cost: float = 0.0
    state: int = 0


@dataclass(slots=True)
class Trace:
    """What the drift tests compared: s, and changes over the ones that matter, NaN where not judged."""

    times: list[float] = field(default_factory=list)
    shares: list[tuple[float, float, float]] = field(default_factory=list)

    def take(self, second: float, monitor: Monitor) -> None:
        """Take what the last estimate showed."""
        row = [judged_share(monitor.detection.parameters[name]) for name in TRACED]
        self.times.append(second)
        self.shares.append((row[0], row[1], row[2]))


class DayRun:
    """Run of one day; its cores are built as the nodes build them."""

    def __init__(self, day: ValveDay, folder: Path, trace: Trace | None = None) -> None:
        self.day, self.folder, self.trace = day, folder, trace
        self.events: list[tuple[float, Event]] = []
        self.blocks = 0.0
        self._latest = 0.0
        self._samples = 0
        self.origin = DEFAULT_START_STAMP + SINCE * SECOND
        self.surrogate = SurrogateEstimates(day, load_surrogate())
        self._start()

    def run(self) -> None:
        """Commission the valve, restart the software, and live the day."""
        for estimate in self.surrogate.commissioning(COMMISSIONING, DEFAULT_START_STAMP):
            self._show(estimate, -math.inf)
        if self.state.baseline.current is None:  # a valve whose parameters the excitation does not show
            return
        self._restart()
        self._stand(-self.day.weekend, 0.0)
        for kind, begin, end, hold in self._pieces():
            if kind == "real":
                self._real(begin, end)
            elif hold is None:
                self._stand(float(begin), float(end))
            else:
                for second, estimate in self.surrogate.production(hold, begin, end, self.origin):
                    self._show(estimate, second)
                    if any(self._latest < at <= second for at in self.day.restarts):
                        self._restart()
                    self._latest = second
                self._ended()

    def _ended(self) -> None:
        """Do nothing: a subclass takes sizes at the end of a hold."""

    def close(self) -> None:
        """Release the state folder."""
        self.state.close()

    @property
    def state_size(self) -> int:
        """Bytes of the state files."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())

    def _start(self) -> None:
        valve = self.day.valve
        self.monitor = Monitor(MonitorSettings(natural_frequency=valve.natural_frequency))
        self.gap = GapWatch()
        self.state = ValveState(self.monitor, self.folder, lambda _: None)
        self.state.open()
        self.state.baseline.identify(valve.id, valve.oil or "")

    def _restart(self) -> None:
        """End both programs and start them again; what is kept comes from the state file."""
        self.state.keep_alarms()
        self.state.close()
        self._start()

    def _pieces(self) -> Iterator[tuple[str, int, int, Hold | None]]:
        """Yield (kind, begin, end, hold) of all parts of the day in order; no hold: the machine stands."""
        edges = {0, self.day.seconds}
        for hold in self.day.holds:
            edges |= {hold.begin, hold.end}
        for begin, end in self.day.real:
            edges |= {begin, end}
        order = sorted(edge for edge in edges if 0 <= edge <= self.day.seconds)
        for begin, end in pairwise(order):
            real = any(first <= begin < last for first, last in self.day.real)
            held = next((one for one in self.day.holds if one.begin <= begin < one.end), None)
            yield "real" if real else "surrogate", begin, end, held

    def _stand(self, begin: float, end: float) -> None:
        last = self.monitor.estimate
        if last is None:
            return
        held = replace(last.held(), state=State.NOT_EXCITED)
        for second in np.arange(begin, end, STANDING):
            self._show(replace(held, stamp=self._stamp(float(second))), float(second))

    def _stamp(self, second: float) -> int:
        """Return the stamp of a second of the day."""
        return self.origin + round(float(self.day.operated(second)) * 1e9)

    def _show(self, estimate: Estimate, second: float) -> None:
        """Show the monitor an estimate, as the nodes do: all are of one estimator, however they are made."""
        self._samples += 1
        estimate = replace(estimate, samples=self._samples)
        self.monitor.estimates.resume()
        change = self.gap.update(estimate)
        if change is not None:
            self.events.append((second, change))
        self._told(self.monitor.update_estimate(estimate), second)
        if self.state.baseline.update(estimate):
            self.state.keep_baseline()
        if self.trace is not None and second >= 0.0:
            self.trace.take(second, self.monitor)

    def _told(self, events: list[Event], second: float) -> None:
        for event in events:
            self.events.append((second, event))
            self.state.alarms.update(event)
            raised = event.state is EventState.RAISED
            self.gap.hear(event.kind, event.source or event.cause, raised=raised)
        if events:
            self.state.keep_alarms()

    def _real(self, begin: int, end: int) -> None:
        """Simulate blocks from ``begin`` to ``end`` (s) and show them to estimator and monitor."""
        day = self.day
        first = max(0, begin - RUN_IN)
        hurt = None if day.fault is None or not day.fault.needs_blocks else Hurt(
            day.fault, day.measuring.noise, day.seed
        )  # fmt: skip
        # What lies between is skipped: an estimator that goes on would see the oil warm in one step.
        estimator = Estimator(settings_for(day.valve))
        before: Block | None = None
        for second, block in self._blocks(estimator, first, end):
            if any(low <= second < high for low, high in day.gaps):
                if round(second * BLOCKS) % BLOCKS == 0:
                    silent = second - next(low for low, high in day.gaps if low <= second < high)
                    self._told(self.monitor.idle(silent, silent, block.stamp), second)
                continue
            shown = block if hurt is None else hurt(block, second)
            estimates = estimator.update(shown)
            if second < begin:
                continue
            if before is None:
                self._skip()
            before = shown
            self.gap.take(shown)
            self._told(self.monitor.update(shown), second)
            for estimate in estimates:
                self._show(estimate, second)
            self.blocks += 1.0 / BLOCKS

    def _skip(self) -> None:
        """Set the monitor as if it had judged the blocks that were skipped."""
        self.monitor.gate.last = None
        detection = self.monitor.detection
        detection._judged_at, detection._windowed_at = None, 0

    def _blocks(self, estimator: Estimator, first: int, end: int) -> Iterator[tuple[float, Block]]:
        day = self.day
        truth = self.surrogate.truth
        stiffness, viscous, friction = (float(row[first]) for row in truth.values())
        simulator = day.measuring.simulator(
            day.valve.model_copy(update={"spring_stiffness": stiffness}),
            day.shaking.machine(*_speeds(day, first, end)),
            parameters={"viscous_coefficient": viscous}, coulomb_force=friction,
            seed=day.seed % 2**31, start_stamp=self._stamp(float(first)),
        )  # fmt: skip
        # Numbers of blocks and stamps belong together over all stretches.
        number = round((self._stamp(float(first)) - self.origin) * BLOCKS / SECOND) + SINCE * BLOCKS
        for second in range(first, end):
            at = min(second + 1, day.seconds - 1)
            for name, row in truth.items():
                # A step is a step; what changes slowly runs.
                here, there = float(row[second]), float(row[at])
                jumps = abs(there - here) > 0.02 * abs(here)
                simulator.set_drift(name, here if jumps else there, 0.0 if jumps else 1.0)
            if math.isfinite(day.reading[second]):
                estimator.update_temperature(simulator.stamp, float(day.reading[second]))
            for count, block in enumerate(simulator.records(1.0)):
                yield second + count / BLOCKS, replace(block, sequence=number)
                number += 1


def _speeds(
    day: ValveDay, first: int, end: int
) -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]:
    """Return speed profile (s, Hz) and standstills of the machine from ``first`` to ``end`` (s)."""
    idle = 0.3 * day.valve.natural_frequency
    points: list[tuple[float, float]] = []
    rests: list[tuple[float, float]] = []
    before, since = idle, float(first)
    for hold in day.holds:
        if hold.end <= first:
            before = hold.shaft
            since = max(since, float(hold.end))
            continue
        if hold.begin >= end:
            break
        begin = float(max(hold.begin, first))
        if begin > since or (not points and hold.begin > first):
            rests.append((since - first, begin - first))
            before = idle
        if hold.begin < first:
            before = hold.shaft
        points += [(begin - first, before), (begin - first + hold.ramp, hold.shaft)]
        points.append((max(float(hold.end) - first, points[-1][0] + 0.1), hold.shaft))
        before, since = hold.shaft, float(hold.end)
    if since < end:
        rests.append((since - first, float(end - first) + 60.0))
    profile: list[tuple[float, float]] = []
    for at, shaft in points or [(0.0, idle)]:
        moved = at if not profile else max(at, profile[-1][0] + 0.05)
        profile.append((moved, shaft))
    return tuple(profile), tuple(rests)


def run_day(seed: int, *, faulty: bool = False, trace: Trace | None = None) -> DayOutcome:
    """Live the valve-day of ``seed`` and compare the events with its truth."""
    return outcome_of(draw_day(seed, faulty=faulty), trace=trace)


def outcome_of(day: ValveDay, trace: Trace | None = None) -> DayOutcome:
    """Live ``day`` and compare the events with its truth."""
    watch = time.process_time()
    with TemporaryDirectory() as folder:
        one = DayRun(day, Path(folder), trace)
        one.run()
        size = one.state_size
        one.close()
    raised = [
        RaisedEvent(second, event.kind, event.cause, int(event.severity) > 1)
        for second, event in one.events
        if event.state is EventState.RAISED and second >= 0.0
    ]
    found, right, false = judged(day, raised)
    running = float(sum(hold.end - hold.begin for hold in day.holds))
    outcome = DayOutcome(day.seed, day.fault is not None, false=tuple(false), running=running)
    outcome = replace(outcome, blocks=one.blocks, state=size, thermometer=day.thermometer)
    outcome = replace(outcome, cost=time.process_time() - watch)
    if day.fault is None:
        return outcome
    fault = day.fault
    at = math.nan if found is None else float(day.operated(found.at))
    return replace(
        outcome, name=fault.name, speed=fault.speed if fault.quantity else "", severity=severity_of(day),
        found=found, right=right, delay=at - fault.reached, since_begin=at - fault.begin,
    )  # fmt: skip


def severity_of(day: ValveDay) -> float:
    """Return how large the day's fault is when production ends, over the size that has to be found."""
    fault = day.fault
    if fault is None:
        return 0.0
    return fault.severity * float(fault.grown(day.operated(day.holds[-1].end - 1.0)))


def judged(day: ValveDay, raised: list[RaisedEvent]) -> tuple[RaisedEvent | None, bool, list[RaisedEvent]]:
    """Return the event that finds the fault, whether its cause is right, and the false alarms."""
    fault = day.fault
    found: RaisedEvent | None = None
    known, right, false = False, False, []
    for event in raised:
        mine = fault is not None and day.operated(event.at) >= fault.begin
        if mine and fault is not None and event.kind == fault.kind:
            found = found or event
            # A cause that is corrected again is seen was not right at first, and no second event.
            if not known and event.cause not in LEAVES_OPEN:
                known, right = True, event.cause in fault.causes
            continue
        if mine and fault is not None and _follows(event, fault.kind, needs_blocks=fault.needs_blocks):
            continue
        if not _explained(day, event):
            false.append(event)
    return found, right, false


def _follows(event: RaisedEvent, kind: str, *, needs_blocks: bool) -> bool:
    """Whether ``event`` may follow from a fault of ``kind``: a tired spring resonates."""
    if needs_blocks:
        return event.kind in ("data_fault", "sensor_fault", "stuck_spool")
    return event.kind == "resonance" and kind == "spring_change"


def _explained(day: ValveDay, event: RaisedEvent) -> bool:
    """Whether the day's truth explains ``event``: lost blocks, or a speed near the natural frequency."""
    if event.kind in ("data_fault", "stale"):
        return any(low <= event.at <= high + FOLLOWS for low, high in day.gaps)
    if event.kind == "resonance":
        band = 1.3 * RESONANCE_BAND.default
        natural = day.valve.natural_frequency
        return any(
            hold.begin - 2.0 <= event.at <= hold.begin + hold.ramp + FOLLOWS
            or hold.end - 2.0 <= event.at <= hold.end + FOLLOWS
            or (hold.begin <= event.at < hold.end and abs(hold.shaft / natural - 1.0) < band)
            for hold in day.holds
        )
    return False


#: s, over which the estimator forgets: the default of its node.
MEMORY = 4.0
#: s of each hold of a healthy day whose estimates are shown: the first ones, then some in every so many. The
#: operating point stays, and the oil warms over minutes.
FIRST, SHOWN, EVERY = 60, 12, 240
#: s behind the newest sample that an estimate describes.
DELAY = 0.005


def _known(name: str, unit: str, value: float, deviation: float = math.nan) -> Quantity:
    """Return a quantity that is valid, or one that is not known where ``value`` is NaN."""
    if math.isnan(value):
        return Quantity(name, unit)
    return Quantity(name, unit, value, deviation, Validity.VALID)


class SurrogateEstimates:
    """Surrogate estimates of one valve over its day.

    Attributes:
        truth: stiffness, viscous coefficient and dry friction at each second, by their names.

    """

    def __init__(self, day: ValveDay, surrogate: Surrogate) -> None:
        self.day, self.surrogate = day, surrogate
        self.truth = dict(zip(TRACED, (day.stiffness(), day.viscous(), day.friction()), strict=True))
        self._draw = np.random.default_rng([day.seed, 23])
        self._table = OilTable(day.valve)
        self._samples = 0
        self._offsets = self._draw.standard_normal(4)

    def commissioning(self, seconds: int, origin: int) -> Iterator[Estimate]:
        """Yield the estimates from which the baseline is learned, at the temperature of that day."""
        day = self.day
        shaft, celsius = day.commissioned
        viscous = day.valve.viscous_coefficient * float(self._table.ratio(np.array(celsius)))
        truth = np.array([day.valve.spring_stiffness, viscous, day.coulomb])
        offset = float(np.nanmedian(day.reading - day.oil)) if day.thermometer else math.nan
        # The thermometer's constant error is the same on both days, its lag is not.
        reading = np.full(seconds, celsius + offset)
        row = self._row(shaft, viscous, day.coulomb)
        values = np.tile(truth, (seconds, 1))
        yield from self._estimates(
            row, values, reading, np.ones(seconds), origin + SECOND * np.arange(seconds)
        )

    def production(self, hold: Hold, begin: int, end: int, origin: int) -> Iterator[tuple[float, Estimate]]:
        """Yield (s, estimate) from ``begin`` to ``end`` (s) while the machine runs at ``hold``."""
        day, made = self.day, self.surrogate
        count = end - begin
        values = np.column_stack([row[begin:end] for row in self.truth.values()])
        _, viscous, friction = values.T
        row = self._row(hold.shaft, float(viscous[0]), float(friction[0]))
        share = 1.0 - math.exp(-1.0 / MEMORY)
        values, _ = lfilter([share], [1.0, share - 1.0], values, axis=0, zi=(1.0 - share) * values[:1])
        sizes = np.ones(count)
        since = begin - hold.begin
        after_stop = not any(one.end == hold.begin for one in day.holds)
        curve = (made.after_start if after_stop else made.after_change)[since:]
        sizes[: curve.size] = curve[:count]
        stamps = origin + SECOND * day.clock[begin:end]
        settles = max(0, (made.start if after_stop else 0) + math.ceil(hold.ramp) - since)
        run = np.arange(since, since + count)
        shown = (run < FIRST) | (run % EVERY < SHOWN) | (day.fault is not None) | day.dense
        moved = self._moved(row, hold, viscous, friction)
        made_of = self._estimates(row, values, day.reading[begin:end], sizes, stamps, shown, moved)
        for number, estimate in zip(np.flatnonzero(shown).tolist(), made_of, strict=True):
            yield float(begin + number), estimate.held() if number < settles else estimate

    def _moved(self, row: SurrogateRow, hold: Hold, viscous: Array, friction: Array) -> Array:
        """Return by how much the error of a gain changes while the oil warms, since the start of ``row``."""
        knots = np.unique(np.linspace(0, viscous.size - 1, 2 + viscous.size // EVERY).astype(int))
        made = [
            self.surrogate.sensitivity(self._place(hold.shaft, float(viscous[at]), float(friction[at])))
            for at in knots
        ]
        change = self.day.measuring.gain_error * (np.array(made) - row.sensitivity)
        return np.column_stack([np.interp(np.arange(viscous.size), knots, one) for one in change.T])

    def _place(self, shaft: float, viscous: float, coulomb: float) -> Array:
        day = self.day
        return features(day.valve, viscous, coulomb, shaft, day.shaking, day.measuring.noise)

    def _row(self, shaft: float, viscous: float, coulomb: float) -> SurrogateRow:
        day, place = self.day, self._place(shaft, viscous, coulomb)
        return self.surrogate.row(place, day.measuring.gain_error, self._offsets, self._draw)

    def _estimates(
        self,
        row: SurrogateRow,
        values: Array,
        reading: Array,
        sizes: Array,
        stamps: NDArray[np.int64],
        shown: NDArray[np.bool_] | None = None,
        moved: Array | float = 0.0,
    ) -> Iterator[Estimate]:
        """Yield estimates of ``values`` (means over the memory), shape (n, 3), where ``shown``.

        ``moved`` are errors besides those of ``row``, shape (n, 3).
        """
        valve, first = self.day.valve, self.day.shaking.first
        shown = np.ones(len(values), bool) if shown is None else shown
        count = len(values)
        force = valve.moving_mass * first
        units = np.column_stack([values[:, 0], values[:, 1], np.full(count, force)])
        estimated = values + units * (errors(row, self.surrogate.correlation, sizes, self._draw) + moved)
        spread = np.exp(row.spread * self._draw.standard_normal(count))
        reported = units * row.reported * spread[:, np.newaxis]
        residuals = np.abs(row.residual + row.residual_spread * self._draw.standard_normal(count))
        natural = np.sqrt(np.maximum(estimated[:, 0], 1.0) / valve.moving_mass) / (2.0 * math.pi)
        deviations = 0.5 * natural * reported[:, 0] / estimated[:, 0]
        damping = estimated[:, 1] / (4.0 * math.pi * natural * valve.moving_mass)
        referred, uncertain = self._referred(estimated[:, 1], reported[:, 1], reading)
        tracks = self._draw.random(count) < row.tracking if row.tracking < 0.9 else np.ones(count, bool)
        omega = 2.0 * math.pi * valve.natural_frequency
        inertia = row.inertia * force
        excitation = _known("excitation", "m/s^2", row.excitation * first)
        displacement = _known("relative_displacement", "m", row.displacement * first / omega**2)
        columns = (
            stamps, estimated, reported, natural, deviations, damping, residuals, referred, uncertain,
            reading, tracks,
        )  # fmt: skip
        for stamp, (
            k,
            c,
            dry,
        ), wide, frequency, width, damped, residual, cold, error, celsius, tracking in zip(
            *(column[shown].tolist() for column in columns), strict=True
        ):
            self._samples += 1000
            friction = _known("coulomb_force", "N", dry, wide[2])
            if dry < 0.0 and dry < -3.0 * wide[2]:
                friction = replace(friction, validity=Validity.IMPLAUSIBLE)
            stiffness = _known("spring_stiffness", "N/m", k, wide[0])
            drag = _known("viscous_coefficient", "N s/m", c, wide[1])
            estimate = Estimate(
                stamp, "coulomb", State.TRACKING, 0, self._samples, DELAY, MEMORY,
                (stiffness, drag, friction),
                _known("natural_frequency", "Hz", frequency, width),
                _known("damping_ratio", "1", damped),
                _known("residual", "1", residual),
                excitation, displacement,
                residual_force=_known("residual_force", "N", residual * inertia),
                referred_viscous_coefficient=_known("referred_viscous_coefficient", "N s/m", cold, error),
                oil_temperature=_known("oil_temperature", "deg C", celsius, USUAL_DEVIATION),
            )  # fmt: skip
            yield estimate if tracking else estimate.held()

    def _referred(self, viscous: Array, deviation: Array, reading: Array) -> tuple[Array, Array]:
        """Return the coefficient at the reference temperature and its deviation, as ``OilReference`` does."""
        late = round(LAG + DELAY)
        shown = np.concatenate([np.repeat(reading[:1], late), reading])[: reading.size]
        now = self._table.ratio(shown)
        share = 1.0 - math.exp(-1.0 / MEMORY)
        ratio, _ = lfilter([share], [1.0, share - 1.0], now, zi=[(1.0 - share) * now[0]])
        slope = np.log(self._table.ratio(shown - 0.5) / self._table.ratio(shown + 0.5))
        value = viscous / ratio
        return value, np.hypot(deviation / ratio, value * slope * USUAL_DEVIATION)
