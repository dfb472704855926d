from __future__ import annotations

import math
from dataclasses import replace

import pytest
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.identification.oil import LAG, LONGEST_AGE, USUAL_DEVIATION, OilReference, oil_law
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import DEFAULT_START_STAMP, Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
VISCOUS = Quantity("viscous_coefficient", "N s/m", 4.0, 0.01, Validity.VALID)
SECOND = 1_000_000_000
START = DEFAULT_START_STAMP


def warming(seconds: float, warmest: float, *, told: bool, late: int = 0) -> list[Estimate]:
    """Return the estimates while the oil warms from 20 deg C; temperatures come ``late`` blocks late."""
    simulator = Simulator(
        VALVE,
        PRESETS["multisine"],
        coulomb_force=0.0,
        seed=3,
        body_sensor=Sensor(noise=0.03),
        spool_sensor=Sensor(noise=0.03),
    )
    simulator.set_drift("oil_temperature", warmest, seconds)
    estimator = Estimator(settings_for(VALVE))
    estimates = []
    waiting = []
    for number in range(round(seconds * 50)):
        if told and number % 50 == 0:
            waiting.append((number + late, simulator.stamp, simulator.truth.oil_temperature))
        while waiting and waiting[0][0] <= number:
            estimator.update_temperature(*waiting.pop(0)[1:])
        estimates += estimator.update(simulator.next_block())
    return estimates


def test_a_warming_valve_keeps_its_referred_coefficient_while_its_drag_falls_by_half() -> None:
    estimates = warming(90.0, 35.0, told=True)[5:]
    drags = [one.parameter("viscous_coefficient").value for one in estimates]
    assert drags[-1] < 0.5 * drags[0]
    for one in estimates:
        referred = one.referred_viscous_coefficient
        assert referred.validity is Validity.VALID
        assert referred.value == pytest.approx(VALVE.viscous_coefficient, rel=0.04)
        assert abs(referred.value - VALVE.viscous_coefficient) < 2.0 * referred.standard_deviation
        # 90 s from 20 to 35 deg C; the temperature is that of the motion described, told once a second.
        assert one.oil_temperature.value == pytest.approx(20.0 + (one.stamp - START) / SECOND / 6.0, abs=0.3)


@pytest.mark.parametrize("read", [-9999.0, -242.0, 850.0, math.inf, math.nan])
def test_what_no_oil_has_is_no_temperature(read: float) -> None:
    oil = OilReference(oil_law(VALVE), 4.0)
    oil.take(START - SECOND, read)
    assert not oil.temperature(START).known
    oil.take(START, 40.0)
    oil.take(START + SECOND, read)
    oil.follow(START + 3 * SECOND, 1.0)
    assert oil.refused == 2
    assert oil.temperature(START + 3 * SECOND).value == 40.0


def test_without_a_temperature_the_referred_coefficient_is_unknown() -> None:
    last = warming(6.0, 25.0, told=False)[-1]
    assert last.parameter("viscous_coefficient").validity is Validity.VALID
    assert last.referred_viscous_coefficient.validity is Validity.UNKNOWN
    assert last.oil_temperature.validity is Validity.UNKNOWN
    assert math.isnan(last.referred_viscous_coefficient.value)


def test_a_temperature_that_comes_after_its_blocks_changes_no_bit() -> None:
    early, late = warming(8.0, 30.0, told=True), warming(8.0, 30.0, told=True, late=15)
    assert list(map(repr, early)) == list(map(repr, late))


def test_the_ratio_is_that_of_the_law_and_the_uncertainty_that_of_its_slope() -> None:
    reference = OilReference(oil_law(VALVE), 4.0)
    reference.take(SECOND, 40.0, 0.2)
    reference.follow(2 * SECOND, 1.0)
    referred = reference.referred(VISCOUS)
    ratio = VALVE.at(40.0).viscous_coefficient / VALVE.viscous_coefficient
    assert referred.value == pytest.approx(4.0 / ratio)
    slope = VALVE.at(40.01).viscous_coefficient / VALVE.at(39.99).viscous_coefficient - 1.0
    by_temperature = 4.0 / ratio * abs(slope) / 0.02 * 0.2
    assert referred.standard_deviation == pytest.approx(math.hypot(by_temperature, 0.01 / ratio), rel=1e-3)
    assert reference.referred(replace(VISCOUS, validity=Validity.HELD)).validity is Validity.HELD


@pytest.mark.parametrize(("oil", "celsius"), [(VALVE.oil, -100.0), (VALVE.oil, 400.0), (None, 50.0)])
def test_outside_of_the_law_and_without_one_nothing_is_referred(oil: str | None, celsius: float) -> None:
    reference = OilReference(oil_law(VALVE.model_copy(update={"oil": oil})), 4.0)
    reference.take(SECOND, celsius)
    reference.follow(2 * SECOND, 1.0)
    assert oil or reference.temperature(2 * SECOND).value == celsius
    assert reference.referred(VISCOUS).validity is Validity.UNKNOWN


def test_an_old_temperature_is_no_longer_known() -> None:
    reference = OilReference(oil_law(VALVE), 4.0)
    reference.take(SECOND, 40.0)
    end = SECOND + round((LONGEST_AGE + LAG) * SECOND)
    reference.follow(end, 1.0)
    assert reference.temperature(end).standard_deviation == USUAL_DEVIATION
    assert reference.referred(VISCOUS).known
    reference.follow(end + 1, 1.0)
    assert not reference.temperature(end + 1).known
    assert not reference.referred(VISCOUS).known


def test_time_that_goes_back_begins_anew() -> None:
    reference = OilReference(oil_law(VALVE), 4.0)
    reference.take(100 * SECOND, 40.0)
    reference.follow(101 * SECOND, 1.0)
    reference.take(99 * SECOND, 45.0)
    assert reference.refused == 1
    reference.take(10 * SECOND, 30.0)
    reference.follow(11 * SECOND, 1.0)
    assert reference.temperature(11 * SECOND).value == 30.0
