"""Periodic response: against the simulator, and against harmonic balance by another program."""

from __future__ import annotations

import json
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from spool_design.frequency_response import SineResponse, sine_response
from spool_sim.excitation import SteadySine
from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.model import load_model
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
FREQUENCIES, AMPLITUDES = (8.0, 12.0, 15.0, 18.0, 25.0), (4.0, 8.0, 12.0, 20.0)
#: pyHarm-os 1.2.2, residual below 1e-5 N: 25 harmonics of 1,024 samples. Stop and play are its bilateral
#: gap. Coulomb friction is its Jenkins element of 3e6 N/m with 31 harmonics of 768 samples, from 6 m/s^2
#: on: below, the spool sticks for long and the element's own spring decides. For the stop at 18 Hz and
#: 12 m/s^2 pyHarm found no solution; 15 Hz and 16 m/s^2 replace it.
PEER = json.loads((Path(__file__).parent / "harmonic_balance.json").read_text(encoding="utf-8"))
#: Numbers of laws where those that they start with do little at these amplitudes.
STRONG = {
    "fluid_cubic_stiffness": {"cubic_coefficient": 5e7},
    "fluid_end_stop": {"stop_gap": 1.5e-3, "stop_stiffness": 2e4, "stop_dissipation": 0.5},
    "fluid_spring_backlash": {"backlash": 2e-4},
    # With the 2 N that it starts with the motion is chaotic where the inertia just exceeds it.
    "fluid_spring_preload": {"preload_force": 0.5},
}
LAWS = (
    "coulomb", "stribeck", "mixed", "microwedge", "coulomb_hydrodynamic", "fluid_asymmetric_friction",
    "fluid_presliding_friction", "fluid_quadratic_damping", "fluid_seal_friction",
    "fluid_tustin_friction", *STRONG,
)  # fmt: skip


@cache
def composed(model: str) -> ComposedMotion:
    return ComposedMotion(load_model(model).terms)


def settled(model: str, given: dict[str, float], frequency: float, amplitude: float) -> SineResponse:
    values, motion = load_model(model).values_for(VALVE, given), composed(model)
    sets = np.array([[values[name] for name in motion.names]])
    return sine_response(motion, values, sets, frequency, amplitude)


def simulated(model: str, given: dict[str, float], frequency: float, amplitude: float) -> float:
    """Return the amplitude ratio of the last periods of a record."""
    simulator = Simulator(
        VALVE, SteadySine(frequency=frequency, amplitude=amplitude), model=model, parameters=given,
        sample_rate=100.0 * frequency, block_size=100,
    )  # fmt: skip
    blocks = list(simulator.records(4.0))[-10:]
    body, spool = (
        abs(np.fft.rfft(np.concatenate([getattr(one, name) for one in blocks]).astype(np.float64))[10])
        for name in ("body", "spool")
    )
    return float(spool / body)


def worst(model: str) -> float:
    given = STRONG.get(model, {})
    errors = []
    for frequency, amplitude in product(FREQUENCIES, AMPLITUDES):
        found = settled(model, given, frequency, amplitude)
        assert found.settled[0]
        errors.append(abs(abs(found.ratio[0]) / simulated(model, given, frequency, amplitude) - 1.0))
    return max(errors)


@pytest.mark.parametrize(("model", "error"), [("fluid", 0.01), *((law, 0.03) for law in LAWS)])
def test_a_law_responds_as_in_20_simulated_records(model: str, error: float) -> None:
    assert worst(model) < error


@pytest.mark.parametrize("model", sorted({row["model"] for row in PEER}))
def test_harmonic_balance_of_pyharm_gives_the_same_in_20_conditions(model: str) -> None:
    rows = [row for row in PEER if row["model"] == model]
    assert len(rows) == 20
    allowed = 0.01 if model == "fluid" else 0.03
    for row in rows:
        found = settled(model, row["parameters"], row["frequency"], row["amplitude"])
        assert abs(found.ratio[0]) == pytest.approx(row["ratio"], rel=allowed)
        assert found.stroke[0] == pytest.approx(row["stroke"], rel=allowed, abs=1e-5)


def test_a_spool_that_sticks_follows_the_body() -> None:
    found = settled("coulomb", {"coulomb_force": 0.5}, 15.0, 2.0)  # 0.18 kg * 2 m/s^2 = 0.36 N
    assert found.ratio[0] == 1.0
    assert found.stroke[0] == 0.0


def test_motion_that_never_repeats_has_no_number() -> None:
    found = settled("fluid", {"viscous_coefficient": 1e-6}, 14.9, 10.0)  # its free motion takes days to fade
    assert not found.settled[0]
    assert np.isnan(found.ratio[0])
    assert np.isnan(found.stroke[0])
