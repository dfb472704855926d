"""Spectra against those of SciPy, which nodes do not load."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft, signal
from spool_core.numbers import Array
from spool_estimator.identification.spectra import (
    cross_spectrum,
    delayed,
    density_of,
    fast_length,
    floor_of,
    resting_noise,
)

RATE = 500.0


def channels(samples: int) -> tuple[Array, Array]:
    """Noise about a level, and its sum over time with independent noise."""
    one, other = np.random.default_rng(4).normal(3.0, 1.0, (2, samples))
    return one, np.convolve(one, np.full(5, 0.2), mode="same") + 0.1 * other


@pytest.mark.parametrize("average", ["mean", "median"])
@pytest.mark.parametrize(("samples", "piece"), [(2000, 256), (2001, 255), (700, 500), (300, 300), (900, 300)])
def test_the_power_density_is_welch_s(samples: int, piece: int, average: str) -> None:
    row, _ = channels(samples)
    found = density_of([row], 1.0 / RATE, piece / RATE, average)
    due = signal.welch(row, RATE, "hann", piece, detrend=False, average=average)
    np.testing.assert_allclose(found[0], due[0], rtol=1e-12)
    np.testing.assert_allclose(found[1], due[1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("samples", "piece"), [(2000, 256), (2001, 255), (300, 300)])
def test_cross_spectra_are_welch_s_of_pieces_less_their_means(samples: int, piece: int) -> None:
    body, spool = channels(samples)
    found = cross_spectrum(body, spool, RATE, piece)
    np.testing.assert_allclose(found.body, signal.welch(body, RATE, "hann", piece)[1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        found.spool, signal.welch(spool, RATE, "hann", piece)[1], rtol=1e-9, atol=1e-12
    )
    frequency, cross = signal.csd(body, spool, RATE, "hann", piece)
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-12)
    np.testing.assert_allclose(found.cross, cross, rtol=1e-9, atol=1e-12)


def test_rows_that_are_delayed_by_whole_samples_are_moved_by_them() -> None:
    rows = np.stack(channels(400))
    for row in (rows, rows[0]):
        np.testing.assert_allclose(delayed(row, 3.0 / RATE, 1.0 / RATE)[..., 3:], row[..., :-3], atol=1e-9)


def test_a_record_shorter_than_a_piece_is_one_piece() -> None:
    body, spool = channels(100)
    short, whole = cross_spectrum(body, spool, RATE, 256), cross_spectrum(body, spool, RATE, 100)
    np.testing.assert_array_equal(short.cross, whole.cross)
    np.testing.assert_allclose(short.coherence[1:], 1.0)


@pytest.mark.parametrize("lines", [1, 2, 3, 4, 5, 41, 500])
def test_the_floor_of_a_spectrum_of_any_length_is_the_level_of_its_upper_half(lines: int) -> None:
    """The last lines are an anti-alias filter's; what stands out below the upper half is the motion."""
    density = np.full(lines, 2.5)
    density[: lines // 2] = 1e3
    assert floor_of(density) == pytest.approx(2.5)
    if lines > 40:
        density[round(0.98 * lines) :] = 1e-9
        density[round(0.8 * lines)] = 1e3
        assert floor_of(density) == pytest.approx(2.5)


def test_a_fast_length_is_the_next_product_of_2_3_and_5() -> None:
    counts = [*range(1, 3000), 999_983, 7_000_001]
    due = [fft.next_fast_len(count, real=True) for count in counts]
    assert [fast_length(count) for count in counts] == due


@pytest.mark.parametrize(("calm", "across"), [(1.0, 0.0), (0.05, 0.3)])
def test_noise_of_the_body_is_what_its_spool_does_not_follow_in_calm_seconds(
    calm: float, across: float
) -> None:
    """At the spool's resonance the transfer turns within a band; two loud seconds follow two calm ones."""
    rate, count, noise = 1000.0, 40_000, 0.01
    generator = np.random.default_rng(5)
    frequency = np.fft.rfftfreq(count, 1.0 / rate)

    def passed(row: Array, gain: Array) -> Array:
        return np.asarray(np.fft.irfft(np.fft.rfft(row) * gain, count))

    body = passed(generator.standard_normal(count), ((frequency > 8.0) & (frequency < 80.0)).astype(float))
    body *= np.where(np.arange(count) // 2000 % 2 == 0, calm, 6.0)
    ratio, damping = frequency / 30.0, 0.05j * frequency / 30.0
    spool = passed(body, np.asarray((1.0 + damping) / (1.0 - ratio**2 + damping)))
    aside = passed(generator.standard_normal(count), across * (abs(frequency - 30.0) < 12.0))
    white = noise**2 * 2.0 / rate
    places, density = resting_noise(
        body + aside + noise * generator.standard_normal(count),
        spool + noise * generator.standard_normal(count), white, rate,
    )  # fmt: skip
    expected = max(white, across**2 * 2.0 / rate)
    assert float(np.interp(28.5, places, density)) == pytest.approx(expected, rel=0.5)
