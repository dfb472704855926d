"""Time bases: gaps, repeated rows, coarse and jittering stamps."""

from __future__ import annotations

import numpy as np
import pytest
from spool_import.records.time_base import time_base
from spool_stream.errors import InputError

RNG = np.random.default_rng(5)
ROWS = (RNG.normal(size=8000), RNG.normal(size=8000))


def where(row: int) -> str:
    return f"line {row}"


def test_jittering_stamps_of_a_regular_clock_are_placed_on_its_line() -> None:
    true = np.arange(8000) / 1000.3
    found = time_base("x", "t", true + np.random.default_rng(1).normal(0.0, 2.5e-4, 8000), ROWS, where)
    assert found.period == pytest.approx(1.0 / 1000.3, rel=1e-6)
    assert float(np.abs(found.time - true).max()) < 2e-5
    assert found.repairs["jitter_placed_on_a_line"] == 8000
    assert not found.gaps.size


def test_lost_samples_are_found_behind_jitter() -> None:
    true = np.delete(np.arange(8005) / 1000.0, np.arange(3000, 3005))
    found = time_base("x", "t", true + np.random.default_rng(2).normal(0.0, 2.0e-4, 8000), ROWS, where)
    assert found.gaps.tolist() == [3000]
    assert float(np.abs(found.time - true).max()) < 5e-5


def test_samples_that_truly_come_at_irregular_times_are_refused() -> None:
    time = np.cumsum(np.random.default_rng(3).uniform(0.5e-3, 1.4e-3, 8000))
    with pytest.raises(InputError, match="sampling is irregular, a step of"):
        time_base("x", "t", time, ROWS, where)


def test_times_rounded_to_milliseconds_are_placed_on_a_line() -> None:
    true = np.arange(8000) / 2048.0
    found = time_base("x", "t", np.floor(true * 1e3) / 1e3, ROWS, where)
    assert found.period == pytest.approx(1.0 / 2048.0, rel=1e-4)
    assert float(np.abs(found.time - true).max()) < 1.1e-3


def test_rows_written_twice_are_left_out() -> None:
    order = np.sort(np.concatenate([np.arange(8000), [70, 4000, 4000]]))
    time = (np.arange(8000) / 2000.0)[order]
    found = time_base("x", "t", time, [row[order] for row in ROWS], where)
    assert found.repairs == {"repeated_rows": 3}
    assert found.kept is not None
    np.testing.assert_array_equal(time[found.kept], np.arange(8000) / 2000.0)


def test_a_clock_that_goes_back_is_refused_with_its_place() -> None:
    time = np.arange(8000) / 2000.0
    time[5000:] -= 1.0
    with pytest.raises(InputError, match="line 5000: t does not increase"):
        time_base("x", "t", time, ROWS, where)


def test_rows_that_were_exchanged_are_refused() -> None:
    time = np.arange(8000) / 2000.0
    time[[4000, 4001]] = time[[4001, 4000]]
    with pytest.raises(InputError, match="does not increase"):
        time_base("x", "t", time, ROWS, where)
