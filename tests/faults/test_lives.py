"""What processes keep on a disk of which the n-th call fails; each n by the slow tests, a few otherwise."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from .disk import Disk

REPOSITORY = Path(__file__).parents[2]


def lived(process: str, folder: Path, begin: int, step: int) -> None:
    """Let the calls ``begin``, ``begin + step``, ... of a process fail in each mode; print what that cost."""
    disk = Disk(folder / "disk", folder / "control")
    environment = {**os.environ, **disk.environment, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    command = [sys.executable, "-m", "tests.faults.lives", process, str(folder), str(begin), str(step)]
    done = subprocess.run(
        command, cwd=REPOSITORY, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    head, *lives = map(json.loads, done.stdout.splitlines())
    lost = {mode: sum(bool(one["lost"]) for one in lives if one["mode"] == mode) for mode in head["modes"]}
    print(f"{process}: {head['calls']} calls, {len(lives)} lives, with a loss that the log states: {lost}")
    assert lives
    assert [one for one in lives if one["unstated"] or one["doubled"] or one["wrong"]] == []


@pytest.mark.parametrize(("process", "step"), [("monitor", 47), ("page", 83), ("opcua", 3)])
def test_a_call_that_fails_costs_no_alarm_and_nothing_unstated(
    process: str, step: int, tmp_path: Path
) -> None:
    lived(process, tmp_path, 2, step)


@pytest.mark.slow
@pytest.mark.parametrize("process", ["monitor", "page", "opcua"])
def test_any_call_that_fails_costs_no_alarm_and_nothing_unstated(process: str, tmp_path: Path) -> None:
    lived(process, tmp_path, 1, 1)
