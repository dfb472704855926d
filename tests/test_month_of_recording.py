"""A month of recording through a quota: time compressed, a separate process that is watched."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from spool_bag.mcap_file import McapFile
from spool_bag.parts import numbered
from spool_bag.reader import BagReader

from tests.month import DAY

DAYS = int(os.environ.get("SPOOL_DAYS", "30"))
QUOTA = 2_000_000_000


@pytest.mark.slow
def test_thirty_days_stay_below_the_quota_with_flat_memory_and_every_snapshot(tmp_path: Path) -> None:
    """One valve at 2 kHz, an alarm a day; the quota holds a little more than a day of it."""
    bag, snapshots = tmp_path / "bag", tmp_path / "snapshots"
    command = [sys.executable, "-m", "tests.month", str(bag), str(snapshots), str(DAYS), str(QUOTA)]
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path}
    ) as run:
        assert run.stdout is not None
        days, most = [], 0
        for line in run.stdout:
            days.append(int(line) / 1e3)
            print(f"day {len(days)}: {days[-1]:.1f} MB")
            sizes = [_size(file) for file in bag.glob("*.mcap")]
            most = max(most, sum(sizes))
            assert most <= QUOTA
            newest = numbered(bag)[-2][1]
            assert McapFile(newest).closed
    assert run.returncode == 0
    slope = float(np.polyfit(np.arange(len(days))[3:], days[3:], 1)[0])
    print(f"{most / 1e6:.0f} MB at most, memory grows {slope:.3f} MB a day, to {max(days):.0f} MB")
    assert slope < 1.0
    assert len(list(snapshots.iterdir())) == DAYS
    for snapshot in snapshots.iterdir():
        assert BagReader(snapshot).closed
    held = [one.sequence for one in BagReader(bag).blocks("valve_1")]
    assert held == list(range(held[0], DAYS * DAY))


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except FileNotFoundError:  # it went by the quota just now
        return 0
