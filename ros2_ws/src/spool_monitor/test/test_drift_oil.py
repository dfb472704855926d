from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from spool_core.events.event import Urgency
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import Judgement, MonitorSettings
from spool_monitor.detectors.base import FALSE_ALARM_INTERVAL
from spool_monitor.event import Event, Severity
from spool_monitor.monitor import Monitor
from spool_monitor.parameter_drift import ParameterDrift
from spool_monitor.replay import Replay
from spool_monitor.state_file import Baseline
from spool_monitor.warming import FASTEST, SLOWEST
from spool_sim.excitation import SweptSine
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")


def stuck(*, told: bool, dry: float) -> bool:
    """Return whether a valve learned at 41 deg C and started at 5, below resonance, is called stuck."""
    noisy = Sensor(noise=0.03)
    simulator = Simulator(
        VALVE, SweptSine(start_frequency=11.0, stop_frequency=12.0, duration=8.0, amplitude=6.0), seed=5,
        parameters={"viscous_coefficient": 80.0}, coulomb_force=dry, body_sensor=noisy, spool_sensor=noisy,
    )  # fmt: skip
    monitor = Monitor(MonitorSettings(natural_frequency=15.15))
    # As the state file has it.
    monitor.detection.parameters["viscous_coefficient"].temperature = 41.0
    both = Replay(Estimator(settings_for(VALVE)), monitor)
    for number in range(8 * 50):
        if told and number % 50 == 0:
            both.update_temperature(simulator.stamp, 5.0)
        both.update(simulator.next_block())
    return any(event.kind == "stuck_spool" for event in both.events)


def test_a_spool_in_cold_oil_is_not_stuck_where_its_temperature_is_known() -> None:
    assert not stuck(told=True, dry=0.1)
    assert stuck(told=False, dry=0.1)
    assert stuck(told=True, dry=30.0)


def test_the_estimates_of_a_spool_that_dry_friction_slows_down_are_believed() -> None:
    """It moves a third as far as without friction: more than a stuck one, less than one that is freed."""
    noisy = Sensor(noise=0.03)
    simulator = Simulator(
        VALVE, SweptSine(start_frequency=18.0, stop_frequency=19.0, duration=40.0, amplitude=8.0), seed=5,
        coulomb_force=0.85, body_sensor=noisy, spool_sensor=noisy,
    )  # fmt: skip
    both = Replay(Estimator(settings_for(VALVE)), Monitor(MonitorSettings(natural_frequency=15.15)))
    for _ in range(20 * 50):
        both.update(simulator.next_block())
    assert both.monitor.detection.distrust == ""
    assert both.events == []


def at(second: float, drag: float, referred: float | None) -> Estimate:
    validity = Validity.UNKNOWN if referred is None else Validity.VALID
    quantity = Quantity("referred_viscous_coefficient", "N s/m", referred or 0.0, 0.001, validity)
    nothing = Quantity("", "1")
    return Estimate(
        stamp=round(second * 1e9),
        model="coulomb",
        state=State.TRACKING,
        last_sequence=0,
        samples=0,
        delay=0.375,
        memory=4.0,
        parameters=(
            Quantity("spring_stiffness", "N/m", 1632.0, 1.0, Validity.VALID),
            Quantity("viscous_coefficient", "N s/m", drag, 0.001, Validity.VALID),
            Quantity("coulomb_force", "N", 0.2, 0.001, Validity.VALID),
        ),
        natural_frequency=nothing,
        damping_ratio=nothing,
        residual=nothing,
        excitation=nothing,
        relative_displacement=nothing,
        referred_viscous_coefficient=quantity,
    )


def slow_wear(*, cooled: float, seconds: int, lasting: float = 300.0) -> list[Event]:
    """Return the events of a valve that loses 70 % of its drag in ``lasting`` s, from 1.5 ``cooled`` s on.

    Before its oil cools, which thickens it by a half, and the thermometer shows it without a lag.
    """
    monitor, draw = Monitor(MonitorSettings(natural_frequency=15.15)), np.random.default_rng(1)
    events = []
    for second in range(1, seconds):
        worn = min(1.0, max(0.0, second - 20.0 - 1.5 * cooled) / lasting)
        drag = 4.0 * (1.0 - 0.7 * worn) * (1.0 + 0.002 * draw.standard_normal())
        thicker = 1.0 + 0.5 * min(1.0, max(0.0, second - 20.0) / max(cooled, 1.0))
        events += monitor.update_estimate(at(second, (thicker if cooled else 1.0) * drag, drag))
    return events


def test_a_slow_wear_under_a_thermometer_that_follows_says_what_changed_and_when_it_is_an_alarm() -> None:
    events = slow_wear(cooled=400.0, seconds=840)
    warning, alarm = events
    assert [(event.kind, event.cause, event.severity) for event in events] == [
        ("friction_drift", "wear", Severity.WARNING),
        ("friction_drift", "wear", Severity.ALARM),
    ]
    left = (alarm.stamp - warning.stamp) * 1e-9
    assert warning.facts.time_to_limit == pytest.approx(left, rel=0.25)
    assert math.isnan(alarm.facts.time_to_limit)
    assert warning.facts.urgency is alarm.facts.urgency is Urgency.SOON
    assert alarm.facts.limit < warning.facts.limit
    for event in events:
        facts = event.facts
        assert (facts.parameter, facts.note) == ("viscous_coefficient", "oil_referred")
        assert facts.low < facts.value < facts.high < facts.baseline
        assert facts.value < facts.limit
        assert facts.change == pytest.approx(facts.value - facts.baseline)
        assert facts.false_alarm_interval == FALSE_ALARM_INTERVAL.default * 86400.0
        # The quantity is the same change, relative to the baseline.
        assert event.quantity.value == pytest.approx(facts.change / facts.baseline)


def test_a_slow_fall_is_oil_or_wear_until_no_thermometer_would_lag_by_so_long() -> None:
    events = slow_wear(cooled=0.0, seconds=900, lasting=600.0)
    assert [(event.cause, event.severity) for event in events] == [
        ("oil_or_wear", Severity.WARNING),
        ("wear", Severity.WARNING),
        ("wear", Severity.ALARM),
    ]
    assert events[0].facts.note == "oil_may_follow"
    began = events[0].facts.began
    assert events[1].stamp - began == pytest.approx(SLOWEST * 1e9, abs=5e9)


def detector() -> ParameterDrift:
    return ParameterDrift("viscous_coefficient", 0.2, True, Baseline(3.0))


def test_a_start_value_learned_at_one_temperature_is_compared_at_that_temperature_only() -> None:
    made = detector()
    for second in range(3):
        made.update(at(second, 2.0, 3.0))
    assert made.baseline.value == 3.0
    # The thermometer fails: the drag is judged as if the oil were as warm as it was last.
    for second in range(3, 30):
        made.update(at(second, 2.0, None))
        assert made.judged
        assert made.assumed
    assert made.change.value == pytest.approx(0.0)
    # A drag that changes no faster than the oil may warm is no drift.
    made.update(at(3600, 1.0, None))
    assert made.change.value == pytest.approx(0.0)
    made.update(at(3601, 1.0, 3.3))
    assert not made.incomparable
    assert made.latest_change.value == pytest.approx(0.1)


def test_a_restart_without_a_thermometer_compares_no_drag_with_a_referred_start_value() -> None:
    made = detector()
    for second in range(3):
        made.update(at(second, 2.0, 3.0))
    again = detector()
    again.baseline, again.referred = made.baseline, True
    again.update(at(3, 2.0, None))
    assert again.incomparable
    assert not again.judged


def test_a_temperature_that_joins_while_learning_begins_the_start_value_anew() -> None:
    made = detector()
    made.update(at(0, 2.0, None))
    made.update(at(1, 2.0, None))
    for second in range(2, 5):
        made.update(at(second, 2.0, 3.0))
    assert made.baseline.value == 3.0


def test_a_start_value_without_temperature_goes_on_without_it() -> None:
    made = detector()
    for second in range(3):
        made.update(at(second, 2.0, None))
    made.update(at(3, 2.2, 3.0))
    # Less what warming or cooling oil does in a second.
    assert made.change.value == pytest.approx(1.1 * math.exp(-FASTEST) - 1.0)


def test_without_a_thermometer_the_drag_is_judged_by_what_oil_cannot_do() -> None:
    """Dry friction is judged all the time: the message names what is judged of each parameter."""
    monitor = Monitor(MonitorSettings(natural_frequency=15.15, baseline_time=3.0))
    monitor.gate.accepted, seen = 1, {}
    for second in (*range(1, 10), *range(600, 610), *range(3600, 3610)):
        monitor.update_estimate(at(second, 2.0, None))
        seen[second] = dict(monitor.health.judgements), monitor.health.summary
    for second in (9, 609, 3609):
        judgements, summary = seen[second]
        assert judgements["friction_drift/viscous_coefficient"] is Judgement.JUDGED
        assert judgements["friction_drift/coulomb_force"] is Judgement.JUDGED
        assert judgements["spring_change/spring_stiffness"] is Judgement.JUDGED
        assert summary == (
            "tracking, baseline learned; drag judged with a wider limit: the oil temperature is unknown"
        )


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_thermometer_that_stands_still_while_the_drag_falls_by_half_is_named(noise: float) -> None:
    monitor, draw, events = Monitor(MonitorSettings(natural_frequency=15.15)), np.random.default_rng(1), []
    for second in range(1, 200):
        drag = 4.0 if second < 100 else 2.0
        shown = 20.0 + noise * draw.standard_normal()
        celsius = Quantity("oil_temperature", "deg C", shown, 0.3, Validity.VALID)
        events += monitor.update_estimate(replace(at(second, drag, drag), oil_temperature=celsius))
    facts = events[-1].facts
    shares = dict(zip(facts.causes, facts.probabilities, strict=True))
    assert facts.note == ("oil_referred" if noise else "oil_temperature_frozen")
    assert shares["wear"] == pytest.approx(0.75 if noise else 0.5)


def mornings(seed: int, *, told: bool, wears: bool) -> list[tuple[float, Event]]:
    """Return the events of cold starts of a tank with a heat balance, and their h since the wear begins.

    A valve that ``wears`` loses a quarter of its drag in a minute of the third of four cold starts.
    Losses of the pump come and go, a cooler opens at 48 deg C: no oil warms by an exponential. The
    thermometer (``told``) has two lags: its corner of the tank, and its sleeve. The oil is ISO VG 46 by ASTM
    D341 (46 mm^2/s at 40 deg C, 6.8 at 100).
    """
    draw = np.random.default_rng(seed)
    thick, thin = (math.log10(math.log10(viscosity + 0.7)) for viscosity in (46.0, 6.8))
    slope = (thick - thin) / math.log10(313.15 / 373.15)

    def thickness(celsius: float) -> float:
        return float(10.0**10.0 ** (thick + slope * math.log10((celsius + 273.15) / 313.15)))

    litres, corner, sleeve = draw.uniform(60.0, 200.0), draw.uniform(20.0, 240.0), draw.uniform(10.0, 120.0)
    room, oil = draw.uniform(12.0, 22.0), 47.0
    near = shown = oil
    monitor, events, stamp, wear = Monitor(MonitorSettings(natural_frequency=15.15)), [], 0.0, math.inf
    for morning in range(5):
        changes = losses = 0.0
        for second in range(0, 5400 if morning else 600, 2):
            stamp += 2.0
            if second >= changes:  # W, as machining and waiting take turns
                losses = draw.choice([0.15, 0.6, 1.0]) * 50.0 * litres
                changes = second + draw.uniform(60.0, 900.0)
            cools = (6.0 + (2.0 * litres if oil > 48.0 else 0.0)) * (oil - room)
            oil += 2.0 * (losses - cools) / (0.87 * 1900.0 * litres) if morning else 0.0
            near += 2.0 * (oil - near) / corner
            shown += 2.0 * (near - shown) / sleeve
            wear = stamp if (morning, second) == (3, 3000) else wear
            worn = 0.25 * min(1.0, max(0.0, stamp - wear) / 60.0) if wears else 0.0
            drag = 4.0 * thickness(oil) / thickness(47.0) * (1.0 - worn) * draw.normal(1.0, 0.003)
            estimate = at(stamp, drag, drag * thickness(40.0) / thickness(shown) if told else None)
            celsius = Quantity("oil_temperature", "deg C", shown, 0.3, Validity.VALID)
            estimate = replace(estimate, oil_temperature=celsius) if told else estimate
            events += [((stamp - wear) / 3600.0, one) for one in monitor.update_estimate(estimate)]
        stamp += 3600.0 * draw.uniform(8.0, 14.0)
        oil = near = shown = room + draw.normal(0.0, 1.0)
    return events


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("wears", [pytest.param(False, marks=pytest.mark.slow), True])
def test_oil_that_warms_by_a_heat_balance_is_no_wear_and_wear_is_found_within_a_day(
    *, told: bool, wears: bool
) -> None:
    events = mornings(100, told=told, wears=wears)
    assert {(event.kind, 0.0 < hour < 24.0) for hour, event in events} == (
        {("friction_drift", True)} if wears else set()
    )
    assert {event.cause for _, event in events} <= {"wear", "oil_or_wear"}
    if told and wears:
        assert events[0][0] < 0.05
        assert events[-1][1].cause == "wear"
