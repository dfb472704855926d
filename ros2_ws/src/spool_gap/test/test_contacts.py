"""End stops: named with what acts between the hits, whatever law the contact has."""

from __future__ import annotations

import pytest
from spool_estimator.identification.record import Record, records_from_blocks
from spool_gap.evidence.analyse import analyse
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=80.0, duration=8.0, amplitude=9.0)
BASE = MODELS["fluid"]
GAP, STIFFNESS = 2.0e-3, 4e5
KELVIN_VOIGT = {"stop_dissipation": 0.0, "stop_damping": 80.0}
HUNT_CROSSLEY = {"stop_dissipation": 4.0, "stop_damping": 0.0}


def record(terms: tuple[str, ...], rate: float = 2500.0, seconds: float = 24.0, **given: float) -> Record:
    model = Model("hidden", (*BASE.terms, *(term(name) for name in terms)), {})
    simulator = Simulator(
        VALVE, SWEEP, model=model, parameters=given, sample_rate=rate, block_size=50, seed=3,
        body_sensor=Sensor(noise=0.03), spool_sensor=Sensor(noise=0.03),
    )  # fmt: skip
    (found,) = records_from_blocks(simulator.records(seconds), "hidden")
    return found


def with_stop(loss: dict[str, float], rate: float = 2500.0) -> Record:
    return record(("end_stop",), rate, stop_gap=GAP, stop_stiffness=STIFFNESS, **loss)


@pytest.mark.parametrize(
    "loss",
    [pytest.param(loss, marks=pytest.mark.slow) for loss in (KELVIN_VOIGT, HUNT_CROSSLEY)],
    ids=["kelvin_voigt", "hunt_crossley"],
)
def test_a_stop_is_named_whatever_the_law_of_its_contact(loss: dict[str, float]) -> None:
    result = analyse([with_stop(loss)], VALVE, BASE)
    assert result.verdict == "end_stop"
    numbers = {quantity.name: quantity.value for quantity in result.effects[0].parameters}
    assert numbers["stop_gap"] == pytest.approx(GAP, rel=0.02)
    assert numbers == pytest.approx(
        {**numbers, **{name: value for name, value in loss.items() if value}}, rel=0.1
    )
    assert result.after.nrmse < 0.15 * result.before.nrmse


@pytest.mark.slow
def test_friction_jointly_with_a_stop_is_named_with_its_size() -> None:
    numbers = {"coulomb_force": 0.4, "stop_gap": 1.5e-3, "stop_stiffness": STIFFNESS, **KELVIN_VOIGT}
    hidden = record(("coulomb_friction", "end_stop"), **numbers)
    result = analyse([hidden], VALVE, BASE)
    assert set(result.verdict.split("+")) == {"coulomb_friction", "end_stop"}
    found = {q.name: q.value for effect in result.effects for q in effect.parameters}
    assert found["coulomb_force"] == pytest.approx(0.4, rel=0.05)
    assert found["stop_gap"] == pytest.approx(1.5e-3, rel=0.02)
