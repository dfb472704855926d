from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from spool_core.block import Block
from spool_monitor.window import SignalWindow, WindowTracker, taper

START = 1_700_000_000_000_000_000


def feed(tracker: WindowTracker, samples: NDArray[np.float32], rate: float, size: int) -> list[SignalWindow]:
    found = []
    for number, first in enumerate(range(0, samples.shape[1], size)):
        body, spool = samples[:, first : first + size]
        found += tracker.update(Block(START + round(first / rate * 1e9), number, 1.0 / rate, body, spool))
    return found


def noise(count: int, seed: int = 0) -> NDArray[np.float32]:
    return (3.0 + np.random.default_rng(seed).standard_normal((2, count))).astype(np.float32)


@given(size=st.integers(1, 2500), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_each_holds_the_last_second_however_the_stream_is_split(size: int, seed: int) -> None:
    rate, samples = 1000.0, noise(2500, seed)
    tracker = WindowTracker()
    tracker.restart(1.0 / rate)
    found = feed(tracker, samples, rate, size)
    assert [window.number for window in found] == list(range(7))
    for window in found:
        end = 1000 + 250 * window.number
        assert np.array_equal(window.samples, samples[:, end - 1000 : end])
        assert abs(window.stamp - START - (end - 1) * 1_000_000) <= 2


@given(seed=st.integers(0, 999), count=st.sampled_from([16, 125, 2000]), level=st.floats(-50.0, 50.0))
@settings(max_examples=30, deadline=None)
def test_the_taper_does_what_numpy_does(seed: int, count: int, level: float) -> None:
    samples = (noise(count, seed) + level).astype(np.float32)
    weights = np.hanning(count)
    tapered = np.empty(samples.shape)
    means = taper(samples, weights, tapered)
    wide = samples.astype(np.float64)
    assert means == pytest.approx(wide.mean(axis=1), rel=1e-12)
    expected = (wide - wide.mean(axis=1, keepdims=True)) * weights
    np.testing.assert_allclose(tapered, expected, atol=1e-12 * (1.0 + abs(level)))


def test_spectrum_and_means_are_those_of_the_samples() -> None:
    tracker = WindowTracker()
    tracker.restart(1e-3)
    (window,) = feed(tracker, noise(1000), 1000.0, 1000)
    wide, weights = window.samples.astype(np.float64), np.hanning(1000)
    expected = np.fft.rfft((wide - wide.mean(axis=1, keepdims=True)) * weights)
    np.testing.assert_allclose(window.spectrum, expected, atol=1e-10)
    assert window.means == pytest.approx(np.average(wide, axis=1, weights=weights))
    assert window.step == pytest.approx(1.0)
    assert window.energy == pytest.approx(np.sum(weights**2))


def test_a_restart_forgets_what_was_before_and_takes_over_another_period() -> None:
    tracker = WindowTracker()
    tracker.restart(1e-3)
    assert feed(tracker, noise(999), 1000.0, 333) == []
    for rate in (1000.0, 10000.0, 2000.0):
        tracker.restart(1.0 / rate)
        count = round(rate)
        assert feed(tracker, noise(count - 1), rate, count) == []
        tracker.restart(1.0 / rate)
        new = noise(count, seed=1)
        (window,) = feed(tracker, new, rate, 77)
        assert np.array_equal(window.samples, new)
        assert window.number == 0


def test_a_busy_controller_computes_a_third_of_the_spectra() -> None:
    """Blocks of 0.4 s as it takes them together; the windows it does look at are the same."""
    noise = np.random.default_rng(5).normal(size=(2, 20 * 800)).astype(np.float32)
    found = []
    for thinned in (False, True):
        tracker = WindowTracker()
        tracker.restart(5e-4)
        blocks = [
            Block(START + n * 400_000_000, n, 5e-4, *noise[:, 800 * n : 800 * (n + 1)]) for n in range(20)
        ]
        found.append({one.stamp: one for block in blocks for one in tracker.update(block, thinned=thinned)})
    every, few = found
    assert len(few) / len(every) == pytest.approx(1.0 / 3.0, abs=0.05)
    assert all(np.array_equal(one.spectrum, every[stamp].spectrum) for stamp, one in few.items())
