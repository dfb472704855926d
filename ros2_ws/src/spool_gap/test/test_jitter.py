"""Samples taken at uneven instants are distinguished from noise, with the scatter of those instants."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from spool_estimator.identification.record import Record
from spool_gap.evidence.analyse import analyse
from spool_gap.result import GapResult
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
RATE, FINER, SECONDS, NOISE = 1000.0, 10, 8.0, 0.03


@pytest.fixture(scope="module", name="motion")
def _motion() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Body and spool, ten samples for each one that is recorded."""
    sweep = SweptSine(start_frequency=6.0, stop_frequency=45.0, duration=SECONDS, amplitude=8.0)
    quiet = Sensor(noise=0.0)
    simulator = Simulator(
        VALVE, sweep, model="fluid", sample_rate=FINER * RATE, block_size=500,
        body_sensor=quiet, spool_sensor=quiet,
    )  # fmt: skip
    blocks = list(simulator.records(SECONDS))
    body, spool = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("body", "spool"))
    return np.asarray(body, dtype=np.float64), np.asarray(spool, dtype=np.float64)


def result(motion: tuple[NDArray[np.float64], NDArray[np.float64]], scatter: float) -> GapResult:
    """Analyse the record whose spool channel is read ``scatter`` s (rms) too early or too late."""
    generator = np.random.default_rng(4)
    body, spool = motion
    fine = np.arange(body.size) / (FINER * RATE)
    instants = fine[::FINER]
    late = instants + scatter * generator.standard_normal(instants.size)
    noise = NOISE * generator.standard_normal((2, instants.size))
    read = np.interp(late, fine, spool) + noise[1]
    record = Record("swept", 0, 1.0 / RATE, body[::FINER] + noise[0], read)
    return analyse([record], VALVE, MODELS["fluid"])


def test_uneven_instants_are_said_to_be_that(motion: tuple[NDArray[np.float64], NDArray[np.float64]]) -> None:
    scatter = 2e-4
    found = result(motion, scatter)
    assert found.verdict == "none"
    assert not found.effects
    (nuisance,) = [entry for entry in found.nuisances if entry.id == "jitter"]
    assert nuisance.size == pytest.approx(scatter, rel=0.1)
    assert any("as with a sampling jitter of" in line for line in found.warnings)


@pytest.mark.slow
def test_even_instants_are_not(motion: tuple[NDArray[np.float64], NDArray[np.float64]]) -> None:
    found = result(motion, 0.0)
    assert found.verdict == "none"
    assert not any("sampling jitter" in line for line in found.warnings)
