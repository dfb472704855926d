"""What draws of a valve's parameters show of its frequency response."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from spool_design.frequency_response import Curve, bounds, changes_of


def test_of_a_thousand_draws_25_lie_beyond_each_end_of_the_95_percent_interval() -> None:
    """At two frequencies; a draw without a number may lie on either side."""
    draws = np.random.default_rng(0).permutation(np.arange(1.0, 1000.0))
    lacking = np.where(draws == 500.0, np.nan, draws)
    low, high = bounds(np.column_stack([draws, lacking]))
    np.testing.assert_allclose(low, [25.0, 24.0], atol=1e-9)
    np.testing.assert_allclose(high, [975.0, 976.0], atol=1e-9)


def test_a_change_is_that_of_the_largest_value_over_all_orders() -> None:
    """Two orders with a peak each: the second is higher before, the first after."""
    frequency = np.array([10.0, 12.0, 14.0])

    def of(*peaks: float) -> Any:
        rows = [np.array([[0.5, peak, 0.25]]) for peak in peaks]
        return SimpleNamespace(curves=[Curve(frequency, row, 1e-3 * row[:, ::-1]) for row in rows])

    ratio, _, stroke = changes_of(of(2.0, 3.0), of(7.5, 4.0))
    assert (ratio.before, ratio.after, ratio.factor) == (3.0, 7.5, 2.5)
    assert (stroke.before, stroke.after) == (3.0, 7.5)
