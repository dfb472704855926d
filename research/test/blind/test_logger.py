"""Filters of loggers: what they make of jumps and of slow motions, and how often each is drawn."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from spool_blind.field.case import MeasuringChain, accepted_verdicts, make_field
from spool_blind.field.hiding import HiddenPhysics
from spool_blind.field.logged import LOGGED, make_logged
from spool_blind.field.logger import FAMILIES, POINTS, LoggerFilter, draw_filters
from spool_blind.simulator import Plant, SpoolMotion
from spool_evaluation.studies.estimation import judge_logged

RATE = 1000.0
H = 1.0 / (RATE * POINTS)
TIME = (np.arange(round(0.5 / H)) + 0.5) * H
SAMPLES = np.arange(100, 400) / RATE


def moving(row):
    """Return a motion that both channels share."""
    return SpoolMotion(TIME, H, row, row, np.zeros(TIME.size))


def chain(**filters):
    return MeasuringChain(1.0, 0.0, 0.0, filters, {"body": 0.0, "spool": 0.0}, (), 0)


def step_answer(order, corner, t, *, both):
    """Return Butterworth's answer to a step at 0 from its poles; ``both``: forward and back."""
    places = np.arange(1, 2 * order, 2) / (2.0 * order)
    poles = 2.0 * np.pi * corner * np.exp(1j * np.pi * (0.5 + places))
    whole, value = np.prod(-poles), np.ones(t.size, dtype=complex)
    for pole in poles:
        share = whole / np.prod(pole - poles[poles != pole]) / pole
        back = whole / np.prod(-pole - poles) if both else 1.0
        value += share * back * np.exp(pole * np.abs(t))
    after = value.real
    return np.where(t >= 0.0, after, 1.0 - after if both else 0.0)


@pytest.mark.parametrize("place", [0.2004, 0.25001, 0.2507])
@pytest.mark.parametrize(
    ("kind", "order", "corner", "closed"),
    [
        ("none", 0, 0.0, lambda t, *_: np.where(t >= 0.0, 1.0, 0.0)),
        ("mean", 0, 0.0, lambda t, *_: np.clip(t * RATE + 0.5, 0.0, 1.0)),
        ("linear_phase", 3, 360.0, lambda t, n, f: step_answer(n, f, t, both=True)),
        ("linear_phase", 8, 450.0, lambda t, n, f: step_answer(n, f, t, both=True)),
        ("causal", 2, 410.0, lambda t, n, f: step_answer(n, f, t, both=False)),
        ("causal", 7, 290.0, lambda t, n, f: step_answer(n, f, t, both=False)),
    ],
)
def test_a_jump_is_read_as_the_closed_form_of_the_filter_says(kind, order, corner, closed, place):
    # Means over the steps: the jump lies inside one.
    jump = np.clip((TIME - place) / H + 0.5, 0.0, 1.0)
    family = "butterworth" if order else ""
    found = LoggerFilter(RATE, kind, family, order, corner).read(2.5 * jump, moving(jump), SAMPLES)
    assert found == pytest.approx(2.5 * closed(SAMPLES - place, order, corner), abs=2.5e-3)


@pytest.mark.parametrize(
    ("kind", "family"), [(kind, family) for kind in FAMILIES for family in FAMILIES[kind]]
)
def test_half_the_power_passes_at_the_corner_and_half_the_amplitude_with_linear_phase(kind, family):
    one = LoggerFilter(RATE, kind, family, 8, 0.41 * RATE)
    wave = np.sin(2.0 * np.pi * one.corner * TIME)
    found = one.read(wave, moving(wave), SAMPLES[0] + np.arange(4000) * 5e-5)
    share = 0.5 if kind == "linear_phase" else np.sqrt(0.5)
    assert np.sqrt(2.0) * found.std() == pytest.approx(share, rel=0.01)


def test_slow_motions_have_a_delay_between_channels_only_where_their_filters_differ():
    slow, fast = (LoggerFilter(RATE, "causal", "butterworth", n, 0.3 * RATE) for n in (8, 2))
    motion = moving(np.sin(2.0 * np.pi * 10.0 * TIME))
    alike, apart = chain(body=slow, spool=slow), chain(body=fast, spool=slow)
    body, spool = (alike.quiet(name, motion, SAMPLES) for name in ("body", "spool"))
    assert np.array_equal(body, spool)
    for name, one in (("body", fast), ("spool", slow)):
        late = np.sin(2.0 * np.pi * 10.0 * (SAMPLES - one.delay))
        assert apart.quiet(name, motion, SAMPLES) == pytest.approx(late, abs=1e-3)
    # 2.7 ms and 0.75 ms: more than a data sheet allows, so that a delay may be named.
    nothing = HiddenPhysics("none", {}, 1.0)
    assert set(accepted_verdicts(nothing, {}, set(), (apart,))) == {"none", "spool_delay"}
    assert accepted_verdicts(nothing, {}, set(), (alike,)) == ("none",)


def test_nine_in_ten_loggers_filter_and_a_quarter_of_those_each_channel_apart():
    drawn = [draw_filters(np.random.default_rng([seed, 1]), RATE) for seed in range(4000)]
    kinds = Counter(one["body"].kind for one in drawn)
    shares = {name: kinds[name] / len(drawn) for name in kinds}
    expected = {"linear_phase": 0.5, "causal": 0.3, "mean": 0.1, "none": 0.1}
    assert shares == pytest.approx(expected, abs=0.03)
    apart = [one for one in drawn if one["body"] != one["spool"]]
    assert len(apart) / (len(drawn) - kinds["none"]) == pytest.approx(0.25, abs=0.03)
    assert all(one["body"].kind == one["spool"].kind for one in apart)
    families = Counter(one["body"].family for one in drawn if one["body"].kind == "linear_phase")
    assert families["butterworth"] / kinds["linear_phase"] == pytest.approx(0.8, abs=0.03)
    equal = [draw_filters(np.random.default_rng([seed, 1]), RATE, alike=True) for seed in range(400)]
    assert all(one["body"] == one["spool"] for one in equal)


def test_a_field_record_lags_its_motion_by_what_its_truth_says_of_the_filter():
    case = make_field(19, "none", ())
    told = case.told()["observation"]["body"]
    motion = case.condition.move(Plant(case.plant))
    ideal = np.interp(case.time, motion.time, motion.body)
    slope = np.gradient(ideal, case.time)
    lag = -np.dot(case.body - ideal, slope) / np.dot(slope, slope)
    assert told["kind"] == "causal"
    assert lag == pytest.approx(told["delay_s"], rel=0.05)


@pytest.mark.parametrize(("seed", "kind"), [(7, "linear_phase"), (6, "causal"), (12, "mean"), (16, "none")])
def test_a_logged_record_does_not_depend_on_how_dense_its_motion_is(seed, kind):
    case, denser = make_logged(seed), make_logged(seed, points=80)
    assert case.chain.filters["spool"].kind == kind
    assert denser.condition.base == case.condition.base
    for found, dense in ((case.spool, denser.spool), (case.body, denser.body)):
        assert np.std(found - dense) < 2e-4 * np.std(found)


def test_friction_matters_in_the_logged_records_of_the_field_study():
    case = make_logged(LOGGED[3])
    assert case.importance[case.hidden].matters
    assert case.hidden in case.accepted


@pytest.mark.parametrize(
    ("seed", "kind"), [pytest.param(91000, "mean", marks=pytest.mark.slow), (92041, "none")]
)
def test_friction_that_falls_with_speed_is_found_at_its_speed(seed, kind):
    """Another low-pass was found first, and at instants a law of another speed looks as likely."""
    found = judge_logged(seed)
    assert {one.model for one in found.estimates} == {kind}
    assert "stribeck_velocity" in {one.quantity for one in found.estimates}
    for one in found.estimates:
        assert one.value == pytest.approx(one.truth, rel=0.01), one
