from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.kernels.samples import StandingWatch

PERIOD = 5e-4
NOISE = np.random.default_rng(1).normal(0.0, 1.0, (2, 2_000)).astype(np.float32)


def standing_from(first: int, channels: tuple[int, ...]) -> np.ndarray:
    samples = NOISE.copy()
    for channel in channels:
        samples[channel, first:] = samples[channel, first - 1]
    return samples


@pytest.mark.parametrize(("channels", "after"), [((0, 1), 100), ((0,), 400), ((1,), 400)])
def test_a_standstill_is_seen_after_its_time_and_its_age_is_known(
    channels: tuple[int, ...], after: int
) -> None:
    watch = StandingWatch(PERIOD)
    samples = standing_from(1_000, channels)
    watch.take(samples[:, : 1_000 + after - 1])
    assert not watch.stands
    assert watch.doubtful
    watch.take(samples[:, 1_000 + after - 1 : 1_500])
    assert watch.stands
    assert watch.age == pytest.approx(500 * PERIOD)
    watch.take(NOISE[:, :10])
    assert not watch.doubtful
    watch.take(NOISE[:, 10:300])
    assert not watch.stands


@given(cuts=st.lists(st.integers(1, 1_999), max_size=10))
def test_the_split_changes_nothing(cuts: list[int]) -> None:
    samples = standing_from(1_700, (0, 1))
    watch = StandingWatch(PERIOD)
    for part in np.split(samples, sorted(set(cuts)), axis=1):
        watch.take(part)
    assert watch.age == pytest.approx(300 * PERIOD)
    assert watch.stands


def test_a_coarse_converter_that_reads_a_slow_vibration_does_not_stand_still() -> None:
    time = np.arange(20_000) * PERIOD
    wave = 0.3 * np.sin(2.0 * np.pi * 5.0 * time)
    coarse = (np.round(np.stack((wave, 0.7 * wave)) / 0.08) * 0.08).astype(np.float32)  # 12 bit of 16 g
    watch = StandingWatch(PERIOD)
    for part in np.split(coarse, 100, axis=1):
        watch.take(part)
        assert not watch.stands
