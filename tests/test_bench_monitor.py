"""The comparison of the drift test with its peers, without the simulation of the full run."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spool_evaluation.benchmarks.monitor import PEERS, ChangePoints, DriftStream, _delays, _false, _first


def stream(step: float, seed: int = 1) -> DriftStream:
    """Return 200 s of noise with a step after 100 s."""
    noise = np.random.default_rng(seed).normal(0.0, 0.05, 200)
    shares = noise + step * (np.arange(200) >= 100)
    reached, began = (100.0, 100.0) if step else (math.nan, math.inf)
    return DriftStream(
        "coulomb_force", (), tuple(float(s) for s in range(200)), tuple(shares.tolist()), reached, began
    )


@pytest.mark.parametrize("name", PEERS)
def test_each_peer_finds_a_step_in_some_setting_that_keeps_silent_on_noise(name: str) -> None:
    fitting = []
    for make in PEERS[name].values():
        if math.isinf(_first(make(), stream(0.0))):
            when = _first(make(), stream(2.0))
            if math.isfinite(when) and not _false(stream(2.0), when):
                fitting.append(_delays([stream(2.0)], [when])[0])
    assert fitting
    assert 0.0 <= min(fitting) < 30.0


def test_the_run_length_is_the_time_since_the_change_and_the_level_that_of_its_values() -> None:
    generator = np.random.default_rng(3)
    detector = ChangePoints(hazard=1e-3, scatter=0.1)
    for value in generator.normal(0.0, 0.1, 60):
        detector.update(value)
    assert detector.changed < 0.2
    for value in generator.normal(1.0, 0.1, 40):
        detector.update(value)
    assert detector.lengths[np.argmax(detector.weights)] == 40
    assert detector.changed > 0.999
    assert detector.level == pytest.approx(1.0, abs=0.05)


def test_without_a_hazard_the_level_is_the_conjugate_mean_of_all_values() -> None:
    """Bayes' rule for a normal level: the posterior's mean in closed form."""
    values = [0.3, 0.5, 0.1, 0.4]
    detector = ChangePoints(hazard=0.0, scatter=0.2, prior=0.5)
    for value in values:
        detector.update(value)
    assert detector.level == pytest.approx(sum(values) / 0.2**2 / (0.5**-2 + len(values) / 0.2**2))
