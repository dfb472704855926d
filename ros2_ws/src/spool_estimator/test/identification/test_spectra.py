"""Spectra against those of SciPy, which nodes do not load."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft, signal
from spool_core.numbers import Array
from spool_estimator.identification.spectra import cross_spectrum, delayed, density_of, fast_length, floor_of

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
