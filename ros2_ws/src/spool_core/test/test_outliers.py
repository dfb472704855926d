"""Single impossible samples are left out of a stream; what an accelerometer can read is never touched."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from spool_core.block import Block
from spool_core.kernels.samples import OutlierFilter, impossible

PERIOD = 1e-3


def wave(seconds: float = 4.0, level: float = 8.0) -> NDArray[np.float64]:
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    noise = 0.03 * np.random.default_rng(0).standard_normal(time.size)
    return level * np.sin(2.0 * np.pi * 18.0 * time) + 0.3 * level * np.sin(2.0 * np.pi * 61.0 * time) + noise


def through(outliers: OutlierFilter, body: NDArray[np.float64], sizes: list[int]) -> NDArray[np.float32]:
    """Return what the filter makes of ``body`` in blocks of ``sizes``, one after the other."""
    rows, first, number = [], 0, 0
    samples = body.astype(np.float32)
    while first < body.size:
        part = samples[first : first + sizes[number % len(sizes)]]
        block = Block(10**18 + round(first * PERIOD * 1e9), number, PERIOD, part, part)
        cleaned = outliers.cleaned(block, restarts=number == 0)
        assert (cleaned is block) == (outliers.first is None)
        rows.append(cleaned.body)
        first, number = first + part.size, number + 1
    return np.concatenate(rows)


@given(
    value=st.sampled_from([-9999.0, 9999.0, 1e5, 500.0, -32768.0, 200.0]),
    places=st.sets(st.integers(40, 390), max_size=12),
    sizes=st.lists(st.integers(1, 700), min_size=1, max_size=4),
    width=st.integers(1, 3),
)
@settings(max_examples=40, deadline=None)
def test_impossible_samples_are_replaced_by_what_was_due_however_blocks_are_cut(
    value: float, places: set[int], sizes: list[int], width: int
) -> None:
    truth = wave()
    spoiled = truth.copy()
    spots = [10 * place for place in places]
    for spot in spots:
        spoiled[spot : spot + width] = value
    outliers = OutlierFilter()
    cleaned = through(outliers, spoiled, sizes)
    assert outliers.body == outliers.spool == width * len(spots)
    assert np.abs(cleaned - truth).max() < 4.0  # of a wave of 10 m/s^2, where 200 to 1e5 were read
    untouched = np.ones(truth.size, dtype=bool)
    for spot in spots:
        untouched[spot : spot + width] = False
    assert np.array_equal(cleaned[untouched], truth[untouched].astype(np.float32))


@pytest.mark.parametrize("level", [0.05, 2.0, 40.0])
def test_a_machine_that_starts_and_hits_of_the_spool_are_no_outliers(level: float) -> None:
    row = np.concatenate([0.03 * np.random.default_rng(1).standard_normal(3000), wave(level=level)])
    hits = np.arange(3500, row.size, 211)
    for offset, share in ((0, 0.5), (1, 1.0), (2, 0.9), (3, 0.4)):  # a stop is hit for some samples
        row[hits + offset] += 6.0 * level * share
    outliers = OutlierFilter()
    assert np.array_equal(through(outliers, row, [20]), row.astype(np.float32))
    assert not impossible(row, PERIOD).any()


def test_of_a_record_the_first_sample_can_be_impossible() -> None:
    row = wave()
    row[[0, 1, 1500, row.size - 1]] = [-9999.0, -9999.0, 700.0, 1e5]
    assert np.flatnonzero(impossible(row, PERIOD)).tolist() == [0, 1, 1500, row.size - 1]


def test_a_row_of_readings_that_no_accelerometer_has_is_left_out_whole() -> None:
    row = wave()
    row[2000:2300] = -9999.0
    outliers = OutlierFilter()
    assert np.abs(through(outliers, row, [50])).max() < 20.0
    assert outliers.body == 300
