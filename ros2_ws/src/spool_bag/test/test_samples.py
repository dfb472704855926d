from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from spool_bag.information import describe

BAGS = Path(__file__).resolve().parents[4] / "bags"


@pytest.mark.parametrize("name", ["practice_01", "practice_03", "practice_04"])
def test_sample_bags_are_whole(name: str) -> None:
    found = describe(BAGS / name)
    (valve,) = found.valves
    assert (found.closed, found.warnings, found.damages) == (True, (), ())
    assert (valve.name, valve.blocks, valve.samples, valve.lost_blocks) == ("valve_1", 2000, 80_000, 0)
    assert (valve.sample_rate, found.duration_s) == (2000.0, 40.0)
    with AnyReader([BAGS / name]) as reader:
        assert reader.message_count == 2000
