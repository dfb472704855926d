"""Study of fleets: wear and contamination found in time, their causes, and valves named that are healthy."""

from __future__ import annotations

import contextlib
import io
import math
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from functools import cache, partial
from pathlib import Path

import numpy as np
from spool_core.errors import InputError
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_fleet.judgement import CHANGED, MACHINE, confirmed, judged_alone
from spool_fleet.manifest import Service
from spool_fleet.observations import COULOMB, PARAMETERS, STIFFNESS, UNCERTAIN, VISCOUS, ObservedValve, Series
from spool_fleet.operations import add_to_store, answer, run_over_store
from spool_fleet.parquet import REFERENCE
from spool_report.records.simulation import simulate
from spool_report.requests import SimulationSettings
from spool_sim.excitation import Excitation, MachineOrders, Multisine
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve

from spool_evaluation.results.page import Proportion, markdown_table, renew_json, study_command, write_page
from spool_evaluation.studies.workers import resumed, spread

#: Months after its beginning by which a change is to be found.
IN_TIME = 2.0
#: Bags whose estimation errors are drawn from, and the seed of the first: no fleet of a study has it.
ERRORS, ERRORS_FROM = 2000, 10_000_000
#: Weeks before which nothing is judged.
FIRST_WEEK = 5
ABOUT = (
    "A fleet of 20 valves on 5 machines over a year, a bag of each valve every working day, with estimation "
    "errors of bags that were simulated and estimated by what ships: oil temperatures with seasons and "
    "weather, sensors of them with offsets and wrong gains, oils that differ from "
    "their law, scatter from bag to bag, vibration that changes. One valve wears 3 % a month, one is "
    "contaminated in month 7, the oil of one machine is changed, which is reported. It is judged every "
    "week with what was known then; a healthy valve that is named once in the year counts as false."
)


@dataclass(frozen=True, slots=True)
class FleetOutcome:
    """Outcome of one fleet: months from the beginning to the finding (NaN: never), causes, false valves."""

    seed: int
    wear_months: float
    wear_cause: str
    dirt_months: float
    dirt_cause: str
    false: tuple[str, ...]
    valve_years: float


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> None:
    """Judge ``cases`` fleets from ``seed`` on; ``out`` gets ``fleet_study.md`` and a row of each fleet.

    Fleets whose rows ``out`` holds already are not judged again.
    """
    errors = list(spread(simulated_error, range(ERRORS_FROM, ERRORS_FROM + ERRORS), "bags", workers))
    errors.sort(key=repr)  # they come in any order
    judged, seeds, done = partial(judge_fleet, errors=errors), range(seed, seed + cases), list[FleetOutcome]()
    for outcome in resumed(
        out / "fleets.jsonl", FleetOutcome, lambda one: one.seed, judged, seeds, "fleets", workers
    ):
        done.append(outcome)
        done.sort(key=lambda one: one.seed)
        _write(out, done, study_command("fleet", cases, seed))


def judge_fleet(seed: int, errors: Sequence[EstimationError | None]) -> FleetOutcome:
    """Return how the fleet of ``seed`` was judged, week by week."""
    world = draw_world(seed)
    valves = observe(world, errors)
    services = _services(world)
    worn, dirty = valves[world.worn].key, valves[world.dirty].key
    begins = {
        worn: FIRST_DAY + world.valves[world.worn].wears_from,
        dirty: FIRST_DAY + world.valves[world.dirty].dirty_from,
    }
    found: dict[tuple[str, str], tuple[float, str]] = {}
    false: set[str] = set()
    seen = judged_alone(valves, services, FIRST_DAY + 7.0 * (FIRST_WEEK - 1))
    for week in range(FIRST_WEEK, WEEKS + 1):
        day = FIRST_DAY + 7.0 * week
        before, seen = seen, judged_alone(valves, services, day)
        for trend in confirmed(seen, before):
            key = (trend.machine, trend.valve)
            if trend.state == MACHINE:
                false.add(f"{trend.machine}: {trend.parameter}")
            elif trend.state == CHANGED and day < begins.get(key, math.inf):
                false.add(f"{trend.machine} {trend.valve}: {trend.parameter}")
            elif trend.state == CHANGED and key not in found:
                found[key] = ((day - begins[key]) / MONTH, trend.cause)
    nothing = (math.nan, "")
    years = len(valves) * WEEKS * 7.0 / 365.25
    return FleetOutcome(
        seed, *found.get(worn, nothing), *found.get(dirty, nothing), tuple(sorted(false)), years
    )


def _services(world: World) -> list[Service]:
    number = world.changed_machine
    day = FIRST_DAY + world.machines[number].change_day
    return [Service(f"machine_{number + 1}", "", round(day * DAY) * 1_000_000_000, "oil_change")]


def _write(out: Path, outcomes: list[FleetOutcome], command: str) -> None:
    rows = [
        _row("wear, 3 % a month", [(one.wear_months, one.wear_cause == "wear") for one in outcomes]),
        _row(
            "contamination in month 7",
            [(one.dirt_months, one.dirt_cause == "oil_contamination") for one in outcomes],
        ),
    ]
    head = ("change", "found by the second month", "cause right", "months to the finding, median (90 %)")
    years = sum(one.valve_years for one in outcomes)
    named = sum(len({text.partition(":")[0] for text in one.false}) for one in outcomes)
    lines = (
        f"{named} healthy valves were named in {years:.0f} valve-years of {len(outcomes)} fleets, "
        f"those of faulty valves counted too: {100.0 * named / years:.2f} in 100 valve-years."
        if outcomes
        else ""
    )
    write_page(
        out / "fleet_study.md", "Fleets over a year", command, [ABOUT, markdown_table(head, rows), lines]
    )


def _row(name: str, found: list[tuple[float, bool]]) -> list[str]:
    in_time = [months <= IN_TIME for months, _ in found]
    right = [cause for (months, cause) in found if not math.isnan(months)]
    known = sorted(months for months, _ in found if not math.isnan(months))
    spent = f"{known[len(known) // 2]:.1f} ({known[int(0.9 * len(known))]:.1f})" if known else "-"
    return [name, str(Proportion(sum(in_time), len(found))), str(Proportion(sum(right), len(right))), spent]


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
    drag = sheet.at(true).viscous_coefficient * factor * local * valve.drag(day) / valve.clearance
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
    estimator = Estimator(settings_for(described_valve()))
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


#: Machines and valves of each that the bags are of, one bag a week of each, and the first day.
COST_MACHINES, COST_VALVES, FIRST_DATE = 40, 5, date(2026, 1, 5)
#: s and Hz of a bag: short, for what grows with the number of bags is asked, not with their length.
BAG_SECONDS, BAG_RATE = 4.0, 500.0
ANALYSES = "features"
SMALLEST = 100
#: Times a query is asked; the median counts.
REPEATS = 5
ABOUT_COST = (
    "Short bags (4 s at 500 Hz) of 40 machines with 5 valves each, looked at, analysed (`features`), judged. "
    "Each size is a separate store, filled from empty."
)


@dataclass(frozen=True, slots=True)
class FleetCost:
    """Cost of a store of so many bags: seconds a bag of each step, of a query; files; peak memory in MB."""

    bags: int
    add: float
    run: float
    query: float
    files: int
    driver: float


def run_cost(cases: int, seed: int, out: Path, workers: int | None = None) -> list[FleetCost]:
    """Measure stores of 100, 1000 ... up to ``cases`` bags; ``out`` gets ``fleet_cost.md`` and ``.json``.

    Raises:
        InputError: ``cases`` is below 100.
    """
    if cases < SMALLEST:
        raise InputError(f"--cases {cases}: a store has {SMALLEST} bags at least here")
    bags = out / "bags"
    for _ in spread(partial(_bag, bags, seed), range(cases), "bags", workers):
        pass
    sizes = [SMALLEST]
    while sizes[-1] * 10 <= cases:
        sizes.append(sizes[-1] * 10)
    costs = []
    for size in sizes:
        costs.append(_cost(bags, out / "store", size, workers))
        _write_costs(out, costs, study_command("fleet-cost", cases, seed))
    shutil.rmtree(bags)
    return costs


def _bag(folder: Path, seed: int, number: int) -> None:
    """Make one bag unless it is there."""
    machine, valve, week = (
        number % COST_MACHINES,
        number // COST_MACHINES % COST_VALVES,
        number // (COST_MACHINES * COST_VALVES),
    )
    day = (FIRST_DATE + timedelta(weeks=week)).isoformat()
    path = folder / str(len(str(number))) / f"press_{machine}" / day / f"valve_{valve}"
    if path.exists():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.redirect_stdout(io.StringIO()):
        settings = SimulationSettings(
            "4weh10_soft", "coulomb", "sweep", BAG_SECONDS, sample_rate=BAG_RATE, block_rate=10.0,
            seed=seed + number, oil_temperature="40",
        )  # fmt: skip
        simulate(path, settings)


def _cost(bags: Path, store: Path, size: int, workers: int | None) -> FleetCost:
    """Return what a fresh store of the first ``size`` bags costs."""
    shutil.rmtree(store, ignore_errors=True)
    folders = [bags / str(digits) for digits in range(1, len(str(size - 1)) + 1)]
    begun = time.perf_counter()
    added = add_to_store(store, folders, "{machine}/{date}/{valve}", None, "", workers)
    looked = time.perf_counter()
    run_over_store(store, ANALYSES, workers, None)
    done = time.perf_counter()
    asked = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        answer(store, None, "trend", "press_1", "valve_1", "body_rms")
        asked.append(time.perf_counter() - start)
    files = sum(1 for _ in (store / "tables").rglob("*.parquet"))
    import resource  # noqa: PLC0415 - Windows has none, and compares fleets, too

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    shutil.rmtree(store)
    count = added.new
    return FleetCost(
        count, (looked - begun) / count, (done - looked) / count, sorted(asked)[REPEATS // 2], files, peak
    )


def _write_costs(out: Path, costs: Sequence[FleetCost], command: str) -> None:
    head = ("bags", "add, ms a bag", "run, ms a bag", "trend query, s", "files", "driver, peak MB")
    rows = [
        [
            f"{one.bags}", f"{1e3 * one.add:.1f}", f"{1e3 * one.run:.1f}", f"{one.query:.2f}", f"{one.files}",
            f"{one.driver:.0f}",
        ]
        for one in costs
    ]  # fmt: skip
    renew_json(out / "fleet_cost.json", costs)
    write_page(out / "fleet_cost.md", "Cost of a fleet", command, [ABOUT_COST, markdown_table(head, rows)])
