from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.numbers import Array, Complex
from spool_estimator.identification.channel_faults import DEPTHS, FLATTER, flat_top
from spool_monitor.channels import (
    ResponseTracker,
    Signals,
    ValveResponse,
    descend,
    due_power,
    levels,
    look,
    spectra,
    transfer,
)
from spool_monitor.detection import configured
from spool_monitor.detectors.sensor_faults import FOLLOWS, due_powers
from spool_monitor.window import WindowTracker

RATE = 1000.0


def windows(body: Array, spool: Array, size: int = 100) -> list[Signals]:
    tracker = WindowTracker()
    tracker.restart(1.0 / RATE)
    found = []
    for number in range(body.size // size):
        part = slice(number * size, (number + 1) * size)
        stamp = 10**18 + round(number * size / RATE * 1e9)
        block = Block(
            stamp, number, 1.0 / RATE, body[part].astype(np.float32), spool[part].astype(np.float32)
        )
        found += [look(window) for window in tracker.update(block) if window.number % 2 == 0]
    return found


def answers(frequency: Array, square: float, damping: float) -> Complex:
    """Return what ``transfer`` is for many frequencies."""
    w = 2.0 * math.pi * frequency
    follows = square + 1j * w * damping
    return np.asarray(follows / (follows - w**2))


def broadband(seconds: float, seed: int = 1) -> tuple[Array, Array]:
    """Return body and spool of a linear valve of 15 Hz, 60 1/s: lines on a grid of 0.1 Hz, as it settled."""
    generator = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    frequency = np.arange(40, 1000) * 0.1
    line = generator.standard_normal(frequency.size) + 1j * generator.standard_normal(frequency.size)
    answer = answers(frequency, (2.0 * math.pi * 15.0) ** 2, 60.0) * line
    body, spool = np.zeros(t.size), np.zeros(t.size)
    for one, other, f in zip(line, answer, frequency, strict=True):
        wave = np.exp(2j * np.pi * f * t)
        body += 0.1 * np.real(one * wave)
        spool += 0.1 * np.real(other * wave)
    return body, spool


def test_levels_and_means_are_those_of_the_signal() -> None:
    t = np.arange(4000) / RATE
    body = 3.0 + 5.0 * np.sin(2.0 * math.pi * 20.0 * t)
    last = windows(body, 0.5 * body - 4.0)[-1]
    assert last.body.mean == pytest.approx(3.0, abs=1e-3)
    assert last.spool.mean == pytest.approx(-2.5, abs=1e-3)
    assert last.body.rms == pytest.approx(5.0 / math.sqrt(2.0), rel=0.01)
    assert last.body_power.sum() == pytest.approx(12.5, rel=0.01)
    assert last.relative_rms == pytest.approx(2.5 / math.sqrt(2.0), rel=0.01)
    assert last.relative_velocity == pytest.approx(last.relative_rms / (2.0 * math.pi * 20.0), rel=0.01)
    assert not last.body.constant


@given(size=st.sampled_from([1, 7, 100, 333, 1200]))
@settings(max_examples=5, deadline=None)
def test_how_the_stream_is_split_changes_nothing(size: int) -> None:
    body, spool = broadband(3.0)
    first, other = windows(body[:2400], spool[:2400], 50), windows(body[:2400], spool[:2400], size)
    for one, two in zip(first, other, strict=False):
        assert abs(one.stamp - two.stamp) <= 2
        assert np.array_equal(one.cross, two.cross)


@pytest.mark.parametrize("level", [0.4, 0.7, 0.9])
@pytest.mark.parametrize("frequency", [9.0, 25.0, 61.7])
def test_a_clipped_sine_has_a_flat_top_and_no_other_wave_has(level: float, frequency: float) -> None:
    t = np.arange(1000) / RATE
    wave = np.sin(2.0 * math.pi * frequency * t)
    cut = np.clip(wave, -level, level)
    assert flat_top(cut, level, level) > 0.05
    assert flat_top(wave, float(wave.max()), 1.0) == 0.0


@given(seed=st.integers(0, 10_000), noise=st.floats(0.0, 0.3), frequency=st.floats(5.0, 90.0))
@example(seed=447, noise=0.0, frequency=50.0)  # twenty samples a period, two of them on each top
@example(seed=33, noise=0.0, frequency=5.0)  # both waves make a top with two humps
@settings(max_examples=200, deadline=None)
def test_no_mixture_of_waves_and_noise_has_a_flat_top(seed: int, noise: float, frequency: float) -> None:
    generator = np.random.default_rng(seed)
    t = np.arange(1000) / RATE
    wave = np.sin(2.0 * math.pi * (frequency * t + generator.random()))
    wave += 0.3 * np.sin(4.0 * math.pi * (frequency * t + generator.random()))
    wave += noise * generator.standard_normal(t.size)
    half = 0.5 * float(wave.max() - wave.min())
    assert flat_top(wave, float(wave.max()), half) == 0.0


def test_the_relative_motion_of_a_passive_valve_takes_energy_and_exchanged_channels_turn_it_round() -> None:
    body, spool = broadband(6.0)
    right, swapped = windows(body, spool)[-1], windows(spool, body)[-1]
    assert right.dissipation == pytest.approx(60.0, rel=0.1)
    assert swapped.dissipation == pytest.approx(-60.0, rel=0.1)
    dead = windows(body, np.zeros_like(spool))[-1]
    assert abs(dead.dissipation) < 1.0
    assert dead.spool.constant


def fit(body: Array, spool: Array) -> ValveResponse:
    tracker = ResponseTracker()
    found = [tracker.update(one, configured(17.0)) for one in windows(body, spool)]
    assert found[:3] == [None, None, None]
    assert found[-1] is not None
    return found[-1]


@pytest.mark.parametrize("gain", [1.0, 0.8, 1.3])
def test_the_fit_finds_frequency_damping_and_gain(gain: float) -> None:
    body, spool = broadband(12.0)
    noise = np.random.default_rng(3).normal(0.0, 0.05, (2, body.size))
    found = fit(body + noise[0], gain * spool + noise[1])
    assert found.natural_frequency == pytest.approx(15.0, rel=0.02)
    assert found.damping == pytest.approx(60.0, rel=0.08)
    assert found.gain == pytest.approx(gain, abs=max(0.02, 5.0 * found.gain_deviation))
    assert found.gain_deviation < 0.03


def test_one_tone_alone_tells_no_gain() -> None:
    t = np.arange(8000) / RATE
    answer = transfer(40.0, (2.0 * math.pi * 15.0) ** 2, 60.0)
    wave = 5.0 * np.exp(2j * np.pi * 40.0 * t)
    noise = np.random.default_rng(3).normal(0.0, 0.05, (2, t.size))
    assert fit(wave.real + noise[0], (answer * wave).real + noise[1]).gain_deviation > 0.06


# Each kernel against the same in numpy.


def spectrum(seed: int, count: int = 120) -> Complex:
    parts = np.random.default_rng(seed).standard_normal((2, 2, count))
    return np.asarray(parts[0] + 1j * parts[1])


@given(seed=st.integers(0, 999))
@settings(max_examples=20, deadline=None)
def test_spectra_are_what_numpy_makes_of_the_lines(seed: int) -> None:
    given_lines, scale, step = spectrum(seed), 0.3, 0.5
    body, spool = given_lines[:, 6:101]
    frequency, body_power, spool_power, cross, sums = spectra(given_lines, 6, 101, step, scale)
    np.testing.assert_allclose(frequency, np.arange(6, 101) * step)
    np.testing.assert_allclose(body_power, scale * np.abs(body) ** 2)
    np.testing.assert_allclose(spool_power, scale * np.abs(spool) ** 2)
    np.testing.assert_allclose(cross, scale * spool * body.conj())
    relative = spool_power + body_power - 2.0 * cross.real
    w = 2.0 * math.pi * frequency
    assert sums == pytest.approx(
        (relative.sum(), np.sum(relative / w**2), np.sum(cross.imag / w)), rel=1e-9, abs=1e-12
    )


def slow_flat_top(samples: Array, peak: float, half: float) -> float:
    for depth in DEPTHS:
        at_top = samples >= peak - depth * half
        count = int(np.count_nonzero(at_top))
        pairs = int(np.count_nonzero(at_top[1:] & at_top[:-1]))
        triples = int(np.count_nonzero(at_top[2:] & at_top[1:-1] & at_top[:-2]))
        below = int(np.count_nonzero(samples >= peak - 4.0 * depth * half)) - count
        long_enough = pairs >= max(4, 0.005 * samples.size) and triples >= 0.02 * pairs
        if long_enough and count > FLATTER * (below + 1):
            return count / samples.size
    return 0.0


@given(seed=st.integers(0, 999), level=st.floats(0.05, 1.2), offset=st.floats(-3.0, 3.0))
@settings(max_examples=60, deadline=None)
def test_levels_are_what_numpy_makes_of_the_samples(seed: int, level: float, offset: float) -> None:
    generator = np.random.default_rng(seed)
    wave = np.sin(np.arange(800) * generator.uniform(0.02, 0.5)) + 0.02 * generator.standard_normal(800)
    samples = (offset + np.clip(wave, -9.0 if seed % 2 else -level, level)).astype(np.float32)
    wide = samples.astype(np.float64)
    low, high = float(wide.min()), float(wide.max())
    half = 0.5 * (high - low)
    square, flat, standing, step = levels(samples, 0.1)
    assert square == pytest.approx(np.mean((wide - 0.1) ** 2), rel=1e-12)
    assert flat == slow_flat_top(wide, high, half) + slow_flat_top(-wide, -low, half)
    changes = np.abs(np.diff(wide))
    assert step == changes[changes > 0.0].min()
    assert standing == (np.nonzero(changes[::-1])[0][0])


def test_a_channel_that_does_not_move_is_constant_and_has_no_flat_top() -> None:
    assert levels(np.full(100, 9.81, np.float32), float(np.float32(9.81)))[:3] == (0.0, 0.0, 99)


@given(natural=st.floats(5.0, 60.0), damping=st.floats(5.0, 300.0), seed=st.integers(0, 999))
@settings(max_examples=30, deadline=None)
def test_what_is_due_is_what_numpy_makes_of_the_response(natural: float, damping: float, seed: int) -> None:
    frequency = np.arange(3.0, 200.0)
    body, spool = np.random.default_rng(seed).exponential(1.0, (2, frequency.size))
    cross = np.sqrt(body * spool) * np.exp(1j * np.random.default_rng(seed).uniform(0.0, 7.0, frequency.size))
    square = (2.0 * math.pi * natural) ** 2
    answer = answers(frequency, square, damping)
    coherence = abs(np.sum(cross * answer.conj())) ** 2 / (body @ np.abs(answer) ** 2) / spool.sum()
    power = np.abs(answer) ** 2
    follows = power > FOLLOWS**2
    assert due_powers(frequency, body, spool, cross, square, damping) == pytest.approx(
        (body @ power, (spool[follows] / power[follows]).sum(), body[follows].sum(), coherence), rel=1e-9
    )
    relative = np.abs(answer - 1.0) ** 2
    assert due_power(frequency, body, square, damping) == pytest.approx(body @ relative, rel=1e-9)


@given(natural=st.floats(8.0, 40.0), damping=st.floats(20.0, 200.0), seed=st.integers(0, 999))
@settings(max_examples=30, deadline=None)
def test_the_descent_takes_the_steps_of_gauss_and_newton(natural: float, damping: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    frequency = np.arange(3.0, 200.0)
    body = generator.exponential(1.0, frequency.size)
    cross = body * answers(frequency, (2.0 * math.pi * natural) ** 2, damping) + 0.01 * spectrum(seed, 197)[0]
    theta = start = np.array([math.log((2.0 * math.pi * 15.0) ** 2), math.log(60.0), 1.0])
    w = 2.0 * math.pi * frequency
    for _ in range(4):
        square, drag, gain = math.exp(theta[0]), math.exp(theta[1]), theta[2]
        follows = square + 1j * w * drag
        shape = follows / (follows - w**2)
        slope = -(w**2) / (follows - w**2) ** 2
        columns = np.stack((gain * slope * square, gain * slope * 1j * w * drag, shape))
        normal = np.real((columns.conj() * body) @ columns.T)
        model = gain * shape
        right = np.real(columns.conj() @ (cross - model * body))
        gained = np.sum(2.0 * np.real(model.conj() * cross) - np.abs(model) ** 2 * body)
        damped = normal + 1e-9 * np.trace(normal) * np.eye(3)
        theta = theta + np.clip(np.linalg.solve(damped, right), -0.3, 0.3)
        theta[:2] = np.clip(theta[:2], -5.0, 25.0)
    # Uncompiled it cannot read or write beyond its arrays.
    for function in (descend, getattr(descend, "py_func", descend)):
        found, variance, taken = function(frequency, body, cross, start)
        np.testing.assert_allclose(found, theta, rtol=1e-8)
        assert variance == pytest.approx(np.linalg.inv(normal)[2, 2], rel=1e-6)
        assert taken == pytest.approx(gained, rel=1e-8)
