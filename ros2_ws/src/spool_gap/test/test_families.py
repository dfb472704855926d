"""Each effect of the catalogue is named in a record of the simulator that has it, none in one of the base."""

from __future__ import annotations

from functools import lru_cache

import pytest
from spool_estimator.identification.record import Record, records_from_blocks
from spool_gap.catalogue import EFFECTS
from spool_gap.evidence.analyse import analyse
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.readings import readings_of
from spool_gap.likelihood.search import Search
from spool_gap.likelihood.structure import structure_of
from spool_gap.result import GapSettings
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
BASE = MODELS["fluid"]
MOTIONS = motions_for(BASE)
NOISE = 0.03
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=60.0, duration=8.0, amplitude=9.0)
#: Effect, and numbers of a size that a valve may have.
HIDDEN: tuple[tuple[str, dict[str, float]], ...] = (
    ("asymmetric_friction", {"forward_force": 0.3, "backward_force": 0.1}),
    ("coulomb_friction", {"coulomb_force": 0.4}),
    ("cubic_stiffness", {"cubic_coefficient": 4e7}),
    ("damping_drift", {"damping_drift_rate": -0.03}),
    ("end_stop", {"stop_gap": 2e-3, "stop_stiffness": 4e5, "stop_dissipation": 0.0, "stop_damping": 80.0}),
    ("mixed_friction", {"mixed_velocity": 0.006}),
    ("periodic_force", {"force_frequency": 47.0, "force_amplitude": 0.1}),
    ("presliding_friction", {"dahl_force": 0.4, "dahl_stiffness": 4e3}),
    ("quadratic_damping", {"quadratic_coefficient": 20.0}),
    ("spring_backlash", {"backlash": 2e-4}),
    ("spring_preload", {"preload_force": 0.5, "preload_travel": 2e-5}),
    ("stribeck_friction", {"coulomb_force": 0.25, "static_force": 0.6, "stribeck_velocity": 0.02}),
)
SEARCHED = sorted(name for name, _ in HIDDEN if EFFECTS[name].searched)
#: Fault of the spool's channel that a verdict names, and the sensor that has it.
FAULTS: dict[str, dict[str, float]] = {
    "spool_gain_error": {"gain_error": 0.1},
    "spool_delay": {"delay_samples": 1.2},
    "sensor_saturation": {"full_scale": 16.0},
}


def simulated(model: Model, values: dict[str, float], sensor: dict[str, float]) -> Record:
    """Return two sweeps of a valve of 8 s each."""
    simulator = Simulator(
        VALVE, SWEEP, model=model, parameters=values, sample_rate=1000.0, block_size=50, seed=6,
        body_sensor=Sensor(noise=NOISE), spool_sensor=Sensor(**{"noise": NOISE, **sensor}),
    )  # fmt: skip
    (found,) = records_from_blocks(simulator.records(16.0), "family")
    return found


@lru_cache
def record(effect: str = "") -> Record:
    """Return the record of the fluid model, with ``effect`` if there is one."""
    if effect in FAULTS:
        return simulated(BASE, {}, FAULTS[effect])
    terms = EFFECTS[effect].terms if effect else ()
    model = Model("hidden", (*BASE.terms, *(term(name) for name in terms)), {})
    return simulated(model, dict(HIDDEN).get(effect, {}), {})


def found_by(name: str, of: Record) -> tuple[str, ...]:
    """Return what a search for the effect ``name`` alone finds in a record."""
    predictions = Predictions([Prediction(readings_of(of), VALVE, MOTIONS)])
    search = Search(predictions, structure_of(BASE, VALVE), [name], least_share=GapSettings().least_share)
    search.run()
    return search.simplest.structure.effects


def test_every_effect_that_accelerometers_show_has_a_record() -> None:
    """A new effect needs a row in HIDDEN."""
    shown = {name for name, entry in EFFECTS.items() if "accelerations" in entry.kinds}
    assert set(dict(HIDDEN)) | set(FAULTS) == shown


@pytest.mark.parametrize("effect", [one for one in SEARCHED if one != "mixed_friction"])  # see test_search
def test_a_record_with_an_effect_shows_it(effect: str) -> None:
    assert found_by(effect, record(effect).part(0, 8000)) == (effect,)  # one sweep


@pytest.mark.slow
@pytest.mark.parametrize("effect", sorted({**dict(HIDDEN), **FAULTS}))
def test_the_effect_that_a_record_has_is_named_alone(effect: str) -> None:
    result = analyse([record(effect)], VALVE, BASE)
    assert result.verdict == effect
    assert [one.id for one in result.effects] == [effect]
    assert result.after.nrmse < result.before.nrmse or effect in FAULTS


@pytest.mark.slow
def test_nothing_is_named_in_a_record_of_the_base() -> None:
    assert not any(found_by(effect, record()) for effect in SEARCHED)
    result = analyse([record()], VALVE, BASE)
    assert result.verdict == "none"
    assert result.effects == ()
