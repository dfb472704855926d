"""Judgement of what a record determines, on records whose truth is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_core.kernels.compiled import compiled
from spool_estimator.identification.determination import sentences
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_estimator.identification.free_run import FreeRun
from spool_estimator.identification.record import Record
from spool_sim.excitation import Excitation, SteadySine, SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import TERMS, Parameter, Term
from spool_sim.valve import find_valve

SOFT = find_valve("4weh10_soft")
SWEEP = SweptSine(start_frequency=8.0, stop_frequency=60.0, duration=6.0, amplitude=8.0, soft_start=0.2)
TONE = SteadySine(frequency=30.0, amplitude=10.0)
CHECKED = FitSettings(check=True, timing=0.0)


def record(model: str, truth: dict[str, float], drive: Excitation = SWEEP, noise: float = 0.05) -> Record:
    sensor = Sensor(noise=noise)
    blocks = list(
        Simulator(
            SOFT, drive, model=MODELS[model], parameters=truth, sample_rate=1000.0, seed=3,
            body_sensor=sensor, spool_sensor=sensor,
        ).records(6.0)
    )  # fmt: skip
    body, spool = (
        np.concatenate([getattr(one, channel) for one in blocks]).astype(np.float64)
        for channel in ("body", "spool")
    )
    return Record("simulated", blocks[0].stamp, blocks[0].sample_period, body, spool)


def checked(data: Record, model: str, settings: FitSettings = CHECKED) -> Fit:
    found = fit([data], MODELS[model], SOFT, settings)
    assert found.reason is None
    return found


def test_the_check_leaves_the_numbers_of_a_good_record_as_they_are() -> None:
    data = record("coulomb", {"coulomb_force": 0.4})
    found = checked(data, "coulomb")
    plain = fit([data], MODELS["coulomb"], SOFT, replace(CHECKED, check=False))
    assert found.parameters == plain.parameters
    assert found.values == plain.values
    assert sentences(found.determinations) == [
        "The record determines: spring stiffness, viscous coefficient, coulomb force.",
        "mass: known only together with spring stiffness, viscous coefficient, coulomb force; "
        "held at 0.1800 kg",
    ]


@pytest.mark.parametrize("drive", [SWEEP, TONE], ids=["sweep", "one frequency"])
def test_stiffness_and_mass_are_known_only_together(drive: Excitation) -> None:
    """A fit that frees the mass has no residual and any mass: it is held at the data sheet's."""
    data = record("fluid", {}, drive, noise=1e-9)
    settings = replace(CHECKED, free=("mass",), start={"mass": 18.0})
    held = checked(data, "fluid", settings)
    assert held.values["mass"] == SOFT.moving_mass
    assert held.parameter("spring_stiffness").value == pytest.approx(SOFT.spring_stiffness, rel=1e-3)
    assert "mass: known only together with spring stiffness, viscous coefficient; held at 0.1800 kg" in (
        sentences(held.determinations)
    )
    free = checked(data, "fluid", replace(settings, force_free=True))
    assert math.isnan(free.parameter("mass").value)
    assert math.isnan(free.parameter("spring_stiffness").value)
    ratio = free.parameter("spring_stiffness/mass")
    assert ratio.value == pytest.approx(SOFT.spring_stiffness / SOFT.moving_mass, rel=1e-3)


def test_friction_started_at_its_bound_is_found_and_the_move_is_reported() -> None:
    data = record("coulomb", {"coulomb_force": 0.4})
    found = checked(data, "coulomb", replace(CHECKED, start={"coulomb_force": 0.0}))
    assert found.parameter("coulomb_force").value == pytest.approx(0.4, rel=0.01)
    assert "coulomb_force: the start value 0 N lies at its bound" in found.warnings[0]


def test_friction_that_is_not_there_is_bounded_on_one_side() -> None:
    found = checked(record("fluid", {}, noise=0.5), "coulomb")
    one = next(one for one in found.determinations if one.name == "coulomb_force")
    assert one.verdict == "one-sided"
    assert one.low is None
    assert one.high is not None
    assert 0.0 < one.high < 0.05


@pytest.mark.parametrize("force", [1.6, pytest.param(3.0, marks=pytest.mark.slow), 8.0])
def test_friction_that_holds_the_spool_is_at_least_as_large_as_the_force_on_it(force: float) -> None:
    data = record("coulomb", {"coulomb_force": force})
    found = checked(data, "coulomb")
    largest = SOFT.moving_mass * float(np.abs(data.spool).max())
    friction = next(one for one in found.determinations if one.name == "coulomb_force")
    assert (friction.verdict, friction.high) == ("one-sided", None)
    assert friction.low == pytest.approx(largest, rel=0.05)
    assert math.isnan(found.parameter("coulomb_force").value)
    assert all(one.lost for one in found.determinations if one.name != "coulomb_force")


def test_friction_at_rest_that_holds_the_spool_is_bounded_below_and_nothing_else_is_known() -> None:
    data = record("stribeck", {"coulomb_force": 3.0, "static_force": 4.0})
    judged = {one.name: one for one in checked(data, "stribeck").determinations}
    friction = judged.pop("static_force")
    assert (friction.verdict, friction.high) == ("one-sided", None)
    assert friction.low == pytest.approx(SOFT.moving_mass * float(np.abs(data.spool).max()), rel=0.05)
    assert all(one.lost for one in judged.values())


@pytest.mark.parametrize("force", [1.35, pytest.param(1.42, marks=pytest.mark.slow)])
def test_a_spool_that_hardly_breaks_loose_gives_no_bound_that_excludes_its_friction(force: float) -> None:
    found = checked(record("coulomb", {"coulomb_force": force}), "coulomb")
    for one in found.determinations:
        truth = {"coulomb_force": force, "viscous_coefficient": 8.2033}.get(one.name, 1632.0)
        if not one.lost:
            assert (one.low or 0.0) <= truth <= (one.high or math.inf)


def test_a_stop_that_is_not_reached_lies_at_least_as_far_as_the_spool_came() -> None:
    data = record("fluid", {})
    found = checked(data, "fluid_end_stop")
    run = FreeRun([data], MODELS["fluid"], SOFT)
    (response,) = run.responses(run.sets(MODELS["fluid"].values_for(SOFT)))
    reach = float(np.abs(response.displacement).max())
    one = next(one for one in found.determinations if one.name == "stop_gap")
    assert (one.verdict, one.high) == ("one-sided", None)
    assert one.low == pytest.approx(reach, rel=0.05)
    stiffness = next(one for one in found.determinations if one.name == "stop_stiffness")
    assert stiffness.verdict == "not identifiable"
    assert found.values["stop_stiffness"] == stiffness.held_at == 1e6


@compiled
def idle() -> float:
    return 0.0


#: A term whose law does not use its parameter.
IDLE = Term(
    name="idle",
    parameters=(Parameter("idle_number", "N", 0.0, 10.0, 1.0, "not used"),),
    law="F = 0",
    source="",
    meaning="nothing",
    check="nothing",
    force_law=idle,
)


def test_a_parameter_that_the_law_does_not_use_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TERMS, "idle", IDLE)
    model = Model("idle", (*MODELS["fluid"].terms, IDLE))
    with pytest.raises(InputError, match="idle_number: a change of it changes no sample"):
        fit([record("fluid", {})], model, SOFT, CHECKED)


def test_a_fit_that_reaches_its_limit_of_work_says_so_and_judges_no_unfinished_profile() -> None:
    data = record("fluid", {}, noise=0.5)
    told: list[float] = []
    whole = fit([data], MODELS["coulomb"], SOFT, CHECKED, told.append)
    assert not whole.stopped_early
    # Half of the allowance is for the fit that holds what is not determined.
    first, few = (fit([data], MODELS["coulomb"], SOFT, replace(CHECKED, allowed=share * sum(told)))
                  for share in (1.6, 0.02))  # fmt: skip
    for one in (first, few):
        assert one.reason is None
        assert one.stopped_early
        assert "reached its limit of work and stopped early" in one.warnings[-1]
        friction = next(own for own in one.determinations if own.name == "coulomb_force")
        assert friction.verdict == "undecided"
        assert friction.sentence == "coulomb force: not judged, its profile could not be finished"
    assert first.parameter("spring_stiffness").value == whole.parameter("spring_stiffness").value
    assert not few.converged


def test_friction_of_bristles_that_is_not_there_is_known_only_together_with_the_spring() -> None:
    """Soft bristles of any force act as a spring beside that of the valve."""
    found = checked(record("fluid", {}, noise=0.01), "fluid_presliding_friction")
    force, stiffness = found.determinations[2:4]
    assert force.verdict == "only together"
    assert "spring_stiffness" in force.together_with
    assert stiffness.lost
    assert found.values["dahl_force"] < 1e-3
    assert found.agreement is not None
    assert found.agreement.nrmse < 0.01


def test_a_fit_that_ends_beside_motions_that_diverge_says_so_in_one_line() -> None:
    stiff = replace(CHECKED, held={"dahl_stiffness": 1e7, "dahl_force": 1e-3})
    found = fit([record("fluid", {})], MODELS["fluid_presliding_friction"], SOFT, stiff)
    assert found.reason is not None
    assert "the motion of model 'fluid_presliding_friction' diverges near spring_stiffness" in found.reason
