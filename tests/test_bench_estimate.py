"""The figures of the estimation chain: small runs of `./spool bench estimate`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from spool_bringup.benchmarks import estimate

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import System


def test_the_recursion_equals_padasip_and_is_at_least_50_times_as_fast() -> None:
    row = min((estimate.recursion() for _ in range(3)), key=lambda one: one.ours_s)
    assert row.ours_error is not None
    assert row.ours_error < 1e-6
    assert row.ratio > 50.0
    assert row.ours_s < 0.15e-6


def test_a_window_is_refitted_in_less_than_half_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimate, "SECONDS", 20.0)
    monkeypatch.setattr(estimate, "REFIT_SECONDS", 12.0)
    replay, refits, window = estimate.offline(tmp_path)
    assert replay.ratio > 50.0
    assert refits.ratio > 5.0
    assert window.ours_s < 0.5


def test_estimates_come_within_20_ms_and_no_block_is_lost(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(system.domain_id))
    # The machine may be busy with something else for a while: the best of three counts.
    for attempt in range(3):
        folder = tmp_path / f"one_{attempt}"
        folder.mkdir()
        _, p99, lag = estimate.latency(folder, 8.0)
        if p99.ours_s < 0.02:
            break
    assert p99.ours_s < 0.02
    assert 0.0 < lag.ours_s < 0.02
    (tmp_path / "many").mkdir()
    row = estimate.many(tmp_path / "many", 8, 6.0)
    # Late or lost: what else runs on the machine may hold up a few of the 2400 blocks, not a percent of them.
    assert row.ours_error is not None
    assert row.ours_error < 24.0
    # Four times as many valves have room on the core.
    assert 4.0 * row.ours_s < row.peer_s
