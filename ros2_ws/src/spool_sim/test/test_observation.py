"""What a data logger reads of a motion with jumps: against filters of scipy on a finely sampled one."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import bessel, butter, cheb1ap, freqs_zpk, sosfilt, sosfiltfilt, sosfreqz
from spool_core.numbers import Array
from spool_sim.integration.composed_motion import ComposedMotion, MotionState
from spool_sim.model import MODELS
from spool_sim.observation import CAUSAL, INSTANTS, LINEAR, MEAN, SHAPES, Observation
from spool_sim.valve import find_valve

SAMPLES, FINE = 240, 512
KINDS = (
    Observation(MEAN),
    Observation(LINEAR, 3, 0.4),
    Observation(LINEAR, 6, 0.45),
    Observation(CAUSAL, 2, 0.33),
    Observation(CAUSAL, 6, 0.4),
    Observation(CAUSAL, 4, 0.3, shape=-1.0),
)
#: Place (samples), jump (m/s^2) and change of the rate (m/s^2 a sample) of events: between samples, on one,
#: and close to the one before.
EVENTS = np.array([[90.37, 2.0, 0.3], [120.0, -3.0, -0.2], [121.6, 1.0, 0.0]])


def acceleration(time: Array) -> Array:
    """Return a smooth motion with the events; ``time`` in samples."""
    after = time[:, np.newaxis] - EVENTS[:, 0]
    smooth = np.sin(2.0 * math.pi * 0.03 * time) + 0.5 * np.cos(2.0 * math.pi * 0.07 * time)
    steps = np.where(after >= 0.0, EVENTS[:, 1] + EVENTS[:, 2] * after, 0.0)
    return np.asarray(smooth + steps.sum(axis=1))


def read(one: Observation, every: int) -> Array:
    """Return what the code reads with ``every`` steps in a sample."""
    events = EVENTS * (every, 1.0, 1.0 / every)
    return one.read(acceleration(np.arange(SAMPLES * every) / every), events, every)


def filtered(one: Observation) -> Array:
    """Return the same from a finely sampled motion."""
    time = np.arange(-40 * FINE, (SAMPLES + 40) * FINE) / FINE
    fine = acceleration(time)
    late = 0.0
    if one.kind == MEAN:
        made = np.convolve(fine, np.ones(FINE) / FINE, mode="same")
        late = -0.5 / FINE
    else:
        family = partial(bessel, norm="mag") if one.shape else butter
        sections = family(int(one.order), one.corner, fs=FINE, output="sos")
        made = (sosfiltfilt if one.kind == LINEAR else sosfilt)(sections, fine)
        if one.kind == CAUSAL:
            near = 1e-3
            _, response = sosfreqz(sections, [near], fs=FINE)
            late = -float(np.angle(response[0])) / (2.0 * math.pi * near)
    return np.interp(np.arange(SAMPLES) + late, time, made)


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("one", KINDS, ids=str)
def test_jumps_and_kinks_are_read_as_through_a_filter(one: Observation, every: int) -> None:
    inner = slice(60, -60)
    apart = read(one, every)[inner] - filtered(one)[inner]
    # Half a step of the fine motion at a jump is its error: 3 m/s^2 over 1,024.
    assert float(np.abs(apart).max()) < 6e-3


@given(place=st.floats(80.0, 160.0), jump=st.floats(-5.0, 5.0), kink=st.floats(-1.0, 1.0))
@settings(deadline=None)
def test_a_reading_does_not_depend_on_the_steps_of_the_simulation(
    place: float, jump: float, kink: float
) -> None:
    for one in KINDS:
        rows = []
        for every in (1, 4):
            after = np.arange(SAMPLES * every) / every - place
            points = np.where(after >= 0.0, jump + kink * after, 0.0)
            rows.append(one.read(points, np.array([[place * every, jump, kink / every]]), every))
        assert float(np.abs(rows[0] - rows[1])[60:-60].max()) <= 6e-3 * (abs(jump) + abs(kink))


def test_samples_at_instants_are_the_points() -> None:
    points = np.arange(12.0)
    np.testing.assert_array_equal(Observation(INSTANTS).read(points, np.zeros((0, 3)), 3), points[::3])


@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("late", [0.005, -0.005])
def test_an_instant_close_to_a_jump_is_on_one_side_of_it(late: float, every: int) -> None:
    events = EVENTS * (every, 1.0, 1.0 / every)
    points = acceleration(np.arange(SAMPLES * every) / every)
    found = Observation(INSTANTS).read(points, events, every, late)
    np.testing.assert_allclose(found[60:-60], acceleration(np.arange(SAMPLES) - late)[60:-60], atol=6e-3)


@pytest.mark.parametrize("one", KINDS, ids=str)
def test_slow_motion_is_read_as_it_is(one: Observation) -> None:
    frequency = np.array([0.0, 1e-3])
    np.testing.assert_allclose(one.response(frequency), 1.0, atol=2e-5)


def test_a_motion_that_diverged_is_read_as_infinite() -> None:
    points = np.append(np.zeros(29), math.inf)
    assert np.all(np.isinf(Observation(MEAN).read(points, np.zeros((0, 3)), 1)))


@pytest.mark.parametrize("substeps", [1, 5])
def test_dry_friction_jumps_by_twice_its_force_where_the_spool_turns(substeps: int) -> None:
    valve = find_valve("4weh10_soft")
    force = 0.3
    motion = ComposedMotion(MODELS["coulomb"].terms)
    values = MODELS["coulomb"].values_for(valve, {"coulomb_force": force})
    time = np.arange(2 * 1000 * substeps + 1) / (2000.0 * substeps)
    body = 12.0 * np.sin(2.0 * math.pi * 25.0 * time)
    (points,) = motion.read_batch(
        MotionState(), body[np.newaxis], motion.table(values, 1)[np.newaxis],
        rows=np.zeros(1, dtype=np.int64), sample_period=1e-3, substeps=substeps,
    )  # fmt: skip
    late = points.events[points.events[:, 0] > 500.0 * substeps]
    assert 20 <= len(late) <= 30  # 25 Hz for half a second, two turns each
    np.testing.assert_allclose(np.abs(late[:, 1]), 2.0 * force / valve.moving_mass, rtol=1e-6)


def test_points_are_the_accelerations_of_a_simulation() -> None:
    valve = find_valve("4weh10_soft")
    motion = ComposedMotion(MODELS["coulomb"].terms)
    table = motion.table(MODELS["coulomb"].values_for(valve, {"coulomb_force": 0.4}), 1)
    body = 8.0 * np.sin(2.0 * math.pi * 20.0 * np.arange(4001) / 8000.0)
    plain, _ = motion.advance(MotionState(), body, table, sample_period=5e-4, substeps=2)
    (points,) = motion.read_batch(
        MotionState(), body[np.newaxis], table[np.newaxis], rows=np.zeros(1, dtype=np.int64),
        sample_period=5e-4, substeps=2,
    )  # fmt: skip
    np.testing.assert_array_equal(points.acceleration[::2], plain.acceleration)
    np.testing.assert_array_equal(points.displacement, plain.displacement)


@pytest.mark.parametrize("order", [3, 5, 7])
@pytest.mark.parametrize("ripple", [0.1, 0.5])
def test_a_shape_above_nothing_is_a_filter_of_chebyshev(order: int, ripple: float) -> None:
    _, poles, gain = cheb1ap(order, ripple)
    # On an ellipse: one pole on its real half axis, the outermost near its imaginary one.
    ratio = poles.imag.max() / math.cos(0.5 * math.pi / order) / -poles.real.min()
    dense = np.linspace(1.0, 3.0, 200001)
    corner = dense[np.argmax(np.abs(freqs_zpk([], poles, gain, dense)[1]) < math.sqrt(0.5))]
    frequency = np.linspace(0.0, 0.5, 40)
    found = Observation(CAUSAL, order, 0.3, shape=math.log(ratio)).response(frequency)
    expected = freqs_zpk([], poles, gain, frequency / 0.3 * corner)[1]
    np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=2e-4)


@given(order=st.integers(2, 8), corner=st.floats(0.1, 0.45), shape=st.floats(*SHAPES))
def test_a_causal_filter_of_any_shape_halves_the_power_at_its_corner(
    order: int, corner: float, shape: float
) -> None:
    one = Observation(CAUSAL, float(order), corner, shape=shape)
    below, at = np.abs(one.response(np.array([1e-4, corner]))) ** 2
    assert at == pytest.approx(0.5, abs=1e-4)
    assert below == pytest.approx(1.0, abs=1e-4)
    assert Observation.of(str(one)).shape == pytest.approx(shape, rel=1e-4)
    assert "low-pass, order" in one.sentence(1000.0)
