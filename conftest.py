"""Settings of every test: judged by what it says, not by how busy the machine is; run on all processors."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
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
    # More than the processors: tests of live nodes wait most of their time.
    return len(os.sched_getaffinity(0)) + 2


@contextlib.contextmanager
def claimed_domain() -> Iterator[int]:
    """Claim a ROS domain that no other test on this machine uses now; their ports are free for 1 to 100."""
    folder = Path(tempfile.gettempdir()) / f"spool_test_domains_{os.getuid()}"
    folder.mkdir(exist_ok=True)
    for number in range(1, 101):
        with (folder / str(number)).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield number
            return
    raise RuntimeError(f"all 100 domains are in use, see {folder}")


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A ROS domain of the test's own."""
    with claimed_domain() as number:
        yield number


@pytest.fixture(scope="session")
def claim_domain() -> Callable[[], AbstractContextManager[int]]:
    """Return what claims a ROS domain, for fixtures that several tests share."""
    return claimed_domain
