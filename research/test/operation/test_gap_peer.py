"""The peer of the watch for a model gap: it tells distributions apart that differ, and no equal ones."""

from __future__ import annotations

import numpy as np
import pytest
from spool_core.block import Block
from spool_operation.gap_peer import BLOCKS, _distances, live


def blocks(samples: np.ndarray) -> list[Block]:
    rows = samples.reshape(-1, 50).astype(np.float32)
    return [Block(1 + number * 100_000_000, number, 0.002, row, row) for number, row in enumerate(rows)]


def test_equal_distributions_have_no_distance_and_disjoint_ones_have_one() -> None:
    one = np.tile(np.linspace(-1.0, 1.0, 50), 4 * BLOCKS)
    assert _distances(blocks(one), blocks(one), 2.0) == pytest.approx(0.0)
    apart = _distances(blocks(np.full(one.size, 1.0)), blocks(np.full(one.size, -1.0)), 2.0)
    assert apart[0] == 0.0  # the window is not full
    assert apart[1:] == pytest.approx(1.0)


@pytest.mark.slow
def test_a_record_follows_from_its_seed() -> None:
    first, again = (live((700_003, True)) for _ in range(2))
    assert first.effect == again.effect
    assert first.found == pytest.approx(again.found, nan_ok=True)
