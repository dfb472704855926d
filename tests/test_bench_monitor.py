"""The comparison of the drift test with its peers, without the simulation of the full run."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spool_bringup.benchmarks.monitor import PEERS, Stream, _delays, _false, _first


def stream(step: float, seed: int = 1) -> Stream:
    """Return 200 s of noise with a step after 100 s."""
    noise = np.random.default_rng(seed).normal(0.0, 0.05, 200)
    shares = noise + step * (np.arange(200) >= 100)
    reached, began = (100.0, 100.0) if step else (math.nan, math.inf)
    return Stream(
        "coulomb_force", (), tuple(float(s) for s in range(200)), tuple(shares.tolist()), reached, began
    )


@pytest.mark.parametrize("name", PEERS)
def test_each_peer_finds_a_plain_step_in_some_setting_that_keeps_silent_on_noise(name: str) -> None:
    fitting = []
    for _, make in PEERS[name]:
        if math.isinf(_first(make(), stream(0.0))):
            when = _first(make(), stream(2.0))
            if math.isfinite(when) and not _false(stream(2.0), when):
                fitting.append(_delays([stream(2.0)], [when])[0])
    assert fitting
    assert 0.0 <= min(fitting) < 30.0
