"""Settings of every test: judged by what it says, not by how busy the machine is; run on all processors."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.hookimpl(optionalhook=True)  # pytest-xdist is not on every machine that has ROS 2
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Number of workers: one file has its tests one after the other, and needs no worker of its own."""
    named = {Path(argument.partition("::")[0]) for argument in config.args}
    if len(named) == 1 and all(path.is_file() for path in named):
        return 0
    # One more than the processors: tests of live nodes wait most of their time.
    return len(os.sched_getaffinity(0)) + 1
