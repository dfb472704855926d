"""The figures of the estimation chain: small runs of `./spool bench estimate`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from spool_evaluation.benchmarks import estimate

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import System


@pytest.mark.slow
def test_replay_and_refits_are_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimate, "SECONDS", 20.0)
    monkeypatch.setattr(estimate, "REFIT_SECONDS", 12.0)
    replay, refits, window = estimate.offline(tmp_path)
    for row in (replay, refits, window):
        assert row.ours_s > 0.0
        assert row.peer_s > 0.0


@pytest.mark.slow
def test_every_block_of_a_live_valve_is_judged(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(system.domain_id))
    (tmp_path / "one").mkdir()
    p50, p99, lag = estimate.latency(tmp_path / "one", 8.0)
    assert 0.0 < p50.ours_s <= p99.ours_s
    assert lag.ours_s == pytest.approx(5 / 2000.0)
    said = capfd.readouterr()
    assert "; 0 blocks lost" in said.out + said.err
