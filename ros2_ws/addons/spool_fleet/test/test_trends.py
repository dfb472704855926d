"""Trends: what changed is found with its cause and time, what did not is not named."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_fleet.comparison import MONTH, Scatter, chance_score, likeliest_change, scatter_of
from spool_fleet.judgement import CHANGED, LEARNING, MACHINE, OK, UNKNOWN, Trend, judge
from spool_fleet.manifest import DAY, Service
from spool_fleet.observations import (
    BIN,
    COULOMB,
    PARAMETERS,
    STIFFNESS,
    VISCOUS,
    ObservedValve,
    Series,
    Weekly,
    weekly,
)

FIRST, WEEKS = 20_454.0, 40
VALUES = {VISCOUS: 2.5, COULOMB: 0.5, STIFFNESS: 1632.0}
UNITS = {VISCOUS: "N s/m", COULOMB: "N", STIFFNESS: "N/m"}


def fleet(
    changes: dict[tuple[int, int, str], np.ndarray] | None = None,
    *,
    machines: int = 2,
    valves: int = 4,
    temperature: bool = True,
    referred: bool = True,
    weeks: int = WEEKS,
) -> list[ObservedValve]:
    """Return valves that scatter by 1 % from week to week, with ``changes`` of their logarithms."""
    generator = np.random.default_rng(0)
    days = FIRST + BIN * np.arange(weeks) + 1.0
    found = []
    for machine in range(machines):
        warm = 45.0 + 10.0 * np.sin(2.0 * np.pi * (days - FIRST) / 365.0) + generator.normal(0.0, 2.0, weeks)
        for valve in range(valves):
            series = {}
            for name in PARAMETERS:
                row = np.log(VALUES[name]) + generator.normal(0.0, 0.01, weeks)
                if name == VISCOUS and not referred:
                    row = row - 0.04 * (warm - 45.0)
                row = row + (changes or {}).get((machine, valve, name), 0.0)
                celsius = warm if temperature else np.full(weeks, np.nan)
                series[name] = Series(
                    days, row, np.full(weeks, 0.002), celsius, UNITS[name], referred and name == VISCOUS
                )
            found.append(ObservedValve(f"m{machine}", f"v{valve}", series))
    return found


def changed(trends: list[Trend]) -> dict[tuple[str, str, str], Trend]:
    return {(one.machine, one.valve, one.parameter): one for one in trends if one.state in (CHANGED, MACHINE)}


def ramp(week: int, rate: float) -> np.ndarray:
    """Return a relative change of ``rate`` a month from ``week`` on, as logarithm."""
    return math.log1p(rate) * BIN / MONTH * np.maximum(0.0, np.arange(WEEKS) - week)


def test_a_healthy_fleet_names_nobody() -> None:
    trends = judge(fleet())
    assert changed(trends) == {}
    assert {one.state for one in trends} == {OK}


def test_wear_is_found_with_its_rate_and_the_time_left() -> None:
    trends = judge(fleet({(0, 1, VISCOUS): ramp(20, -0.03)}))
    ((key, one),) = changed(trends).items()
    assert key == ("m0", "v1", VISCOUS)
    assert one.cause == "wear"
    assert one.since == pytest.approx(FIRST + 20 * BIN, abs=3 * BIN)
    assert one.rate == pytest.approx(-0.03, abs=2.0 * one.rate_std + 0.003)
    expected, earliest, latest = one.months_left()
    # The monitor warns at 20 %: from -12.5 % on that is 2.5 months away.
    assert earliest <= expected <= latest
    assert expected == pytest.approx((-0.2 - one.change) / one.rate)


def test_contamination_is_told_from_wear() -> None:
    trends = changed(judge(fleet({(1, 2, COULOMB): np.where(np.arange(WEEKS) >= 25, math.log(1.5), 0.0)})))
    assert [(key, one.cause) for key, one in trends.items()] == [(("m1", "v2", COULOMB), "oil_contamination")]
    (one,) = trends.values()
    assert one.change == pytest.approx(0.5, abs=0.03)
    assert math.isnan(one.rate)


def test_a_spring_that_sets_is_a_spring() -> None:
    trends = changed(judge(fleet({(0, 0, STIFFNESS): np.where(np.arange(WEEKS) >= 30, math.log(0.9), 0.0)})))
    assert {one.cause for one in trends.values()} == {"spring_change"}


def test_the_season_is_no_wear_where_the_temperature_is_known() -> None:
    assert changed(judge(fleet(referred=False))) == {}


def test_drag_is_not_judged_without_temperature_and_sisters() -> None:
    trends = judge(fleet(machines=1, valves=1, temperature=False, referred=False))
    states = {one.parameter: one.state for one in trends}
    assert states == {VISCOUS: UNKNOWN, COULOMB: OK, STIFFNESS: OK}


def oil(machine: int) -> dict[tuple[int, int, str], np.ndarray]:
    step = np.where(np.arange(WEEKS) >= 20, math.log(1.08), 0.0)
    return {(machine, valve, VISCOUS): step for valve in range(4)}


def test_an_oil_change_that_is_told_is_no_change_of_a_valve() -> None:
    day = FIRST + 20 * BIN
    service = Service("m0", "", round(day * DAY) * 1_000_000_000, "oil_change")
    assert changed(judge(fleet(oil(0)), [service])) == {}


def test_an_oil_change_that_is_not_told_is_the_machines() -> None:
    trends = changed(judge(fleet(oil(0), machines=4)))
    assert {(key[0], one.state, one.cause) for key, one in trends.items()} == {
        ("m0", MACHINE, "oil_viscosity")
    }


def test_wear_goes_on_through_an_oil_change() -> None:
    changes = oil(0)
    changes[0, 1, VISCOUS] = changes[0, 1, VISCOUS] + ramp(15, -0.03)
    service = Service("m0", "", round((FIRST + 20 * BIN) * DAY) * 1_000_000_000, "oil_change")
    trends = changed(judge(fleet(changes), [service]))
    assert list(trends) == [("m0", "v1", VISCOUS)]
    assert trends["m0", "v1", VISCOUS].cause == "wear"


def test_few_weeks_are_learning() -> None:
    assert {one.state for one in judge(fleet(weeks=4))} == {LEARNING}


def test_nothing_is_known_of_the_future() -> None:
    late = fleet({(0, 1, VISCOUS): ramp(20, -0.03)})
    assert changed(judge(late, until=FIRST + 20 * BIN)) == {}


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.floats(0.01, 100.0), st.integers(-2000, 2000))
def test_units_and_calendar_do_not_matter(factor: float, weeks: int) -> None:
    changes = {(0, 1, VISCOUS): ramp(20, -0.03)}
    plain = judge(fleet(changes, machines=1))
    moved = [
        ObservedValve(
            one.machine,
            one.valve,
            {
                name: Series(
                    row.days + BIN * weeks, row.logarithm + math.log(factor), row.deviation, row.temperature,
                    row.unit, row.referred,
                )
                for name, row in one.series.items()
            },
        )
        for one in fleet(changes, machines=1)
    ]  # fmt: skip
    for one, other in zip(plain, judge(moved), strict=True):
        assert other.state == one.state
        assert other.change == pytest.approx(one.change, rel=1e-6)
        assert other.baseline == pytest.approx(factor * one.baseline, rel=1e-6)


def test_the_score_of_white_noise_is_that_of_chance() -> None:
    generator = np.random.default_rng(1)
    weeks = 30
    scores = []
    for _ in range(300):
        row = generator.normal(0.0, 0.01, weeks)
        nothing = np.full(weeks, np.nan)
        own = Weekly(np.arange(weeks), row, np.ones(weeks), nothing, np.zeros(weeks, dtype=np.int64))
        found = likeliest_change(own, Scatter(1e-4, 0.0), [], 3)
        assert found is not None
        scores.append(found.score)
    assert np.median(scores) == pytest.approx(chance_score(weeks), rel=0.1)


def test_valves_that_are_equally_noisy_are_found_to_be() -> None:
    """What their variances differ by, of 40 weeks each, is chance."""
    rows = np.random.default_rng(1).normal(0.0, 0.01, (200, WEEKS))
    nothing, none = np.full(WEEKS, np.nan), np.zeros(WEEKS, dtype=np.int64)
    found = scatter_of([Weekly(np.arange(WEEKS), row, np.ones(WEEKS), nothing, none) for row in rows])
    assert found.noise == pytest.approx(1e-4, rel=0.05)
    assert found.noise_spread < 0.03


def test_one_odd_bag_hardly_moves_its_week() -> None:
    days = FIRST + np.arange(5.0)
    row = Series(days, np.array([1.0, 1.1, 0.9, 1.0, 50.0]), np.ones(5), np.full(5, 40.0), "N")
    assert weekly(row).value[0] == pytest.approx(1.0, abs=0.06)


def test_a_week_is_the_middle_of_its_bags() -> None:
    days = FIRST + np.array([0.0, 1.0, 2.0, 7.0, 8.0])
    row = Series(days, np.array([1.0, 3.0, 2.0, 3.0, 5.0]), np.ones(5), np.full(5, 40.0), "N")
    assert weekly(row).value.tolist() == [2.0, 4.0]
    # Of the week of a service only what came after it counts.
    assert weekly(row, [FIRST + 1.5]).value.tolist() == [2.0, 4.0]
    assert weekly(row, [FIRST + 7.5]).value.tolist() == [2.0, 5.0]
