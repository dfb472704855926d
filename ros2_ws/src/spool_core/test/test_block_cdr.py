"""CDR of a block; that it is what rosbags writes is tested beside the reader of bags."""

from __future__ import annotations

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.cdr import LONGEST_NAME, decode_block, encode_block

ROW = np.arange(3, dtype=np.float32)


@pytest.mark.parametrize("source", ["", "v", "valve_1", "Gehäuse", "v" * (LONGEST_NAME - 1)])
def test_a_block_comes_back_whole_with_the_name_of_its_source(source: str) -> None:
    block = decode_block(encode_block(Block(7, 3, 0.001, ROW, -ROW), source))
    assert (block.stamp, block.sequence, block.sample_period, block.source) == (7, 3, 0.001, source)
    np.testing.assert_array_equal([block.body, block.spool], [ROW, -ROW])
