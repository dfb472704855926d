"""What draws of a valve's parameters show of its frequency response."""

from __future__ import annotations

import numpy as np
from spool_report.runs.frequency_response import bounds


def test_of_a_thousand_draws_25_lie_beyond_each_end_of_the_95_percent_interval() -> None:
    """At two frequencies; a draw without a number may lie on either side."""
    draws = np.random.default_rng(0).permutation(np.arange(1.0, 1000.0))
    lacking = np.where(draws == 500.0, np.nan, draws)
    low, high = bounds(np.column_stack([draws, lacking]))
    np.testing.assert_allclose(low, [25.0, 24.0], atol=1e-9)
    np.testing.assert_allclose(high, [975.0, 976.0], atol=1e-9)
