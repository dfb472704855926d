"""Evidence for small effects counts as often as the noise is independent in their direction."""

from __future__ import annotations

import numpy as np
import pytest
from spool_gap.selection.all_windows import spread
from spool_gap.simulation.simulate import median_over_mean, smoothed

WINDOWS, NUMBERS = 400, 30
EDGES = np.arange(WINDOWS + 1) * NUMBERS


def test_independent_numbers_spread_as_one() -> None:
    generator = np.random.default_rng(1)
    change = generator.standard_normal(WINDOWS * NUMBERS)
    noise = [generator.standard_normal(change.size) for _ in range(4)]
    assert spread(change, noise, EDGES) == pytest.approx(1.0, rel=0.15)


def test_lines_that_go_together_count_once() -> None:
    """Noise that is the same number in three lines of a window says as much as one of them."""
    generator = np.random.default_rng(2)
    change = np.ones(WINDOWS * NUMBERS)
    noise = [np.repeat(generator.standard_normal(WINDOWS * NUMBERS // 3), 3) for _ in range(4)]
    assert spread(change, noise, EDGES) == pytest.approx(3.0, rel=0.15)


@pytest.mark.parametrize("pieces", [1, 4])
def test_the_median_of_densities_is_as_much_below_their_mean_as_is_said(pieces: int) -> None:
    generator = np.random.default_rng(3)
    lines = generator.standard_normal((20_000, 2 * pieces))
    density = np.mean(lines**2, axis=1)
    expected = float(np.median(density) / np.mean(density))
    assert median_over_mean(pieces * 100, 100) == pytest.approx(expected, rel=0.02)


def test_many_windows_keep_the_peak_of_a_resonance() -> None:
    """Flattened, it would be weighed as if the noise were less there than it is."""
    density = np.ones(60)
    density[10] = 36.0
    assert smoothed(density, 0)[10] == 36.0
    assert smoothed(density, 2)[10] == pytest.approx((36.0 + 4.0) / 5.0)
