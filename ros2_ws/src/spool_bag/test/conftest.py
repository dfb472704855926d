"""Blocks and bags that the tests of this package share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import encode_block

START = 1_700_000_000_000_000_000
PERIOD = 0.0005
SIZE = 40


def make_block(sequence: int, *, size: int = SIZE) -> Block:
    noise = np.random.default_rng(sequence).standard_normal((2, size)).astype(np.float32)
    return Block(START + sequence * round(size * PERIOD * 1e9), sequence, PERIOD, noise[0], noise[1])


@pytest.fixture
def block() -> Callable[..., Block]:
    return make_block


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A closed bag of 200 blocks in ten chunks."""
    path = tmp_path / "whole"
    with BagWriter(path, flush_interval=1e9) as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for sequence in range(200):
            sample = make_block(sequence)
            writer.write(channel, sample.stamp, encode_block(sample, "valve_1"))
            if sequence % 20 == 19:
                writer.flush()
    return path
