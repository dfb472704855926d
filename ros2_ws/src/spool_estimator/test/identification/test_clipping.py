"""A rail is where readings pile up, not where a coarse converter has its highest level."""

import numpy as np
import pytest
from spool_estimator.identification.channel_faults import at_rail

TIME = np.arange(100_000) / 2500.0


def loud_once(noise):
    """A resonance that is passed once, m/s^2."""
    loud = np.exp(-(((TIME - 20.0) / 0.2) ** 2))
    return (10.0 + 90.0 * loud) * np.sin(2.0 * np.pi * 31.3 * TIME) + noise


def test_a_rail_that_one_passage_meets_is_found():
    row = loud_once(np.random.default_rng(1).normal(0.0, 0.1, TIME.size))
    read = np.clip(row, -93.0, 93.0)
    over = np.abs(row) >= 93.0
    assert 20 < np.count_nonzero(over) < 6e-4 * row.size
    found = at_rail(read)
    assert found is not None
    assert np.array_equal(found, over)


def read_by_a_converter(row, levels):
    step = np.abs(row).max() / levels
    return np.round(row / step) * step


@pytest.mark.parametrize("levels", [8, 60, 400, 30_000])
@pytest.mark.parametrize("noise", [0.0, 0.02, 1.0])
def test_a_coarse_converter_alone_clips_nothing(levels, noise):
    drawn = np.random.default_rng(2).normal(0.0, 1.0, TIME.size) * noise
    for row in (10.0 * np.sin(2.0 * np.pi * 31.3 * TIME) + drawn, loud_once(drawn)):
        assert at_rail(read_by_a_converter(row, levels)) is None


@pytest.mark.parametrize("levels", [60, 400, 30_000])
def test_a_rail_is_found_behind_a_coarse_converter(levels):
    row = loud_once(np.random.default_rng(3).normal(0.0, 0.1, TIME.size))
    assert at_rail(np.clip(read_by_a_converter(row, levels), -60.0, 60.0)) is not None
