"""World of one valve-day: calendar, production, oil, sensors, rarely a fault; all follows from a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from spool_core.numbers import Array
from spool_sim.excitation import MachineOrders
from spool_sim.lubrication import OilTable
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import NotNegative, Number, Valve

from spool_operation.faults import OperationFault, draw_fault

#: Blocks a second.
BLOCKS = 10
#: s of a day, of a shift, and of the standstill that the day begins with.
DAY, SHIFT, BEFORE = 86_400, 28_800, 600
#: K, oil over ambient in production; s, time constants of warming and of cooling at standstill.
RISE, WARMS, COOLS = (18.0, 35.0), (1500.0, 2700.0), (7200.0, 14_400.0)
#: s between changes of speed, of a pause, of a short stop; stops in a shift on average.
HOLDS, PAUSE, STOP, STOPS = (600.0, 3600.0), (900.0, 1800.0), (60.0, 600.0), 4.0
#: s that the machine takes to a speed.
RAMP = (3.0, 8.0)
#: Thermometer: K of constant error and of noise, K of a step, s behind the oil in the gap.
OFFSET, FLICKER, STEP, BEHIND = 0.5, 0.05, 0.1, 30.0
#: 1/K, error of the oil's law against the oil (standard deviation).
LAW = 0.001
#: Share of days with lost data, with a restart of the software, and without a thermometer.
LOSES, RESTARTS, WITHOUT = 0.1, 0.1, 0.1
#: s of real blocks around an event: before, after.
AROUND = (6, 22)
#: Stretches of a fault that takes months, s of each; the valve stands still between them.
LAPSES, LAPSE = 40, 240
#: s of a slower fault that are simulated before it begins and after it has come to rest.
MARGIN = 1200
#: Stiffness, N/m, of the two springs, viscosity, Pa s at 40 deg C, and name of the two oils.
SPRINGS, OILS = (1632.0, 5846.0), ((0.0612, "HL68"), (0.0198, "Azolla ZS22"))
#: Shaft frequency over natural frequency of machines that run below and above resonance; the second order of
#: the slower ones lies above it.
BELOW, ABOVE = (0.65, 0.8), (1.45, 2.2)
#: s that the machine takes to stand still or to come up.
FADE = 2.0


class StoppingMachine(MachineOrders):
    """Machine excitation that stands still at times.

    Attributes:
        rests: (begin, end) of each standstill, s; the vibration fades within 2 s.
    """

    rests: tuple[tuple[NotNegative, Number], ...] = Field(default=())

    def _steady(self, t: Array) -> Array:
        total = super()._steady(t)
        for begin, end in self.rests:
            outside = np.maximum(begin - t, t - end) / FADE
            total = total * np.clip(outside, 0.0, 1.0)
        return total


def draw_valve(draw: np.random.Generator) -> Valve:
    """Return one of the springs, or (every third) any between them, with one of the oils."""
    stiffness = SPRINGS[draw.integers(2)] * draw.uniform(0.97, 1.03)
    between = float(np.exp(draw.uniform(math.log(SPRINGS[0]), math.log(SPRINGS[1]))))
    if draw.random() < 1.0 / 3.0:
        stiffness = between
    viscosity, name = OILS[draw.integers(2)]
    return Valve(
        id="valve_1", moving_mass=0.18, spool_mass=0.172, spring_stiffness=stiffness,
        land_diameter=0.02, land_length=0.032, radial_clearance=15e-6,
        dynamic_viscosity=viscosity, oil_temperature=40.0, oil=name,
    )  # fmt: skip


def away(draw: np.random.Generator, valve: Valve, *, below: bool) -> float:
    """Return a shaft frequency, Hz, away from the natural one."""
    return float(valve.natural_frequency * draw.uniform(*(BELOW if below else ABOVE)))


@dataclass(frozen=True, slots=True)
class Hold:
    """The machine runs at one speed from ``begin`` to ``end`` (s); it takes ``ramp`` s to get there."""

    begin: int
    end: int
    shaft: float
    ramp: float


@dataclass(frozen=True, slots=True)
class ValveDay:
    """Valve-day with its truth.

    Attributes:
        seed: it follows from this, and ``faulty``, alone.
        valve: as described to the monitor; ``coulomb``: its dry friction, N.
        holds: of production, in order; between them the machine stands.
        oil: true oil temperature at each second, deg C; ``reading``: the thermometer's, NaN without one.
        law_error: 1/K, by which the oil's viscosity departs from the law.
        commissioned: shaft frequency (Hz) and oil temperature (deg C) when the baseline was learned.
        real: (begin, end) of stretches of real blocks, s.
        restarts: s when the software was restarted.
        gaps: (begin, end) of lost blocks, s.
        fault: what breaks, if anything.
        weekend: s of standstill before the day.
        clock: s of operation at each second that is simulated; a lapse of months skips most.
        dense: every estimate of the surrogate is shown, not a sample of each hold.

    """

    seed: int
    valve: Valve
    coulomb: float
    shaking: Shaking
    measuring: Measuring
    holds: tuple[Hold, ...]
    oil: Array
    reading: Array
    law_error: float
    commissioned: tuple[float, float]
    real: tuple[tuple[int, int], ...]
    restarts: tuple[int, ...]
    gaps: tuple[tuple[int, int], ...]
    weekend: float
    seconds: int
    fault: OperationFault | None = None
    clock: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    dense: bool = False

    @property
    def thermometer(self) -> bool:
        """Whether the oil's temperature is measured."""
        return bool(np.isfinite(self.reading).any())

    def operated(self, second: Array | float) -> Array:
        """Return s of operation at ``second`` of what is simulated; outside of it the nearest clock runs."""
        at = np.clip(np.asarray(second).astype(int), 0, self.seconds - 1)
        return np.asarray(self.clock[at] + second - at)

    def viscous(self) -> Array:
        """Return the true viscous coefficient at each second, N s/m."""
        valve = self.valve
        ratio = OilTable(valve).ratio(self.oil)
        drift = np.exp(self.law_error * (self.oil - self.commissioned[1]))
        return np.asarray(valve.viscous_coefficient * ratio * drift * self._factor("viscous_coefficient"))

    def stiffness(self) -> Array:
        """Return the true stiffness at each second, N/m."""
        return np.asarray(self.valve.spring_stiffness * self._factor("spring_stiffness"))

    def friction(self) -> Array:
        """Return the true dry friction at each second, N."""
        if self.fault is None or self.fault.quantity != "coulomb_force":
            return np.full(self.seconds, self.coulomb)
        return np.asarray(self.coulomb + self.fault.size * self._grown)

    @property
    def _grown(self) -> Array:
        assert self.fault is not None
        return np.asarray(self.fault.grown(self.clock.astype(float)))

    def _factor(self, quantity: str) -> Array:
        if self.fault is None or self.fault.quantity != quantity:
            return np.ones(self.seconds)
        return np.asarray(1.0 + self.fault.size * self._grown)


def draw_day(seed: int, *, faulty: bool = False) -> ValveDay:
    """Return the valve-day that follows from ``seed``."""
    draw = np.random.default_rng([seed, 17, int(faulty)])
    valve = draw_valve(draw)
    below = bool(draw.random() < 0.5)
    shaking = draw_shaking(draw, below=below)
    measuring = draw_measuring(draw)
    coulomb = float(min(0.25, draw.uniform(0.05, 0.3) * valve.moving_mass * shaking.first))
    holds = _production(draw, valve, below=below)
    seasons = [
        15.0 + 12.0 * math.sin(2.0 * math.pi * draw.random()) + draw.normal(0.0, 3.0) for _ in range(2)
    ]
    rise = draw.uniform(*RISE)
    oil = _oil(draw, holds, seasons[0], rise)
    commissioned = (away(draw, valve, below=below), float(seasons[1] + rise * draw.uniform(0.3, 1.0)))
    weekday = int(draw.integers(5))
    day = ValveDay(
        seed, valve, coulomb, shaking, measuring, holds, oil, _reading(draw, oil),
        float(draw.normal(0.0, LAW)), commissioned, (), (), (),
        weekend=float(draw.uniform(48.0, 64.0) * 3600.0) if weekday == 0 else 6.0 * 3600.0,
        seconds=DAY, clock=np.arange(DAY),
    )  # fmt: skip
    if faulty:
        return _with_fault(draw, day, below=below)
    return _with_events(draw, day)


def _production(draw: np.random.Generator, valve: Valve, *, below: bool) -> tuple[Hold, ...]:
    """Return the holds of one to three shifts, with pauses, stops and changes of speed."""
    shifts = int(draw.choice([1, 2, 3], p=[0.45, 0.35, 0.2]))
    stops: list[tuple[float, float]] = []
    for shift in range(shifts):
        begin = BEFORE + shift * SHIFT
        middle = begin + draw.uniform(0.4, 0.6) * SHIFT
        stops.append((middle, middle + draw.uniform(*PAUSE)))
        stops += [
            (at, at + draw.uniform(*STOP))
            for at in begin + draw.uniform(600.0, SHIFT - 900.0, draw.poisson(STOPS))
        ]
    end = min(DAY - 60.0, BEFORE + shifts * SHIFT)
    stops = sorted([*stops, (end, math.inf)])
    holds: list[Hold] = []
    time = float(BEFORE)
    for stop, resumed in stops:
        while time < stop:
            until = min(stop, time + draw.uniform(*HOLDS))
            if until - time > 30.0:
                shaft = away(draw, valve, below=below)
                holds.append(Hold(round(time), round(until), shaft, float(draw.uniform(*RAMP))))
            time = until
        time = max(time, resumed)
    return tuple(holds)


def _oil(draw: np.random.Generator, holds: Sequence[Hold], ambient: float, rise: float) -> Array:
    """Return the oil's temperature at each second, deg C."""
    warms, cools = draw.uniform(*WARMS), draw.uniform(*COOLS)
    runs = np.zeros(DAY, dtype=bool)
    for hold in holds:
        runs[hold.begin : hold.end] = True
    oil = np.empty(DAY)
    # Solved in steps of 10 s: time constants are of minutes and more.
    now = ambient + draw.uniform(0.0, 0.3) * rise
    for at in range(0, DAY, 10):
        target, constant = (ambient + rise, warms) if runs[at] else (ambient, cools)
        now += (target - now) * 10.0 / constant
        oil[at : at + 10] = now
    return np.clip(oil, 5.0, 75.0)


def _reading(draw: np.random.Generator, oil: Array) -> Array:
    """Return what the thermometer reads at each second, deg C; NaN where there is none."""
    from scipy.signal import lfilter  # noqa: PLC0415 - slow to load

    offset, without = draw.normal(0.0, OFFSET), draw.random() < WITHOUT
    share = 1.0 / BEHIND
    behind, _ = lfilter([share], [1.0, share - 1.0], oil, zi=[(1.0 - share) * oil[0]])
    flicker = FLICKER * draw.standard_normal(oil.size)
    reading = np.rint((behind + offset + flicker) / STEP) * STEP
    return np.full(oil.size, np.nan) if without else np.asarray(reading)


def _with_events(draw: np.random.Generator, day: ValveDay) -> ValveDay:
    """Return ``day`` with real blocks around one event, and rarely lost data and a restart."""
    hold = day.holds[int(draw.integers(len(day.holds)))]
    # Start or change of speed, or the end of a hold.
    at = hold.begin if draw.random() < 0.6 else hold.end
    real = [_around(at)]
    gaps: tuple[tuple[int, int], ...] = ()
    restarts: tuple[int, ...] = ()
    if draw.random() < LOSES:
        lost = int(draw.integers(hold.begin + 10, hold.end)) if hold.end - hold.begin > 60 else hold.begin
        gaps = ((lost, lost + int(draw.integers(1, 30))),)
        real.append((max(0, lost - AROUND[0]), gaps[0][1] + AROUND[1]))
    if draw.random() < RESTARTS:
        restarts = (int(draw.integers(BEFORE, day.holds[-1].end)),)
    return replace(day, real=merged(real), gaps=gaps, restarts=restarts)


def _with_fault(draw: np.random.Generator, day: ValveDay, *, below: bool) -> ValveDay:
    """Return the part of ``day`` in which its fault happens."""
    force = day.valve.moving_mass * day.shaking.first
    fault = draw_fault(draw, day.coulomb, force)
    running = np.zeros(DAY, dtype=bool)
    for hold in day.holds:
        running[hold.begin : hold.end] = True
    reached = round(fault.reached)
    # A fault that comes to its size while the machine stands is nobody's to find.
    starts = [
        hold
        for hold in day.holds
        if hold.end - hold.begin > 400
        and running[hold.begin + 120 + reached : hold.end + reached].sum() > 180
    ]
    hold = starts[int(draw.integers(len(starts)))] if starts else day.holds[0]
    at = int(draw.integers(hold.begin + 120, max(hold.begin + 121, hold.end - 200)))
    fault = replace(fault, begin=float(at))
    if fault.lasting > DAY:
        return _lapse(draw, day, fault, below=below)
    first = max(0, at - MARGIN)
    last = min(DAY, round(at + fault.lasting) + MARGIN)
    real: tuple[tuple[int, int], ...] = ()
    if fault.needs_blocks:
        last = at + 110
        real = ((at - 30, last),)
    elif fault.lasting < 60.0:
        real = ((at - 12, at + 40),)
    return _part(replace(day, fault=fault, real=real), first, last)


def _part(day: ValveDay, first: int, last: int) -> ValveDay:
    """Return the seconds ``first`` to ``last`` of ``day``; truth and clock stay those of the day."""
    assert day.fault is not None
    holds = tuple(
        replace(hold, begin=max(hold.begin, first) - first, end=min(hold.end, last) - first)
        for hold in day.holds
        if hold.end > first + 10 and hold.begin < last
    )
    return replace(
        day,
        holds=holds,
        oil=day.oil[first:last],
        reading=day.reading[first:last],
        real=tuple((begin - first, end - first) for begin, end in day.real),
        seconds=last - first,
        clock=np.arange(last - first),
        fault=replace(day.fault, begin=day.fault.begin - first),
    )


def _lapse(draw: np.random.Generator, day: ValveDay, fault: OperationFault, *, below: bool) -> ValveDay:
    """Return stretches of production over the months that ``fault`` takes, and some before it begins."""
    before = LAPSES // 8
    apart = round(fault.lasting / (LAPSES - before - 4))
    lapse = stretches_of(draw, day, LAPSES, LAPSE, apart, below=below)
    return replace(lapse, fault=replace(fault, begin=float(before * apart)))


def stretches_of(
    draw: np.random.Generator, day: ValveDay, count: int, each: int, apart: int, *, below: bool | None = None
) -> ValveDay:
    """Return ``count`` stretches of ``each`` s of production of the valve of ``day``, ``apart`` s apart.

    Each has the oil of some moment of the day, moved by the season. ``below``: the machine runs below the
    natural frequency (``None``: as on the day).
    """
    if below is None:
        below = day.holds[0].shaft < day.valve.natural_frequency
    holds, oil, clock = [], np.empty(count * each), np.empty(count * each, np.int64)
    running = np.concatenate([np.arange(hold.begin, hold.end) for hold in day.holds])
    season = draw.uniform(0.0, 2.0 * math.pi)
    for number in range(count):
        begin, part = number * each, slice(number * each, (number + 1) * each)
        holds.append(Hold(begin + 20, begin + each - 5, away(draw, day.valve, below=below), 4.0))
        at = float(day.oil[running[int(draw.integers(running.size))]])
        year = 6.0 * (math.sin(season + 2.0 * math.pi * number * apart / 3.156e7) - math.sin(season))
        oil[part] = min(70.0, max(8.0, at + year))
        clock[part] = number * apart + np.arange(each)
    reading = oil + draw.normal(0.0, OFFSET) + FLICKER * draw.standard_normal(oil.size)
    if not day.thermometer:
        reading = np.full(oil.size, np.nan)
    return replace(
        day, holds=tuple(holds), oil=oil, reading=reading, real=(), gaps=(), restarts=(),
        seconds=count * each, clock=clock,
    )  # fmt: skip


def _around(at: int) -> tuple[int, int]:
    return max(0, at - AROUND[0]), at + AROUND[1]


def merged(stretches: Sequence[tuple[int, int]], apart: int = 0) -> tuple[tuple[int, int], ...]:
    """Return ``stretches`` (begin, end) in order, those joined that are ``apart`` s apart at most."""
    found: list[tuple[int, int]] = []
    for begin, end in sorted(stretches):
        if found and begin <= found[-1][1] + apart:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        else:
            found.append((begin, end))
    return tuple(found)


#: Scales that make distances of features alike: a factor of e in damping, half a natural frequency in speed,
#: a factor of e in friction over force, and in noise over vibration.
SCALES = np.array([1.0, 0.5, 1.0, 1.0])


@dataclass(frozen=True, slots=True)
class Measuring:
    """Measuring chain of one valve: both accelerometers and the sample rate (Hz)."""

    sample_rate: float
    noise: float
    resolution: float
    gain_error: float
    bias: float

    def simulator(self, valve: Valve, machine: StoppingMachine, **given: Any) -> Simulator:
        """Return a simulator of ``valve`` in ``machine`` that this chain measures; ``given`` as it takes."""
        body = Sensor(noise=self.noise, resolution=self.resolution)
        spool = body.model_copy(update={"gain_error": self.gain_error, "bias": self.bias})
        return Simulator(
            valve, machine, sample_rate=self.sample_rate, block_size=round(self.sample_rate / BLOCKS),
            body_sensor=body, spool_sensor=spool, **given,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Shaking:
    """Shaking of a machine: shares of its orders (1/rev), and of the rest, m/s^2.

    ``first`` is the amplitude of the first order, ``second`` and ``fourth`` are shares of it, ``broadband``
    the rms of the rest over it.
    """

    first: float
    second: float
    fourth: float
    broadband: float
    seed: int

    def machine(
        self, profile: tuple[tuple[float, float], ...], rests: tuple[tuple[float, float], ...] = ()
    ) -> StoppingMachine:
        """Return the machine that runs through ``profile`` (s, shaft frequency in Hz)."""
        orders: tuple[tuple[float, float], ...] = ((1.0, self.first), (2.0, self.second * self.first))
        if self.fourth > 0.0:
            orders = (*orders, (4.0, self.fourth * self.first))
        return StoppingMachine(
            speed_profile=tuple((time, 60.0 * frequency) for time, frequency in profile),
            orders=orders,
            broadband_rms=self.broadband * self.first,
            broadband_low=6.0,
            broadband_high=75.0,
            broadband_lines=16,
            seed=self.seed,
            rests=rests,
        )


def features(
    valve: Valve, viscous: float, coulomb: float, shaft: float, shaking: Shaking, noise: float
) -> Array:
    """Return what the quality of estimates depends on, shape (4,).

    Logarithm of the damping ratio, shaft over natural frequency, logarithms of dry friction over the first
    order's inertia force and of noise over its amplitude.
    """
    ratio = viscous / (2.0 * math.sqrt(valve.spring_stiffness * valve.moving_mass))
    force = valve.moving_mass * shaking.first
    return np.array(
        [
            math.log(ratio),
            shaft / valve.natural_frequency,
            math.log(max(coulomb, 1e-3) / force),
            math.log(noise / shaking.first),
        ]
    )


def draw_measuring(draw: np.random.Generator) -> Measuring:
    """Return a measuring chain: noise of piezoelectric and MEMS sensors, 12 to 16 bit, gain errors to 2 %."""
    return Measuring(
        sample_rate=float(draw.choice([800.0, 1000.0, 1250.0, 2000.0])),
        noise=float(draw.uniform(0.02, 0.1)),
        resolution=float(draw.choice([0.0, 0.002, 0.02])),
        gain_error=float(draw.uniform(-0.02, 0.02)),
        bias=float(draw.uniform(-0.2, 0.2)),
    )


def draw_shaking(draw: np.random.Generator, *, below: bool) -> Shaking:
    """Return how a machine shakes that runs below or above the valve's natural frequency."""
    return Shaking(
        first=float(draw.uniform(2.5, 10.0)),
        second=float(draw.uniform(0.2, 0.5)),
        fourth=0.2 if below else 0.0,
        broadband=float(draw.uniform(0.08, 0.3)),
        seed=int(draw.integers(2**31)),
    )
