"""World of a fleet, drawn from a seed, and what the tables would hold of it.

A fleet's year has five thousand bags, too many to simulate for many fleets. The errors of the estimator are
those of bags that were simulated, drawn at random: they are small beside what the world does from bag to bag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import make_estimator, settings_for
from spool_fleet.analyses.base import REFERENCE
from spool_fleet.observations import COULOMB, PARAMETERS, STIFFNESS, UNCERTAIN, VISCOUS, ObservedValve, Series
from spool_sim.excitation import Excitation, MachineOrders, Multisine
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve

DAY = 86_400.0
MONTH = 30.44
WEEKS = 52
#: Bags of a valve in a week: one every working day.
BAGS = 5
MACHINES, VALVES_EACH = 5, 4
#: 2026-01-05, a Monday, in days since 1970.
FIRST_DAY = 20_458.0
#: s and Hz of a record: the shortest that the estimator tracks in, since a year of a fleet has a thousand.
SECONDS, SAMPLE_RATE = 8.0, 800.0
#: Spectral lines of the vibration.
LINES = 24
#: Relative loss of drag a month of the valve that wears.
WEAR = 0.03

UNITS = {VISCOUS: "N s/m", COULOMB: "N", STIFFNESS: "N/m"}


@dataclass(frozen=True, slots=True)
class Machine:
    """Its oil temperature over the year, its sensor of that, what its oil does beside the law."""

    mean: float
    season: float
    coldest: float
    daily: float
    offset: float
    gain: float
    law: float
    change_day: float
    change: float

    def oil(self, day: float, generator: np.random.Generator) -> tuple[float, float, float]:
        """Return true and measured temperature (deg C) and the factor on the viscosity of the law."""
        season = -math.cos(2.0 * math.pi * (day - self.coldest) / 365.25)
        true = self.mean + self.season * season + float(generator.normal(0.0, self.daily))
        factor = math.exp(self.law * (true - 40.0)) * (self.change if day >= self.change_day else 1.0)
        return true, self.offset + self.gain * true, factor


@dataclass(frozen=True, slots=True)
class FleetValve:
    """Valve of the fleet: its place, its truth when healthy, how it scatters, and its fault."""

    machine: int
    number: int
    clearance: float
    stiffness: float
    coulomb: float
    drag_scatter: float
    coulomb_scatter: float
    noise: float
    wears_from: float = math.inf
    dirty_from: float = math.inf
    dirty_over: float = 0.0
    dirt: float = 1.0

    def drag(self, day: float) -> float:
        """Return the factor of wear on the drag, compounded a month."""
        return float((1.0 - WEAR) ** (max(0.0, day - self.wears_from) / MONTH))

    def rubbing(self, day: float) -> float:
        """Return the factor of dirt on the Coulomb force, which grows over some time."""
        if day < self.dirty_from:
            return 1.0
        share = 1.0 if self.dirty_over <= 0.0 else min(1.0, (day - self.dirty_from) / self.dirty_over)
        return 1.0 + (self.dirt - 1.0) * share


@dataclass(frozen=True, slots=True)
class World:
    """``machines`` and ``valves``; ``worn`` and ``dirty`` are the numbers of the faulty ones."""

    seed: int
    machines: tuple[Machine, ...]
    valves: tuple[FleetValve, ...]
    worn: int
    dirty: int
    changed_machine: int


def draw_world(seed: int) -> World:
    """Return the fleet of ``seed``: a valve wears, one is contaminated, a machine's oil is changed."""
    generator = np.random.default_rng([seed, 19])
    uniform, normal = generator.uniform, generator.normal
    law = float(normal(0.0, 0.002))
    changed = int(generator.integers(MACHINES))
    machines = tuple(
        Machine(
            mean=float(uniform(38.0, 55.0)),
            season=float(uniform(6.0, 15.0)),
            coldest=float(uniform(10.0, 40.0)),
            daily=float(uniform(1.0, 5.0)),
            offset=float(normal(0.0, 2.0)),
            gain=float(normal(1.0, 0.02)),
            law=law + float(normal(0.0, 0.0007)),
            change_day=float(uniform(3.0, 9.0)) * MONTH if number == changed else math.inf,
            change=math.exp(float(normal(0.0, 0.05))),
        )
        for number in range(MACHINES)
    )
    worn, dirty = (int(one) for one in generator.choice(MACHINES * VALVES_EACH, 2, replace=False))
    valves = []
    for number in range(MACHINES * VALVES_EACH):
        wears = number == worn
        spoilt = number == dirty
        valves.append(
            FleetValve(
                machine=number // VALVES_EACH,
                number=number % VALVES_EACH,
                clearance=math.exp(float(normal(0.0, 0.08))),
                stiffness=math.exp(float(normal(0.0, 0.03))),
                coulomb=float(uniform(0.2, 0.8)),
                drag_scatter=float(uniform(0.003, 0.02)),
                coulomb_scatter=float(uniform(0.01, 0.05)),
                noise=float(uniform(0.03, 0.1)),
                wears_from=float(uniform(1.0, 7.0)) * MONTH if wears else math.inf,
                dirty_from=float(uniform(6.0, 7.0)) * MONTH if spoilt else math.inf,
                dirty_over=float(uniform(0.0, 1.5)) * MONTH,
                dirt=float(uniform(1.3, 1.8)),
            )
        )
    return World(seed, machines, tuple(valves), worn, dirty, changed)


@cache
def described_valve() -> Valve:
    """Return what every bag says of its valve: the data sheet's."""
    return find_valve("4weh10_soft")


def machine_vibration(generator: np.random.Generator) -> Excitation:
    """Return what shakes the machine on one day."""
    if generator.random() < 0.5:
        return Multisine(
            low_frequency=8.0,
            high_frequency=80.0,
            lines=LINES,
            rms=float(generator.uniform(3.0, 9.0)),
            seed=int(generator.integers(1000)),
        )
    low, high = float(generator.uniform(500.0, 700.0)), float(generator.uniform(1500.0, 2400.0))
    return MachineOrders(
        speed_profile=((0.0, low), (0.7 * SECONDS, high), (SECONDS, 0.5 * (low + high))),
        orders=((1.0, float(generator.uniform(3.0, 7.0))), (2.0, float(generator.uniform(1.0, 4.0)))),
        broadband_rms=float(generator.uniform(1.5, 4.0)),
        broadband_lines=LINES,
        seed=int(generator.integers(1000)),
    )


@dataclass(frozen=True, slots=True)
class BagTruth:
    """Truth of one bag: day since 1970, true and measured oil temperature (deg C), parameters in SI units."""

    day: float
    oil: float
    measured: float
    drag: float
    rubbing: float
    stiffness: float


def bag_truth(world: World, number: int, place: int) -> BagTruth:
    """Return the truth of bag ``place`` of a valve."""
    valve = world.valves[number]
    generator = np.random.default_rng([world.seed, 19, number, place])
    day = 7.0 * ((place + float(generator.uniform(0.0, 0.7))) / BAGS)
    # Valves of one machine share the weather of the day.
    weather = np.random.default_rng([world.seed, 20, valve.machine, int(day)])
    true, measured, factor = world.machines[valve.machine].oil(day, weather)
    sheet = described_valve()
    local = math.exp(float(generator.normal(0.0, valve.drag_scatter)))
    drag = sheet.viscous_coefficient_at(true) * factor * local * valve.drag(day) / valve.clearance
    rubs = valve.coulomb * valve.rubbing(day) * math.exp(float(generator.normal(0.0, valve.coulomb_scatter)))
    stiffness = sheet.spring_stiffness * valve.stiffness
    return BagTruth(FIRST_DAY + day, true, measured, drag, rubs, stiffness)


def simulated_bag(world: World, number: int, place: int) -> tuple[BagTruth, Simulator]:
    """Return truth and simulator of bag ``place`` of a valve."""
    truth, valve = bag_truth(world, number, place), world.valves[number]
    generator = np.random.default_rng([world.seed, 21, number, place])
    simulator = Simulator(
        described_valve().at(truth.oil),
        machine_vibration(generator),
        model="coulomb",
        parameters={
            "viscous_coefficient": truth.drag,
            "coulomb_force": truth.rubbing,
            "spring_stiffness": truth.stiffness,
        },
        sample_rate=SAMPLE_RATE,
        block_size=round(SAMPLE_RATE / 10.0),
        seed=int(generator.integers(2**31)),
        start_stamp=round(truth.day * DAY) * 1_000_000_000,
        body_sensor=Sensor(noise=valve.noise),
        spool_sensor=Sensor(noise=valve.noise),
    )
    return truth, simulator


@dataclass(frozen=True, slots=True)
class EstimationError:
    """Errors of one bag's estimates by parameter, and the deviations that were stated; both relative."""

    error: dict[str, float]
    deviation: dict[str, float]


def simulated_error(seed: int) -> EstimationError | None:
    """Return the errors of a bag drawn from ``seed``, simulated and estimated; ``None``: not tracked."""
    generator = np.random.default_rng([seed, 22])
    world = draw_world(seed)
    number = int(generator.integers(MACHINES * VALVES_EACH))
    truth, simulator = simulated_bag(world, number, int(generator.integers(WEEKS * BAGS)))
    estimator = make_estimator("prediction", settings_for(described_valve()))
    estimates: list[Estimate] = []
    for block in simulator.records(SECONDS):
        estimates += estimator.update(block)
    latest = estimates[-1] if estimates else None
    if latest is None or latest.state is not State.TRACKING:
        return None
    errors, deviations = {}, {}
    true = _parameters(truth)
    for quantity in latest.parameters:
        if not quantity.value > 0.0 or quantity.standard_deviation > UNCERTAIN * quantity.value:
            return None
        errors[quantity.name] = quantity.value / true[quantity.name] - 1.0
        deviations[quantity.name] = quantity.standard_deviation / quantity.value
    return EstimationError(errors, deviations)


def observe(world: World, errors: Sequence[EstimationError | None]) -> list[ObservedValve]:
    """Return what the tables would hold of ``world``, with estimation errors drawn from ``errors``."""
    return [_valve(world, number, errors) for number in range(len(world.valves))]


def _parameters(truth: BagTruth) -> dict[str, float]:
    return {VISCOUS: truth.drag, COULOMB: truth.rubbing, STIFFNESS: truth.stiffness}


def _valve(world: World, number: int, errors: Sequence[EstimationError | None]) -> ObservedValve:
    rows: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in PARAMETERS}
    generator = np.random.default_rng([world.seed, 23, number])
    sheet = described_valve()
    for place in range(WEEKS * BAGS):
        truth = bag_truth(world, number, place)
        error = errors[int(generator.integers(len(errors)))]
        if error is None:
            continue
        for name, true in _parameters(truth).items():
            value = true * (1.0 + error.error[name])
            if name == VISCOUS:
                value *= sheet.dynamic_viscosity_at(REFERENCE) / sheet.dynamic_viscosity_at(truth.measured)
            rows[name].append((truth.day, math.log(value), error.deviation[name], truth.measured))
    valve = world.valves[number]
    series = {}
    for name, own in rows.items():
        if own:
            day, logarithm, deviation, celsius = np.array(own).T
            series[name] = Series(day, logarithm, deviation, celsius, UNITS[name], name == VISCOUS)
    return ObservedValve(f"machine_{valve.machine + 1}", f"valve_{valve.number + 1}", series)
