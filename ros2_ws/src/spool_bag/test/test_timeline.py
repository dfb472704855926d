"""Time across the steps of a clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv as pa_csv
import pytest
from spool_bag.export import export_bag
from spool_bag.information import Timeline, describe, duration_of
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import encode_block

MakeBlock = Callable[..., Block]
HOUR = 3_600_000_000_000


def stepped(block: MakeBlock, by: int, *, restarts: bool) -> list[Block]:
    """Return 10 s in whose middle the clock steps by ``by`` ns."""
    blocks = [block(sequence) for sequence in range(500)]
    return blocks[:250] + [
        replace(one, stamp=one.stamp + by, sequence=one.sequence - (250 if restarts else 0))
        for one in blocks[250:]
    ]


def timeline_of(blocks: list[Block]) -> Timeline:
    timeline = Timeline()
    for one in blocks:
        timeline.take(one)
    return timeline


@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.parametrize("by", [-HOUR, HOUR, -3_000_000_000, 20 * HOUR])
def test_a_step_begins_a_time_of_its_own(block: MakeBlock, by: int, restarts: bool) -> None:
    timeline = timeline_of(stepped(block, by, restarts=restarts))
    assert len(timeline.spans) == 2
    assert timeline.duration == 10_000_000_000
    (step,) = timeline.steps
    assert (step.at, step.by) == (pytest.approx(5.0), pytest.approx(by * 1e-9))
    assert timeline.since(block(300).stamp + by, 4_000_000_000) == 6_000_000_000


def test_lost_blocks_late_ones_and_single_wrong_stamps_are_no_steps(block: MakeBlock) -> None:
    blocks = [block(sequence) for sequence in (*range(50), *range(200, 250), 252, 251, *range(253, 300))]
    blocks.insert(20, replace(blocks[20], stamp=blocks[20].stamp + HOUR))
    blocks.insert(30, replace(blocks[30], stamp=blocks[30].stamp - HOUR, sequence=2**60))
    timeline = timeline_of(blocks)
    assert timeline.steps == []
    assert timeline.duration == 6_000_000_000


def test_valves_share_their_time(block: MakeBlock) -> None:
    whole = timeline_of([block(sequence) for sequence in range(100)])
    later = timeline_of([block(sequence) for sequence in range(200, 300)])
    assert duration_of([whole, whole]) == 2.0
    assert duration_of([whole, later]) == 6.0
    both = timeline_of(stepped(block, -HOUR, restarts=False))
    assert duration_of([both, both]) == 10.0
    assert duration_of([Timeline()]) is None


def test_a_bag_with_a_step_is_told_and_its_table_counts_on(tmp_path: Path, block: MakeBlock) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for one in stepped(block, -HOUR, restarts=False):
            writer.write(channel, one.stamp, encode_block(one, "valve_1"))
    found = describe(tmp_path / "bag")
    assert found.duration_s == pytest.approx(10.0)
    assert (found.valves[0].times, found.valves[0].duration_s) == (2, pytest.approx(10.0))
    assert any("its time jumps back by 3600.000 s at 5.0 s" in warning for warning in found.warnings)
    result = export_bag(tmp_path / "bag", tmp_path / "table.csv")
    assert any("jumps back" in warning for warning in result.warnings)
    time = pa_csv.read_csv(tmp_path / "table.csv").column("time_s").to_numpy()
    assert np.all(np.diff(time) > 0.0)
    assert time[-1] == pytest.approx(10.0, abs=0.03)
