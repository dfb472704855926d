"""Fixtures for tests of nodes: ROS domains on which no other program of this machine talks.

A package's `conftest.py` imports them, so that its tests run by `colcon test` in any workspace.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import pytest

from spool_core.node.network import claimed_domain


@pytest.fixture(autouse=True, scope="session")
def away_from_other_ros_programs() -> Iterator[None]:
    """Claim a free domain: a process that a test starts without a domain talks there."""
    with claimed_domain() as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture(scope="session")
def claim_domain() -> Callable[[], AbstractContextManager[int]]:
    """Return what claims a ROS domain, for fixtures that several tests share."""
    return claimed_domain


@pytest.fixture
def domain_id(claim_domain: Callable[[], AbstractContextManager[int]]) -> Iterator[int]:
    """Claim a ROS domain for one test, and return its number."""
    with claim_domain() as number:
        yield number
