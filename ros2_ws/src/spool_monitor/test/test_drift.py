from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State
from spool_monitor.detection import Detection
from spool_monitor.detectors import MonitorSettings
from spool_monitor.drift_trace import DriftTrace
from spool_monitor.event import Severity
from spool_monitor.monitor import Monitor
from spool_monitor.parameter_drift import SMOOTHING, TESTS, ParameterDrift
from spool_monitor.state_file import Baseline, HealthyValue
from spool_monitor.warming import PROMPT, SLOWEST, TO, ThermometerLag

SECOND = 1_000_000_000


def estimate(
    seconds: float,
    value: float,
    deviation: float = 0.001,
    state: State = State.TRACKING,
    validity: Validity = Validity.VALID,
    celsius: float = 20.0,
) -> Estimate:
    """Return an estimate of a valve whose oil stays at its reference temperature; NaN: no thermometer."""
    nothing = Quantity("", "1")
    measured = Validity.VALID if math.isfinite(celsius) else Validity.UNKNOWN
    oil = Quantity("oil_temperature", "deg C", celsius, 0.5, measured)
    referred = Quantity("referred_viscous_coefficient", "N s/m", value, deviation, validity)
    return Estimate(
        stamp=round(seconds * SECOND),
        model="coulomb",
        state=state,
        last_sequence=0,
        samples=0,
        delay=0.375,
        memory=4.0,
        parameters=(Quantity("viscous_coefficient", "N s/m", value, deviation, validity),),
        natural_frequency=nothing,
        damping_ratio=nothing,
        residual=nothing,
        excitation=nothing,
        relative_displacement=nothing,
        oil_temperature=oil,
        **({"referred_viscous_coefficient": referred} if oil.known else {}),
    )


def learned(*, relative: bool = True, values: tuple[float, ...] = (2.0, 2.0, 2.0)) -> ParameterDrift:
    """Return a test of a change of 0.2 that has learned its start value."""
    made = ParameterDrift("viscous_coefficient", 0.2, relative, Baseline(float(len(values))))
    for second, value in enumerate(values):
        made.update(estimate(second, value))
    assert made.baseline.frozen
    return made


def found_after(made: ParameterDrift, values: list[float], deviation: float = 0.001) -> float:
    """Return the s after which ``values``, one a second, are reported as a change; infinite for never."""
    for second, value in enumerate(values, 10):
        made.update(estimate(second, value, deviation))
        if made.level is not None:
            return second - 10.0
    return math.inf


# Baseline.


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=40))
def test_the_baseline_is_the_median_of_the_first_and_then_fixed(values: list[float]) -> None:
    baseline = Baseline(float(len(values)))
    for second, value in enumerate(values[:-1]):
        baseline.learn(second * SECOND, value)
        assert not baseline.frozen
        assert math.isnan(baseline.value)
        assert math.isnan(baseline.spread)
    baseline.learn(len(values) * SECOND, values[-1])
    assert baseline.frozen
    assert baseline.value == np.median(values)
    before = (baseline.value, baseline.spread)
    baseline.learn(10**6 * SECOND, 1e9)
    assert (baseline.value, baseline.spread) == before


def test_the_spread_is_the_standard_deviation_and_one_outlier_does_not_count() -> None:
    values = np.random.default_rng(3).normal(5.0, 0.2, 2001)
    baseline = Baseline(2001.0)
    for second, value in enumerate([*values[:-1], 1e6]):
        baseline.learn(second * SECOND, float(value))
    assert baseline.value == pytest.approx(5.0, abs=0.02)
    assert baseline.spread == pytest.approx(0.2, rel=0.06)


@pytest.mark.parametrize(
    ("duration", "period", "count"),
    [(15.0, 1.0, 15), (15.0, 0.1, 150), (15.0, 0.2, 75), (15.0, 60.0, 3), (3.0, 1.0, 3)],
)
def test_the_time_of_the_baseline_is_time_whatever_the_period(
    duration: float, period: float, count: int
) -> None:
    generator = np.random.default_rng(1)
    baseline = Baseline(duration)
    taken = 0
    while not baseline.frozen:
        # Stamps that jitter by a thousandth of the period.
        baseline.learn(round((taken + 1e-3 * generator.uniform()) * period * SECOND), 1.0)
        taken += 1
    assert taken == count


def test_a_standstill_does_not_count_as_time_of_the_baseline() -> None:
    baseline = Baseline(6.0)
    for second in (0, 1, 2, 600, 601):
        baseline.learn(second * SECOND, 1.0)
    assert not baseline.frozen
    baseline.learn(602 * SECOND, 1.0)
    assert baseline.frozen


def test_stamps_that_repeat_or_go_back_do_not_keep_it_from_ending() -> None:
    baseline = Baseline(3.0)
    taken = 0
    for stamp in [
        5 * SECOND,
        5 * SECOND,
        5 * SECOND + 1,
        4 * SECOND,
        *range(6 * SECOND, 99 * SECOND, SECOND),
    ]:
        baseline.learn(stamp, 1.0)
        taken += not baseline.frozen
    assert taken == 29  # 1 ns counts as the shortest period there is, 0.1 s


# The sequential test.


@pytest.mark.parametrize(
    ("state", "validity"),
    [
        (State.LEARNING, Validity.VALID),
        (State.NOT_EXCITED, Validity.HELD),
        (State.NOT_EXCITED, Validity.VALID),
        (State.STALE, Validity.HELD),
        (State.TRACKING, Validity.IMPLAUSIBLE),
        (State.TRACKING, Validity.UNKNOWN),
    ],
)
def test_only_valid_tracked_values_are_learned_and_judged(state: State, validity: Validity) -> None:
    learning = ParameterDrift("viscous_coefficient", 0.2, True, Baseline(3.0))
    frozen = learned()
    for second in range(10, 40):
        off = estimate(second, 50.0, state=state, validity=validity)
        learning.update(off)
        frozen.update(off)
    assert not learning.baseline.frozen
    assert not frozen.judged
    assert frozen.level is None
    assert math.isnan(frozen.change.value)


@pytest.mark.parametrize(
    ("change", "level"),
    [
        (0.05, None),
        (-0.05, None),
        (0.12, Severity.WARNING),
        (-0.12, Severity.WARNING),
        (0.2, Severity.WARNING),
        (-0.2, Severity.WARNING),
        (0.41, Severity.ALARM),
        (-0.41, Severity.ALARM),
    ],
)
def test_a_change_beyond_the_limit_is_found_within_ten_seconds_and_a_smaller_one_never(
    change: float, level: Severity | None
) -> None:
    made = learned()
    after = found_after(made, [2.0 * (1.0 + change)] * 300)
    for second in range(310, 330):
        made.update(estimate(second, 2.0 * (1.0 + change)))
    assert made.level is level
    assert after < 10.0 if level else math.isinf(after)


@pytest.mark.parametrize("period", [1, 5, 30])
def test_a_change_is_found_however_seldom_estimates_come(period: int) -> None:
    made = ParameterDrift("viscous_coefficient", 0.2, True, Baseline(15.0))
    for number in range(20):
        made.update(estimate(number * period, 2.0))
    assert made.baseline.frozen
    for number in range(20, 40):
        made.update(estimate(number * period, 1.0))
    assert made.level is not None


@given(start=st.floats(20.0, 200.0), slope=st.floats(0.0005, 0.02))
def test_a_slow_ramp_is_found_once_it_is_as_large_as_it_must_be(start: float, slope: float) -> None:
    made = learned()
    ramp = [2.0 * (1.0 - max(0.0, second - start) * slope) for second in range(700)]
    ramp = [value for value in ramp if value > 1.0]
    reached = start + 0.2 / slope
    assert start <= found_after(made, ramp) <= reached + 10.0


def unmeasured(
    ratios: list[float], made: ParameterDrift | None = None, first: float = 10.0
) -> ParameterDrift:
    """Return a test that takes drags over the start value, one a second, without a thermometer."""
    if made is None:
        made = ParameterDrift("viscous_coefficient", 0.2, True, Baseline(3.0))
        ratios = [1.0] * 30 + ratios
    for second, ratio in enumerate(ratios):
        made.update(estimate(first + second, 2.0 * ratio, celsius=math.nan))
    return made


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0])
def test_oil_that_warms_without_a_thermometer_is_no_drift_and_wear_faster_than_oil_is(rate: float) -> None:
    warms = [math.exp(-0.06 * rate / 60.0 * second) for second in range(600)]
    made = unmeasured(warms)
    assert made.level is None
    assert abs(made.share) < 0.5
    unmeasured([0.7 * warms[-1]] * 20, made, 650.0)
    assert made.level is not None
    assert not made.doubtful


def test_wear_is_found_by_the_cold_start_after_it_and_known_after_three() -> None:
    """On each day oil that warms takes half of the drag; on the first evening wear has taken 30 %."""
    day, night = [math.exp(-0.001 * second) for second in range(700)], 12.0 * 3600.0
    made = unmeasured([*day, *(day[-1] * (1.0 - 0.0003 * second) for second in range(1000))])
    assert made.level is None
    known = []
    for number in range(3):
        unmeasured([0.7 * one for one in day], made, 2000.0 + (number + 1) * (night + 700.0))
        assert made.level is not None
        known.append(not made.doubtful)
    assert known == [False, False, True]


def test_a_drag_that_comes_back_after_a_cold_start_takes_the_warning_back() -> None:
    made = unmeasured([1.0] * 30)
    unmeasured([0.6] * 60, made, 14.0 * 3600.0)
    assert made.level is not None
    assert made.doubtful
    unmeasured([1.0] * 60, made, 38.0 * 3600.0)
    assert made.level is None


@pytest.mark.parametrize("lag", [30.0, 120.0, 400.0])
def test_the_lag_of_a_thermometer_is_estimated_from_the_drag(lag: float) -> None:
    """Oil warms for half an hour and stays; the thermometer follows it as a first-order lag."""
    found, draw, shown = ThermometerLag(), np.random.default_rng(4), 0.0
    assert found.most == SLOWEST
    for second in range(5400):
        oil = -0.001 * min(second, 1800)
        shown += (oil - shown) / lag
        found.follow(second * SECOND, shown)
        found.learn(oil - shown + 0.01 * draw.standard_normal(), 4.0)
        # Before it is known no lag explains less than there is.
        assert found.unknown > 0.6 * (shown - oil) - 0.02
    # One that is prompt need not be known better.
    assert lag < found.most < max(1.3 * lag + 2.0 * TO, PROMPT)


@pytest.mark.parametrize(
    ("learned_at", "celsius", "known"),
    [
        pytest.param(math.nan, math.nan, False, id="never measured"),
        pytest.param(20.0, math.nan, False, id="no longer measured"),
        pytest.param(math.nan, 20.0, False, id="measured since"),
        pytest.param(45.0, 20.0, False, id="colder than before"),
        pytest.param(20.0, 20.0, True, id="as warm as before"),
    ],
)
def test_after_a_restart_oil_that_was_not_measured_may_have_any_temperature(
    learned_at: float, celsius: float, known: bool
) -> None:
    """Oil that is 25 K colder drags more than twice as much: that is no drift of a valve."""
    made = ParameterDrift("viscous_coefficient", 0.2, True, Baseline(15.0))
    made.baseline.restore(HealthyValue("viscous_coefficient", "N s/m", 2.0, 0.01, 2.0, 0.01, 15))
    made.temperature = learned_at
    for second in range(10, 310):
        made.update(estimate(second, 4.4, celsius=celsius))
    assert (made.level is not None) is known


def test_after_a_clock_was_set_back_oil_that_nobody_measures_may_have_any_temperature() -> None:
    """Nobody knows how long ago the start value was learned: warm oil must not look like wear."""
    made = ParameterDrift("viscous_coefficient", 0.2, True, Baseline(3.0))
    for second in range(3600, 3603):
        made.update(estimate(second, 2.0, celsius=math.nan))
    for second in range(60):
        made.update(estimate(second, 0.8, celsius=math.nan))
    assert made.judged
    assert made.level is None


def test_far_from_the_temperature_of_its_baseline_the_limit_is_wider() -> None:
    made = learned()
    limits = []
    for second in range(10, 1000):
        made.update(estimate(second, 2.0, celsius=20.0 if second < 300 else 50.0))
        limits.append(made.sum.allowance)
    # 0.1 % per K is an error of 3 % on top of 1.9 % of the estimate.
    assert limits[-1] / limits[100] == pytest.approx(math.hypot(3.0, 1.92) / 1.92, rel=0.02)


def test_all_parameters_that_are_tested_share_the_interval() -> None:
    assert len(Monitor(MonitorSettings(natural_frequency=15.0)).detection.parameters) == TESTS


@pytest.mark.parametrize("days", [1.0, 365.0, 36_500.0])
def test_the_limit_follows_from_the_interval_between_false_alarms(days: float) -> None:
    made = learned()
    made.run_length = days * 86_400.0
    made.update(estimate(10, 2.0))
    # Twice the tail of a normal number, drawn again for each ten minutes at one operating point, of each of
    # three parameters.
    sigma = 1.92e-2 / 0.2
    exceeds = math.erfc(made.sum.allowance / sigma / math.sqrt(2.0))
    assert 3.0 * exceeds * days * 144.0 == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("relative", [True, False])
def test_a_change_is_reported_beyond_the_bounds_that_are_shown(relative: bool) -> None:
    made = learned(relative=relative)
    assert all(math.isnan(one) for one in made.bounds)
    made.update(estimate(5.0, 2.0))
    low, high = made.bounds
    for bound, further in ((low, -0.06), (high, 0.06)):  # the limit grows with the drag
        assert math.isfinite(found_after(learned(relative=relative), [bound + further] * 60))
        assert not math.isfinite(found_after(learned(relative=relative), [bound - further] * 60))


@pytest.mark.parametrize("slope", [0.0005, 0.002, 0.005])
def test_a_slow_drift_began_before_half_of_the_limit_was_passed(slope: float) -> None:
    made = learned()
    found = found_after(made, [2.0 * (1.0 - max(0, second - 100) * slope) for second in range(700)])
    half = 0.5 * made.sum.allowance * made.matters / slope
    assert 110.0 <= 1e-9 * made.since <= 110.0 + half + SMOOTHING
    assert found > 100.0 + 2.0 * half


def test_a_drift_that_rests_for_some_seconds_began_before_it_rested() -> None:
    made = learned()
    for second, value in enumerate([2.0] * 100 + [1.4] * 20 + [2.0] * 8 + [1.4] * 5, 10):
        made.update(estimate(second, value))
    assert made.level is not None
    assert made.since == pytest.approx(109 * SECOND, abs=2 * SECOND)


@pytest.mark.parametrize("period", [1.0, 0.1])
def test_since_when_is_known_from_the_first_sign_of_a_change_until_the_last(period: float) -> None:
    """The smoothed change comes later than the sum and is over sooner."""
    made, seconds, dated = learned(), 10.0, set[int]()
    for value, lasts in ((2.0, 10.0), (1.4, 20.0), (2.0, 20.0)):
        for _ in range(round(lasts / period)):
            made.update(estimate(seconds, value))
            seconds += period
            assert (made.since > 0) == (made.sum.size > 0.0)
            dated.add(made.since)
    assert made.since == 0
    assert len(dated) == 2


@pytest.mark.parametrize("pause", [10.0, 3600.0, 86400.0, -1.0, -3600.0, -86400.0])
def test_neither_a_pause_nor_a_clock_that_was_set_back_is_time_of_a_drift(pause: float) -> None:
    """One estimate after it shows nothing that lasts; those that follow do."""
    made = learned()
    found_after(made, [2.0] * 10)
    made.update(estimate(19.0 + pause, 2.5))
    assert made.judged
    assert (made.level, made.sum.size, made.change.value) == (None, 0.0, 0.0)
    for second in range(1, 10):
        made.update(estimate(19.0 + pause + second, 2.5))
    assert made.level is not None
    assert 1e-9 * made.since == pytest.approx(19.0 + pause, abs=1.0)


def test_a_change_that_was_reported_before_a_pause_is_still_there_after_it() -> None:
    made = learned()
    assert math.isfinite(found_after(made, [1.4] * 30))
    made.update(estimate(3600.0, 1.4))
    assert made.level is Severity.WARNING
    assert not made.released


def test_one_wild_estimate_is_no_change() -> None:
    assert math.isinf(found_after(learned(), [2.0] * 20 + [9.0] + [2.0] * 100))


@pytest.mark.parametrize(("deviation", "found"), [(0.15, False), (0.11, True), (0.02, True)])
def test_what_is_too_uncertain_is_not_judged(deviation: float, found: bool) -> None:
    """0.2 of 2.0 must be found: an estimate is believed up to 35 % of that, a larger change found by it."""
    assert math.isfinite(found_after(learned(), [1.4] * 50, deviation)) is found


@pytest.mark.parametrize(("relative", "size"), [(True, 0.4), (False, 0.2)])
def test_a_trace_shows_the_change_that_matters_in_the_parameters_unit(relative: bool, size: float) -> None:
    trace = DriftTrace()
    trace.take(estimate(9.0, 2.0), {"viscous_coefficient": learned(relative=relative)})
    (point,) = trace.points["viscous_coefficient"]
    assert point.matters == pytest.approx(size)


def test_a_restless_baseline_takes_longer_to_alarm() -> None:
    calm, restless = learned(), learned(values=(1.85, 2.15, 2.0, 1.85, 2.15))
    assert restless.baseline.spread > 0.1
    assert found_after(calm, [1.5] * 300) < found_after(restless, [1.1] * 300)


@pytest.mark.parametrize("changed", [1.0, 3.0])
def test_a_change_that_is_undone_is_over_soon(changed: float) -> None:
    """After an hour of it; another one that follows is dated from its own beginning."""
    made = learned()
    for second in range(10, 3000, 10):
        made.update(estimate(second, changed))
    assert made.level is Severity.ALARM
    for second in range(3000, 3015):
        made.update(estimate(second, 2.0))
    assert made.released
    assert made.level is None
    for second in range(3015, 3025):
        made.update(estimate(second, changed))
    assert made.level is Severity.ALARM
    assert made.since >= 3010 * SECOND


def test_what_is_distrusted_neither_raises_nor_releases() -> None:
    made = learned()
    for second in range(10, 60):
        made.update(estimate(second, 1.0), distrust=True)
    assert (made.level, made.released, made.judged) == (None, False, False)


def test_what_came_before_a_distrusted_estimate_is_forgotten() -> None:
    made = learned()
    assert math.isfinite(found_after(made, [1.4] * 20))
    made.update(estimate(30, 1.4), distrust=True)
    assert made.level is None
    for second in range(31, 41):
        made.update(estimate(second, 1.4))
    assert made.level is not None
    assert made.since >= 30 * SECOND
    made.update(estimate(41, 1.4), distrust=True)
    made.update(estimate(42, 2.0))
    assert (made.change.value, made.released, made.since) == (0.0, True, 0)


def test_an_absolute_change_is_in_the_parameters_unit() -> None:
    made = learned(relative=False)
    assert math.isfinite(found_after(made, [2.3] * 60))
    assert (made.change.unit, made.change.value) == ("N s/m", pytest.approx(0.3, abs=0.01))


def with_spring(second: float, stiffness: float, dry: float) -> Estimate:
    """Return an estimate of a spool of 0.18 kg, shaken with 5 m/s^2; ``dry``: its friction, N."""
    drag = estimate(second, 10.0)
    spring = Quantity("spring_stiffness", "N/m", stiffness, 1.0, Validity.VALID)
    friction = Quantity("coulomb_force", "N", dry, 0.001, Validity.VALID)
    natural = math.sqrt(stiffness / 0.18) / (2.0 * math.pi)
    return replace(
        drag,
        parameters=(*drag.parameters, spring, friction),
        natural_frequency=Quantity("natural_frequency", "Hz", natural, 0.01, Validity.VALID),
        excitation=Quantity("excitation", "m/s^2", 5.0, 0.01, Validity.VALID),
    )


@pytest.mark.parametrize(
    ("stiffness", "dry", "softer"),
    [(0.88, 0.0, True), (0.88, 0.2, False), (0.88, -0.2, True), (0.96, -0.2, False)],
)
def test_a_spring_that_seems_softer_by_what_growing_dry_friction_feigns_is_not_reported(
    stiffness: float, dry: float, softer: bool
) -> None:
    """Friction (N) that holds the spool more of the time looks the same; less of it explains nothing."""
    detection = Detection(MonitorSettings(natural_frequency=15.0))
    for second in range(100):
        share = min(1.0, max(0.0, (second - 20.0) / 50.0))
        one = with_spring(second, 1600.0 * (1.0 + share * (stiffness - 1.0)), 0.25 + share * dry)
        detection.update_estimate(one, 15.0)
    assert detection.parameters["spring_stiffness"].judged
    assert (detection.parameters["spring_stiffness"].level is not None) is softer


def test_a_spool_that_sticks_most_of_the_time_shows_nothing_of_its_spring() -> None:
    detection = Detection(MonitorSettings(natural_frequency=15.0))
    spring = detection.parameters["spring_stiffness"]
    for second in range(60):
        stuck = second >= 20
        detection.update_estimate(
            with_spring(second, 800.0 if stuck else 1600.0, 0.6 if stuck else 0.4), 15.0
        )
        assert spring.judged is (15 <= second < 20)
    assert spring.level is None


def test_a_model_without_the_parameter_is_refused_by_name() -> None:
    made = ParameterDrift("colour", 0.1, True, Baseline(3.0))
    with pytest.raises(KeyError, match="colour"):
        made.update(estimate(0, 1.0))
