"""Bags of a small fleet, simulated once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from spool_report.records.simulation import simulate
from spool_report.requests import SimulationSettings


@pytest.fixture
def make_bag() -> Callable[..., Path]:
    """Return what simulates a bag."""
    return simulated_bag


def simulated_bag(path: Path, seed: int, *, celsius: float = 40.0, seconds: float = 8.0) -> Path:
    """Return a bag of ``seconds`` at 1 kHz."""
    path.parent.mkdir(parents=True, exist_ok=True)
    settings = SimulationSettings(
        "4weh10_soft", "coulomb", "multisine", seconds, sample_rate=1000.0, block_rate=25.0,
        coulomb_force=0.5, seed=seed, oil_temperature=f"{celsius}",
    )  # fmt: skip
    simulate(path, settings)
    return path


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of eight bags: two machines with two valves on two days."""
    folder = tmp_path_factory.mktemp("recordings")
    seed = 0
    for machine in ("press_1", "press_2"):
        for day in ("2026-03-02", "2026-04-06"):
            for valve in ("valve_1", "valve_2"):
                seed += 1
                simulated_bag(folder / machine / day / valve, seed, celsius=35.0 + seed)
    return folder
