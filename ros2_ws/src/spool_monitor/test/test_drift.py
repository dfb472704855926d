from __future__ import annotations

import math
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_estimator.estimate import Estimate, State
from spool_monitor.drift import SIGNIFICANCE, Baseline, DriftDetector
from spool_monitor.event import Event, EventState, Severity
from spool_stream.quantity import Quantity, Validity

SECOND = 1_000_000_000


def estimate(
    seconds: float,
    value: float,
    deviation: float = 0.001,
    state: State = State.TRACKING,
    validity: Validity = Validity.VALID,
) -> Estimate:
    nothing = Quantity("", "1")
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
    )


def detector(*, relative: bool = True, learn: float | None = 2.0) -> DriftDetector:
    """Return a detector that warns from 0.2 on; ``learn``: a start value it has learned already."""
    made = DriftDetector(
        "viscous_coefficient", "friction_drift", 0.2, 0.4, relative, ("wear", "oil_viscosity"), Baseline(3.0)
    )
    if learn is not None:
        for second in range(3):
            assert made.update(estimate(second, learn)) == []
        assert made.baseline.frozen
    return made


def drive(made: DriftDetector, values: list[float], deviation: float = 0.001) -> list[tuple[int, Event]]:
    found = []
    for second, value in zip(count(10), values):
        found += [(second, event) for event in made.update(estimate(second, value, deviation))]
    return found


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


# Detector.


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
    learning, frozen = detector(learn=None), detector()
    for second in range(10, 20):
        off = estimate(second, 50.0, state=state, validity=validity)
        assert learning.update(off) == []
        assert frozen.update(off) == []
    assert not learning.baseline.frozen
    assert math.isnan(learning.change.value)
    assert math.isnan(frozen.change.value)
    for second in range(20, 23):
        learning.update(estimate(second, 2.0))
    assert learning.baseline.value == 2.0


def test_nothing_is_judged_while_the_baseline_is_learned() -> None:
    made = detector(learn=None)
    assert drive(made, [1.0, 100.0, 1.0]) == []
    assert made.baseline.value == 1.0


@pytest.mark.parametrize(
    ("value", "severity", "cause"),
    [
        (1.61, None, ""),
        (1.59, Severity.WARNING, "wear"),
        (1.19, Severity.ALARM, "wear"),
        (2.39, None, ""),
        (2.41, Severity.WARNING, "oil_viscosity"),
        (2.81, Severity.ALARM, "oil_viscosity"),
    ],
)
def test_thresholds_and_causes(value: float, severity: Severity | None, cause: str) -> None:
    found = drive(detector(), [value] * 5)
    if severity is None:
        assert found == []
        return
    ((second, event),) = found
    assert second == 12  # two seconds' delay
    assert (event.kind, event.state, event.severity, event.cause) == (
        "friction_drift",
        EventState.RAISED,
        severity,
        cause,
    )
    assert event.quantity.value == pytest.approx(value / 2.0 - 1.0)
    assert event.quantity.unit == "1"
    assert f"{value:.4g} N s/m, was 2" in event.message


def test_an_absolute_change_is_in_the_parameters_unit() -> None:
    ((_, event),) = drive(detector(relative=False, learn=0.0), [0.3] * 4)
    assert (event.quantity.unit, event.quantity.value) == ("N s/m", pytest.approx(0.3))


@pytest.mark.parametrize(("factor", "raised"), [(1.01, False), (0.99, True)])
def test_a_change_within_the_uncertainty_is_not_judged(factor: float, raised: bool) -> None:
    """A change of 0.5 (relative) is judged once its standard deviation is below a quarter of it."""
    deviation = factor * 0.5 / SIGNIFICANCE * 2.0
    assert bool(drive(detector(), [3.0] * 6, deviation)) is raised


def test_the_spread_of_the_baseline_counts_as_uncertainty() -> None:
    made = detector(learn=None)
    for second, value in enumerate((1.0, 2.0, 3.0)):
        made.update(estimate(second, value))
    assert made.baseline.spread > 1.0
    assert drive(made, [4.0] * 6) == []
    assert made.change.value == pytest.approx(1.0)
    assert made.change.standard_deviation == pytest.approx(made.baseline.spread / 2.0, rel=1e-3)


def test_it_clears_below_the_deadband_and_not_before() -> None:
    # 0.25 raises at 20 %; 0.15 lies above the deadband of 14 %, 0.13 below it.
    found = drive(detector(), [2.5] * 4 + [2.3] * 10 + [2.26] * 5)
    assert [(second, event.state) for second, event in found] == [
        (12, EventState.RAISED),
        (27, EventState.CLEARED),
    ]
    assert found[1][1].cause == "oil_viscosity"


def test_a_drift_that_grows_is_reported_twice_and_ends_once() -> None:
    found = drive(detector(), [1.5] * 4 + [1.0] * 4 + [2.0] * 5)
    assert [(event.state, event.severity) for _, event in found] == [
        (EventState.RAISED, Severity.WARNING),
        (EventState.RAISED, Severity.ALARM),
        (EventState.CLEARED, Severity.ALARM),
    ]


def test_a_standstill_keeps_the_event() -> None:
    made = detector()
    drive(made, [1.5] * 4)
    held = replace(estimate(60, 2.0, validity=Validity.HELD), state=State.NOT_EXCITED)
    assert made.update(held) == []
    assert made.condition.active is Severity.WARNING


def test_a_model_without_the_parameter_is_refused_by_name() -> None:
    made = DriftDetector("colour", "friction_drift", 0.1, 0.2, True, ("a", "b"), Baseline(3.0))
    with pytest.raises(KeyError, match="colour"):
        made.update(estimate(0, 1.0))
