"""The comparison of the drift test with its peers, without the simulation of the full run."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spool_evaluation.benchmarks.monitor import PEERS, DriftStream, delays_of
from spool_evaluation.studies.peers import first_alarm, soonest


def stream(step: float, seed: int = 1) -> DriftStream:
    """Return 200 s of noise with a step after 100 s."""
    shares = np.random.default_rng(seed).normal(0.0, 0.05, 200) + step * (np.arange(200) >= 100)
    reached, began = (100.0, 100.0) if step else (math.nan, math.inf)
    return DriftStream("coulomb_force", (), np.arange(200.0), shares, math.inf, reached, began)


@pytest.mark.parametrize("name", PEERS)
def test_each_peer_finds_a_step_in_some_setting_that_keeps_silent_on_noise(name: str) -> None:
    streams = [stream(0.0), stream(2.0)]
    tried = {
        text: delays_of(
            [first_alarm(watched(one.shares), threshold, one.seconds) for one in streams], streams
        )
        for text, (watched, threshold) in PEERS[name].items()
    }
    _, delays = soonest({text: delays for text, delays in tried.items() if delays is not None})
    assert 0.0 <= delays[0] < 30.0


def test_a_change_that_is_told_of_before_it_begins_is_a_false_alarm_and_no_delay() -> None:
    streams = [stream(0.0), stream(2.0)]
    assert delays_of([math.inf, 99.0], streams) is None
    assert delays_of([5.0, 103.0], streams) is None
    found, missed = delays_of([math.inf, 103.0], streams), delays_of([math.inf, math.inf], streams)
    assert found is not None
    assert missed is not None
    assert (found.tolist(), missed.tolist()) == ([3.0], [math.inf])


def test_the_best_setting_misses_least_and_then_is_soonest() -> None:
    delays = {"late": [9.0, 9.0], "soon": [4.0, 6.0], "misses": [1.0, math.inf], "before": [math.nan, 1.0]}
    name, _ = soonest({name: np.array(found) for name, found in delays.items()})
    assert name == "soon"
