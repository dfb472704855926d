"""Simulated operation: what a day is made of, how it is replayed, and the monitor's figures on a sample."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.identification.oil import OilReference, oil_law
from spool_monitor.parameter_drift import CAP, CumulativeSum
from spool_operation.comparison import YEAR, threshold_of
from spool_operation.peers import WINDOW, best_split, page_hinkley, page_sum, run_level, soonest
from spool_operation.run_day import (
    MEMORY,
    DayOutcome,
    DayRun,
    RaisedEvent,
    SurrogateEstimates,
    judged,
    run_day,
    severity_of,
)
from spool_operation.study import false_table, fault_table, parts
from spool_operation.surrogate import load_surrogate
from spool_operation.world import DAY, ValveDay, draw_day, features, stretches_of


def of_kind(name: str, speed: str, seed: int = 0) -> int:
    """Return the first seed from ``seed`` on whose day has that fault, and a thermometer."""
    while True:
        day = draw_day(seed, faulty=True)
        if day.fault is not None and (day.fault.name, day.fault.speed) == (name, speed) and day.thermometer:
            return seed
        seed += 1


def test_a_day_is_replayed_from_its_seed() -> None:
    first, again = (replace(run_day(5, faulty=True), cost=0.0) for _ in range(2))
    assert repr(first) == repr(again)


def test_machines_stand_half_of_the_time_and_the_oil_warms_while_they_run() -> None:
    days = [draw_day(seed) for seed in range(60)]
    shares = [sum(hold.end - hold.begin for hold in day.holds) / DAY for day in days]
    assert 0.4 < np.mean(shares) < 0.65
    assert all(day.oil[day.holds[0].end] > day.oil[day.holds[0].begin] for day in days)
    assert any(not day.thermometer for day in days)
    assert any(day.restarts for day in days)
    assert any(day.gaps for day in days)
    assert any(day.weekend > 40 * 3600.0 for day in days)


def test_healthy_days_raise_nothing() -> None:
    assert [run_day(seed).false for seed in range(300, 304)] == [()] * 4


@pytest.mark.slow
def test_a_hundred_days_raise_a_false_alarm_on_three_at_most() -> None:
    assert sum(bool(run_day(seed).false) for seed in range(500, 600)) <= 3


@pytest.mark.parametrize(
    ("day", "kind", "cause"),
    [
        (("wear", "minutes"), "friction_drift", "oil_or_wear"),
        (("contamination", "step"), "friction_drift", "oil_contamination"),
        (("spring fatigue", "minutes"), "spring_change", "softer"),
        (("sticking", "step"), "stuck_spool", ""),
        (("sensor: dead", "step"), "sensor_fault", "dead"),
        # A spring that breaks, dry friction and a gain that jump.
        pytest.param(4_000_090, "spring_change", "softer", marks=pytest.mark.slow),
        pytest.param(3_000_123, "friction_drift", "oil_contamination", marks=pytest.mark.slow),
        pytest.param(3_000_167, "sensor_fault", "scale", marks=pytest.mark.slow),
    ],
)
def test_a_fault_is_found_and_named(day: int | tuple[str, str], kind: str, cause: str) -> None:
    outcome = run_day(day if isinstance(day, int) else of_kind(*day), faulty=True)
    assert outcome.found is not None
    assert (outcome.found.kind, outcome.found.cause, outcome.false) == (kind, cause, ())
    assert outcome.right
    assert outcome.since_begin > 0.0


def test_the_oil_of_the_surrogate_is_that_of_the_estimator() -> None:
    day = draw_day(3)
    made = SurrogateEstimates(day, load_surrogate())
    reading = 40.0 + 0.01 * np.arange(200.0)
    viscous, deviation = np.full(200, 5.0), np.full(200, 0.02)
    referred, uncertain = made._referred(viscous, deviation, reading)
    oil = OilReference(oil_law(day.valve), MEMORY)
    for second in range(200):
        oil.take((second + 1) * 1_000_000_000, float(reading[second]))
        oil.follow((second + 1) * 1_000_000_000 + 500_000_000, 1.0)
    real = oil.referred(Quantity("viscous_coefficient", "N s/m", 5.0, 0.02, Validity.VALID))
    assert referred[-1] == pytest.approx(real.value, rel=2e-3)
    assert uncertain[-1] == pytest.approx(real.standard_deviation, rel=2e-2)


def test_a_gain_error_moves_the_stiffness_of_the_surrogate_as_that_of_the_estimator() -> None:
    day, gain, friction = draw_day(3), 0.01, 0.3
    valve, shaft = day.valve, 1.8 * day.valve.natural_frequency
    found = []
    for error in (0.0, gain):
        measuring = replace(day.measuring, gain_error=error)
        machine = day.shaking.machine(((0.0, shaft), (30.0, shaft)), ())
        simulator = measuring.simulator(
            valve, machine, coulomb_force=friction, parameters={"viscous_coefficient": 2.0}, seed=5
        )
        estimator = Estimator(settings_for(valve))
        estimates = [one for block in simulator.records(20.0) for one in estimator.update(block)]
        found.append(float(np.median([one.parameters[0].value for one in estimates[-10:]])))
    place = features(valve, 2.0, friction, shaft, day.shaking, day.measuring.noise)
    moved = gain * load_surrogate().sensitivity(place)[0]
    assert moved == pytest.approx((found[1] - found[0]) / valve.spring_stiffness, rel=0.3)


def test_what_a_gain_error_makes_of_the_stiffness_falls_while_the_oil_warms() -> None:
    """In thick oil 1 % of gain is up to 6 % of stiffness, in warm oil about 1 %."""
    day = draw_day(9005380)
    first = day.holds[0]
    made = SurrogateEstimates(day, load_surrogate()).production(first, first.begin, first.end, 0)
    found = [(second, one.parameters[0].value / day.valve.spring_stiffness - 1.0) for second, one in made]
    begin = np.mean([off for second, off in found if 30.0 < second - first.begin < 60.0])
    end = np.mean([off for second, off in found if second > first.end - 300.0])
    assert begin > 0.05
    assert abs(end) < 0.03


class YearRun(DayRun):
    """Run that takes sizes at the end of each hold: serialised monitor, its files (bytes)."""

    def __init__(self, day: ValveDay, folder: Path) -> None:
        super().__init__(day, folder)
        self.sizes: list[tuple[int, int]] = []

    def _ended(self) -> None:
        self.sizes.append((len(pickle.dumps(self.monitor)), self.state_size))


def test_memory_stays_as_it_is_over_weeks(tmp_path: Path) -> None:
    draw = np.random.default_rng([3, 31])
    months = stretches_of(draw, draw_day(3), 90, 120, 86_400)
    one = YearRun(replace(months, weekend=0.0, fault=None, dense=True), tmp_path)
    one.run()
    one.close()
    monitor, files = np.array(one.sizes, dtype=float).T
    # Bounded histories fill for 60 days.
    assert abs(np.polyfit(np.arange(30.0), monitor[60:], 1)[0]) < 1000.0
    # Pages of a database: what a month fills is not exceeded later.
    assert np.ptp(files[files.size // 3 :]) == 0.0
    assert files.max() < 200_000.0


# Peers.


def test_the_best_setting_misses_least_and_then_is_soonest() -> None:
    delays = {"late": [9.0, 9.0], "soon": [4.0, 6.0], "misses": [1.0, math.inf], "before": [math.nan, 1.0]}
    name, _ = soonest({name: np.array(found) for name, found in delays.items()})
    assert name == "soon"


def test_the_best_split_is_the_one_that_ruptures_finds() -> None:
    import ruptures  # noqa: PLC0415 - slow to load

    values = np.random.default_rng(4).normal(0.0, 0.1, WINDOW) + 1.0 * (np.arange(WINDOW) >= 50)
    gain = float(best_split(values)[-1])
    search = ruptures.KernelCPD(kernel="linear", min_size=4).fit(values)
    assert len(search.predict(pen=0.99 * gain)) > 1
    assert len(search.predict(pen=1.01 * gain)) == 1


@pytest.mark.parametrize(("delta", "forgets"), [(0.05, 1.0), (0.2, 0.99)])
@pytest.mark.parametrize("step", [1.0, -1.0])
def test_page_and_hinkley_find_a_step_at_the_value_at_which_river_finds_it(
    delta: float, forgets: float, step: float
) -> None:
    from river.drift import PageHinkley  # noqa: PLC0415 - slow to load

    values = np.random.default_rng(4).normal(0.0, 0.1, 200) + step * (np.arange(200) >= 120)
    statistic = page_hinkley(values, delta, forgets)
    for threshold in (0.5, 2.0, 8.0):
        peer = PageHinkley(min_instances=1, delta=delta, threshold=threshold, alpha=forgets)
        found = []
        for value in values:
            peer.update(value)
            found.append(peer.drift_detected)
        assert found.index(True) == np.argmax(statistic > threshold) >= 120


def test_without_a_hazard_the_level_of_a_run_is_the_conjugate_mean_of_all_values() -> None:
    """Bayes' rule for a normal level whose standard deviation beforehand is 1: the mean in closed form."""
    values = np.array([0.3, 0.5, 0.1, 0.4])
    expected = values.sum() / 0.2**2 / (1.0 + values.size / 0.2**2)
    assert run_level(values, 0.0, 0.2)[-1] == pytest.approx(expected)


def test_the_level_of_a_run_follows_a_step_and_forgets_what_was_before() -> None:
    generator = np.random.default_rng(3)
    values = np.concatenate([generator.normal(0.0, 0.1, 60), generator.normal(1.0, 0.1, 40)])
    level = run_level(values, 1e-3, 0.1)
    assert level[59] < 0.05
    assert level[-1] == pytest.approx(1.0, abs=0.05)


def test_pages_sum_is_the_one_that_ships() -> None:
    values = np.random.default_rng(5).normal(0.3, 2.0, 100)
    total, sizes = CumulativeSum(0.1, CAP), []
    for number, value in enumerate(values):
        total.update((number + 1) * 1_000_000_000, float(value), 1.0)
        sizes.append(total.size)
    assert page_sum(values, 0.1) == pytest.approx(np.array(sizes))


def test_pages_sum_of_a_constant_grows_by_what_exceeds_the_allowance() -> None:
    assert page_sum(np.full(10, 0.5), 0.2)[-1] == pytest.approx(3.0)


def test_three_thresholds_are_passed_once_a_year() -> None:
    """Days whose largest value has an exponential tail of mean 1: ln(3 * 365.25) on average for each."""
    found = [threshold_of(np.random.default_rng(seed).exponential(1.0, 200).tolist()) for seed in range(50)]
    assert np.mean(found) == pytest.approx(np.log(3 * YEAR), rel=0.1)


def test_a_surrogate_is_read_by_the_names_of_its_numbers(tmp_path: Path) -> None:
    """In any order; one that lacks a number is refused with what makes another."""
    written, turned = tmp_path / "written.json", tmp_path / "turned.json"
    load_surrogate().write(written)
    kept = json.loads(written.read_text("utf-8"))
    kept["rows"] = [dict(reversed(row.items())) for row in kept["rows"]]
    turned.write_text(json.dumps(kept), "utf-8")
    assert repr(load_surrogate(turned).rows) == repr(load_surrogate().rows)
    del kept["rows"][0]["inertia"]
    turned.with_name("lacks.json").write_text(json.dumps(kept), "utf-8")
    with pytest.raises(InputError, match="operation-fit"):
        load_surrogate(turned.with_name("lacks.json"))


# Counts.


def test_a_slow_drift_is_as_large_as_it_is_when_production_ends() -> None:
    """Seed 7000079: a spring that loses 34 % in 66 minutes, of which the day sees 11."""
    day = draw_day(7_000_079, faulty=True)
    assert day.fault is not None
    seen = (day.holds[-1].end - 1.0 - day.fault.begin) / day.fault.lasting
    assert severity_of(day) == pytest.approx(seen * day.fault.severity, rel=1e-6)
    assert severity_of(day) < 1.0
    early = DayOutcome(9, True, "spring fatigue", "hours", severity_of(day))
    assert "0 days with a fault of the size" in "\n".join(parts([early]))


def test_what_the_day_explains_is_no_false_alarm() -> None:
    day = replace(draw_day(1), gaps=((1000, 1010),))
    lost = RaisedEvent(1011.0, "data_fault", "lost", False)
    other = RaisedEvent(5000.0, "data_fault", "lost", False)
    assert judged(day, [lost, other]) == (None, False, [other])


def test_a_cause_left_open_is_right_only_once_the_right_one_is_named() -> None:
    days = (draw_day(seed, faulty=True) for seed in range(100))
    day = next(day for day in days if day.fault is not None and day.fault.name == "wear")
    left, wear, other = (
        RaisedEvent(day.holds[-1].end - 100.0 + second, "friction_drift", cause, False)
        for second, cause in enumerate(("oil_or_wear", "wear", "unknown"))
    )
    assert judged(day, [left]) == (left, False, [])
    assert judged(day, [left, wear, other]) == (left, True, [])
    assert judged(day, [left, other, wear]) == (left, False, [])


def test_the_page_gives_rates_with_intervals_and_how_to_replay_a_day() -> None:
    false = RaisedEvent(10.0, "friction_drift", "wear", False)
    healthy = [DayOutcome(1, False, false=(false,)), *(DayOutcome(seed, False) for seed in range(2, 731))]
    assert "| friction_drift wear | 1 | 0.50 | 0.01 to 2.79 |" in false_table(healthy)
    missed = DayOutcome(9, True, "wear", "step", 2.5)
    assert "0/1 = 0.0 % (0.0 to 97.5)" in fault_table([missed])
    page = "\n".join(parts([*healthy, missed]))
    assert "./spool study operation --day SEED" in page
    assert "missed, severity 2.50" in page
