from __future__ import annotations

import math

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_estimator.sliding_window import (
    BODY,
    COLUMNS,
    DIRECTION,
    DISPLACEMENT,
    SPOOL,
    VELOCITY,
    Conditioning,
)


def condition(conditioning: Conditioning, body: Array, spool: Array) -> Array:
    rows = np.empty((body.size, COLUMNS))
    conditioning.take(body.astype(np.float32), spool.astype(np.float32), rows)
    return rows


def lengths(conditioning: Conditioning) -> tuple[int, int]:
    """Return the lengths of the running means, high-pass and low-pass, from the documented cut-offs."""
    period = conditioning.sample_period
    high = max(3, round(0.5 / (conditioning.low_cut * period)))
    return high, max(1, round(0.319 / (conditioning.high_cut * period)))


def triangle(signal: Array, length: int) -> Array:
    kernel = np.convolve(np.full(length, 1.0 / length), np.full(length, 1.0 / length))
    return np.convolve(signal, kernel)[: signal.size]


def delayed(signal: Array, samples: int) -> Array:
    return np.concatenate((np.zeros(samples), signal))[: signal.size]


def high_pass(signal: Array, length: int) -> Array:
    return delayed(signal, length - 1) - triangle(signal, length)


def integral(signal: Array, period: float) -> Array:
    """Return the integral up to one sample before each, by the cubic through four samples."""
    padded = np.concatenate((np.zeros(3), signal))
    steps = 13.0 * (padded[1:-2] + padded[2:-1]) - (padded[:-3] + padded[3:])
    return np.cumsum(steps) * period / 24.0


def reference(conditioning: Conditioning, body: Array, spool: Array) -> Array:
    """Return the rows of ``conditioning``, channel by channel with whole-record operations."""
    high, low = lengths(conditioning)
    period = conditioning.sample_period
    velocity = integral(high_pass(triangle(spool - body, low), high), period)
    direction = triangle(np.clip(velocity / conditioning.sliding_velocity, -1.0, 1.0), low)
    velocity_out = high_pass(velocity, high)
    channels = {
        DISPLACEMENT: (integral(velocity_out, period), low - 1 + 2 * (high - 1) + 2),
        VELOCITY: (velocity_out, low - 1 + 2 * (high - 1) + 1),
        DIRECTION: (high_pass(high_pass(direction, high), high), conditioning.delay),
        SPOOL: (high_pass(high_pass(triangle(spool, low), high), high), low - 1 + 2 * (high - 1)),
        BODY: (high_pass(high_pass(triangle(body, low), high), high), low - 1 + 2 * (high - 1)),
    }
    rows = np.empty((body.size, COLUMNS))
    for column, (channel, lag) in channels.items():
        rows[:, column] = delayed(channel, conditioning.delay - lag)
    return rows


@pytest.mark.parametrize(
    ("rate", "low_cut", "high_cut"),
    [(1000.0, 4.0, 300.0), (2000.0, 20.0, 300.0), (2000.0, 4.0, 40.0), (500.0, 60.0, 249.0)],
)
def test_equals_the_slow_reference(rate: float, low_cut: float, high_cut: float) -> None:
    conditioning = Conditioning(1.0 / rate, low_cut, high_cut, sliding_velocity=2e-3)
    generator = np.random.default_rng(3)
    body, spool = (generator.normal(0.3, 4.0, 3000).astype(np.float32).astype(float) for _ in range(2))
    rows = condition(conditioning, body, spool)
    expected = reference(conditioning, body, spool)
    for column in range(COLUMNS):
        assert np.abs(expected[:, column]).max() > 1e-5
        tolerance = 1e-9 * np.abs(expected[:, column]).max()
        np.testing.assert_allclose(rows[:, column], expected[:, column], rtol=0.0, atol=tolerance)


def test_a_reset_forgets_everything() -> None:
    generator = np.random.default_rng(4)
    body, spool = generator.normal(0.0, 5.0, (2, 1777))
    used, fresh = Conditioning(1e-3), Conditioning(1e-3)
    condition(used, spool, body)
    used.reset()
    np.testing.assert_array_equal(condition(used, body, spool), condition(fresh, body, spool))


def test_a_row_after_settling_is_free_of_what_was_before_the_start() -> None:
    conditioning, later = Conditioning(1e-3), Conditioning(1e-3)
    generator = np.random.default_rng(5)
    body, spool = generator.normal(0.0, 5.0, (2, 4000))
    start = 500
    whole = condition(conditioning, body, spool)
    part = condition(later, body[start:], spool[start:])
    settled = later.settling
    linear = [VELOCITY, SPOOL, BODY]
    np.testing.assert_allclose(part[settled:, linear], whole[start + settled :, linear], rtol=0.0, atol=1e-9)


def test_a_constant_and_a_ramp_vanish() -> None:
    conditioning = Conditioning(1.0 / 2000.0, 4.0, 300.0)
    # Powers of two, so that float32 holds the ramp exactly.
    ramp = np.arange(8000.0) * 2.0**-10
    rows = condition(conditioning, np.full(8000, -9.8125), 9.8125 + ramp)
    np.testing.assert_allclose(rows[conditioning.settling :], 0.0, rtol=0.0, atol=1e-9)


def amplitude(signal: Array, frequency: float, rate: float) -> complex:
    """Return the complex amplitude of the last second of ``signal`` at a whole number of Hz."""
    turns = frequency * np.arange(signal.size) / rate
    last = slice(signal.size - round(rate), None)
    return complex(2.0 * np.mean(signal[last] * np.exp(-2j * np.pi * turns[last])))


@pytest.mark.parametrize("rate", [1000.0, 2000.0, 10000.0])
@pytest.mark.parametrize("frequency", [10.0, 25.0, 60.0, 100.0])
def test_a_sine_gives_its_closed_form(frequency: float, rate: float) -> None:
    conditioning = Conditioning(1.0 / rate, 4.0, 300.0)
    times = np.arange(round(2.5 * rate)) / rate
    size = 12.0
    spool = size * np.sin(2.0 * math.pi * frequency * times)
    rows = condition(conditioning, np.zeros(times.size), spool)
    omega = 2.0 * math.pi * frequency

    def mean_gain(length: int) -> float:
        half = 0.5 * omega / rate
        return (math.sin(length * half) / (length * math.sin(half))) ** 2

    high, low = lengths(conditioning)
    gain = mean_gain(low) * (1.0 - mean_gain(high)) ** 2
    stated = 11.0 / 720.0 * (omega / rate) ** 4  # of one integration
    delay = np.exp(-1j * omega * conditioning.delay / rate)
    sent = size * np.exp(-0.5j * math.pi)
    for column, exact, integrations in (
        (SPOOL, 1.0 + 0j, 0),
        (VELOCITY, 1.0 / (1j * omega), 1),
        (DISPLACEMENT, -1.0 / omega**2 + 0j, 2),
    ):
        ratio = amplitude(rows[:, column], frequency, rate) / (sent * delay * exact * gain)
        assert abs(abs(ratio) - 1.0) <= 1.1 * integrations * stated + 2e-7
        # Linear phase: the delay is exact to below a thousandth of a sample.
        assert abs(np.angle(ratio)) * rate / omega < 1e-3
    band = abs(amplitude(rows[:, SPOOL], frequency, rate)) / size
    assert 0.7 < band < 1.0


def test_direction_of_sliding_is_a_band_passed_square_wave() -> None:
    """The first harmonic of sgn is 4 / pi, in phase with the velocity."""
    rate, frequency = 10000.0, 20.0
    conditioning = Conditioning(1.0 / rate, 4.0, 300.0, sliding_velocity=1e-6)
    times = np.arange(round(2.5 * rate)) / rate
    rows = condition(conditioning, np.zeros(times.size), 10.0 * np.sin(2 * math.pi * frequency * times))
    velocity = amplitude(rows[:, VELOCITY], frequency, rate)
    direction = amplitude(rows[:, DIRECTION], frequency, rate)
    spool = amplitude(rows[:, SPOOL], frequency, rate)
    assert abs(direction) / (abs(spool) / 10.0) == pytest.approx(4.0 / math.pi, rel=2e-3)
    assert abs(np.angle(direction / velocity)) < 1e-3


def test_nothing_drifts_in_ten_minutes_of_samples_with_gravity_in_one_channel() -> None:
    rate, frequency = 1000.0, 20.0
    conditioning = Conditioning(1.0 / rate, 4.0, 300.0)
    cycle = 10.0 * np.sin(2 * math.pi * frequency * np.arange(50) / rate)
    minute = np.tile(cycle, 1200)
    spool, body = (minute + 9.81).astype(np.float32), np.zeros(minute.size, dtype=np.float32)
    rows = np.empty((minute.size, COLUMNS))
    peaks = []
    for _ in range(10):
        conditioning.take(body, spool, rows)
        assert np.isfinite(rows).all()
        tail = rows[-50:, DISPLACEMENT]
        peaks.append((tail.max(), tail.min()))
    assert peaks[0][0] == pytest.approx(10.0 / (2 * math.pi * frequency) ** 2, rel=0.2)
    np.testing.assert_allclose(peaks, [peaks[0]] * 10, rtol=1e-8)
    assert abs(np.mean(rows[-50:, DISPLACEMENT])) < 1e-9 * peaks[0][0] * 100
