"""End stops: found by their hits, named jointly with what acts between them, whatever law the contact has."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from spool_estimator.identification.record import Record
from spool_gap.result import GapSettings
from spool_gap.selection.windows import median_share
from spool_gap.simulation.contact_free import bridged, contact_free_segments, without_hits
from spool_gap.simulation.contacts import Contacts, find_contacts
from spool_gap.simulation.segments import Stretch, stretches_of
from spool_gap.simulation.shooting import RUN_IN
from spool_gap.workflow.analyse import analyse
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
    blocks = list(simulator.records(seconds))
    body = np.concatenate([block.body for block in blocks]).astype(np.float64)
    spool = np.concatenate([block.spool for block in blocks]).astype(np.float64)
    return Record("hidden", 0, blocks[0].sample_period, body, spool)


def with_stop(loss: dict[str, float], rate: float = 2500.0) -> Record:
    return record(("end_stop",), rate, stop_gap=GAP, stop_stiffness=STIFFNESS, **loss)


def stretches(hidden: Record) -> list[Stretch]:
    return stretches_of([hidden], [], BASE, VALVE, damping=VALVE.viscous_coefficient)


@lru_cache
def hit() -> tuple[list[Stretch], Contacts]:
    found = stretches(with_stop(KELVIN_VOIGT))
    contacts = find_contacts(found, VALVE.moving_mass)
    assert contacts is not None
    return found, contacts


def test_hits_show_clearance_stiffness_and_loss_of_the_contact() -> None:
    _, contacts = hit()
    law = contacts.laws[0]
    assert law.gap == pytest.approx(GAP, rel=0.04)
    assert law.stiffness == pytest.approx(STIFFNESS, rel=0.2)
    assert law.damping == pytest.approx(80.0, rel=0.3)


def test_spring_and_drag_of_the_base_come_from_between_the_hits() -> None:
    _, contacts = hit()
    assert contacts.spring == pytest.approx(VALVE.spring_stiffness, rel=0.02)
    assert contacts.drag == pytest.approx(VALVE.viscous_coefficient, rel=0.05)


@pytest.mark.parametrize(
    ("terms", "given"),
    [
        ((), {}),
        (("cubic_stiffness",), {"cubic_coefficient": 8e7}),
        (("coulomb_friction",), {"coulomb_force": 0.5}),
        (("spring_preload",), {"preload_force": 0.4, "preload_travel": 2e-5}),
    ],
)
def test_nothing_else_is_taken_for_a_hit(terms: tuple[str, ...], given: dict[str, float]) -> None:
    assert find_contacts(stretches(record(terms, **given)), VALVE.moving_mass) is None


def test_contact_free_windows_hold_no_hit_run_in_included() -> None:
    found, contacts = hit()
    free = contact_free_segments(found, contacts)
    assert sum(len(stretch.windows) for stretch in free) > 10
    for stretch in free:
        period = stretch.record.sample_period
        for window in stretch.windows:
            assert (window.start - window.first) * period == pytest.approx(RUN_IN, abs=period)
            assert not contacts.touching[0][window.first : window.stop].any()
        assert 0 < sum(stretch.training) < len(stretch.training)


def test_the_noise_is_that_between_the_hits() -> None:
    found, contacts = hit()
    assert found[0].noise.spool_rms > 0.1
    assert without_hits(found, contacts)[0].noise.spool_rms == pytest.approx(0.03, rel=0.5)


def test_a_hit_is_bridged_by_a_straight_line() -> None:
    row = np.array([0.0, 1.0, 50.0, -70.0, 4.0, 5.0])
    gone = np.array([False, False, True, True, False, False])
    np.testing.assert_allclose(bridged(row, gone), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])


@pytest.mark.parametrize(
    "loss",
    [pytest.param(loss, marks=pytest.mark.slow) for loss in (KELVIN_VOIGT, HUNT_CROSSLEY)],
    ids=["kelvin_voigt", "hunt_crossley"],
)
def test_a_stop_is_named_whatever_the_law_of_its_contact(loss: dict[str, float]) -> None:
    result = analyse([with_stop(loss)], VALVE, BASE, settings=GapSettings(longest=12000))
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
    result = analyse([hidden], VALVE, BASE, settings=GapSettings(longest=12000))
    assert set(result.verdict.split("+")) == {"coulomb_friction", "end_stop"}
    found = {q.name: q.value for effect in result.effects for q in effect.parameters}
    assert found["coulomb_force"] == pytest.approx(0.4, rel=0.05)
    assert found["stop_gap"] == pytest.approx(1.5e-3, rel=0.02)


def test_a_window_that_goes_astray_does_not_say_what_stays_of_the_gap_in_the_median() -> None:
    before = [np.full((1, 10), 2.0)] * 5
    after = [np.full((1, 10), 0.2)] * 4 + [np.full((1, 10), 3.0)]
    nothing = [np.zeros((1, 10))] * 5
    assert median_share(before, after, nothing) == pytest.approx(0.1)
    assert median_share(before, after, [np.full((1, 10), 0.2)] * 5) == 0.0
    assert median_share(before, before, nothing) == pytest.approx(1.0)
