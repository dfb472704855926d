"""Spans of a recording: what lies in them is read, parts that cannot hold any of it are not opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from spool_bag.blocks import Span
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter, PartLimits
from spool_core.block import Block, BlockRun
from spool_core.cdr import encode_block

STEP = 20_000_000


@pytest.fixture(name="hour")
def _hour(tmp_path: Path, block: Callable[..., Block]) -> tuple[Path, int]:
    """Return ten minutes in parts of one, and the first stamp."""
    start = block(0).stamp
    with BagWriter(tmp_path / "bag", limits=PartLimits(duration=60.0), flush_interval=1e9) as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for sequence in range(30_000):
            one = block(sequence)
            writer.write(channel, one.stamp, encode_block(one, "valve_1"))
    return tmp_path / "bag", start


def test_what_lies_in_a_span_is_read_and_nothing_else(hour: tuple[Path, int]) -> None:
    bag, start = hour
    step = next(iter(BagReader(bag).blocks("valve_1")))
    width = round(step.body.size * step.sample_period * 1e9)
    span = Span(start + 12_345 * width, start + 12_400 * width)
    reader = BagReader(bag, span=span)
    assert [one.sequence for one in reader.blocks("valve_1")] == list(range(12_345, 12_400))
    assert sum(len(one) if isinstance(one, BlockRun) else 1 for one in reader.runs("valve_1")) == 55
    assert len(reader.files) < len(BagReader(bag).files)
    assert len(list(reader.records("/valve_1/acceleration"))) == 55
