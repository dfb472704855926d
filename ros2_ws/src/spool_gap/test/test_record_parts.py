"""Long recordings in bounded memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
from spool_core.block import Block
from spool_estimator.identification.record import PART, PartKeeper, records_from_blocks
from spool_estimator.record_judgement import usable

PERIOD = 1e-3
SIZE = 100


def blocks(seconds: float, *, hole_at: float = -1.0) -> Iterator[Block]:
    """Yield noise that is loud for a minute in each ten."""
    draw = np.random.default_rng(5)
    for number in range(round(seconds / (SIZE * PERIOD))):
        time = number * SIZE * PERIOD
        if hole_at <= time < hole_at + 1.0:
            continue
        level = 5.0 if time % 600.0 < 60.0 else 1.0
        row = (level * draw.standard_normal(SIZE)).astype(np.float32)
        yield Block(10**18 + round(time * 1e9), number, PERIOD, row, -row)


def kept(seconds: float, largest: int) -> PartKeeper:
    keeper = PartKeeper(largest)
    for block in blocks(seconds):
        keeper.take(block)
    return keeper


def test_what_fits_is_held_as_it_is() -> None:
    keeper = PartKeeper(100_000)
    for block in blocks(60.0, hole_at=20.0):
        keeper.take(block)
    expected = records_from_blocks(blocks(60.0, hole_at=20.0), "bag", [(10**18, 40.0)])
    found = keeper.records("bag", [(10**18, 40.0)])
    assert len(found) == len(expected) == 2
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.body, other.body)
        np.testing.assert_array_equal(one.spool, other.spool)
        np.testing.assert_array_equal(one.oil_temperature, other.oil_temperature)
        assert (one.start, one.origin, one.cut) == (other.start, other.origin, other.cut)


def test_an_hour_is_represented_by_parts_from_all_of_it_that_are_no_gaps() -> None:
    records = kept(3600.0, 200_000).records("bag")
    assert sum(record.body.size for record in records) <= 200_000
    assert sum(record.body.size for record in records) > 60_000
    begins = np.array([(record.start - 10**18) * 1e-9 for record in records])
    assert (np.diff(begins) > 0.0).all()
    # One part stands for 32, wherever among them it lies.
    assert np.diff([0.0, *begins, 3600.0]).max() <= 2 * 32 * PART
    assert max(record.duration for record in records) <= PART + SIZE * PERIOD
    # A minute in ten is loud: of the parts nearly all minutes are held that are.
    assert sum(record.body.std() > 3.0 for record in records) >= 5
    for record in records:
        samples = np.random.default_rng(0).integers(0, record.body.size, 20)
        np.testing.assert_array_equal(record.spool[samples], -record.body[samples])
    assert usable(records)[1] == []


def test_memory_does_not_grow_with_the_length() -> None:
    peaks = []
    for seconds in (600.0, 3600.0):
        tracemalloc.start()
        kept(seconds, 100_000)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]
