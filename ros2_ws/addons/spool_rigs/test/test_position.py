"""A driven mass is followed by its position: from the force alone, to small forces that add up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_gap.catalogue import EFFECTS
from spool_gap.result import GapSettings, RankedHypothesis
from spool_rigs import analyse as workflow
from spool_rigs.analyse import analyse_forces, searched
from spool_rigs.balance import ForceBalance, ForceFit
from spool_rigs.position import Chosen, cross_validated, position_rmse, position_run, speed_at
from spool_rigs.records import ForceRecord
from spool_sim.model import MODELS, Model
from spool_sim.terms import term

PERIOD, MASS, DRAG = 1e-3, 50.0, 120.0
TIME = PERIOD * np.arange(24_000)
AXIS = Model("axis", (term("inertia"), term("viscous_friction")), {"mass": MASS, "viscous_coefficient": DRAG})
FORCE = sum(70.0 * np.sin(2.0 * np.pi * frequency * TIME) for frequency in (0.41, 0.83, 1.37, 2.1))


def driven(model: Model, push: float = 0.0, noise: float = 0.0) -> ForceRecord:
    """Return the record of a mass from rest under ``FORCE`` and a constant ``push``, N."""
    still = ForceRecord("axis", 0.0, PERIOD, np.zeros(TIME.size), FORCE)
    place = position_run(still, (0.0, 0.0), model, -push)
    force = FORCE + noise * np.random.default_rng(3).standard_normal(TIME.size)
    return ForceRecord("axis", 0.0, PERIOD, place, force)


def test_a_constant_force_moves_a_mass_as_its_closed_form() -> None:
    record = ForceRecord("axis", 0.0, PERIOD, np.zeros(TIME.size), np.full(TIME.size, 24.0))
    place = position_run(record, (0.0, 0.0), AXIS, 0.0)
    constant = MASS / DRAG
    exact = 24.0 / DRAG * (TIME + constant * np.expm1(-TIME / constant))
    np.testing.assert_allclose(place, exact, atol=1e-6)


def test_a_run_starts_with_the_velocity_that_the_record_has() -> None:
    record = ForceRecord("axis", 0.0, PERIOD, 0.02 * TIME + 0.3 * TIME**2, np.zeros(TIME.size))
    assert speed_at(record, 0) == pytest.approx(0.02, abs=1e-9)
    assert speed_at(record, 1000) == pytest.approx(0.62, abs=1e-9)


@pytest.mark.slow
def test_coulomb_friction_and_a_constant_force_are_named_and_the_position_is_followed() -> None:
    hidden = Model("hidden", (*AXIS.terms, term("coulomb_friction")), {**AXIS.values, "coulomb_force": 20.0})
    result = analyse_forces([driven(hidden, -4.0, 0.5)], MODELS["fluid"], "driven")
    assert set(result.verdict.split("+")) - {"unexplained"} == {"coulomb_friction", "constant_force"}
    numbers = {quantity.name: quantity.value for quantity in result.parameters}
    assert numbers["mass"] == pytest.approx(MASS, rel=0.02)
    assert numbers["coulomb_force"] == pytest.approx(20.0, rel=0.05)
    assert numbers["push"] == pytest.approx(-4.0, rel=0.05)
    assert "spring_stiffness" not in numbers
    assert result.after.position_rmse < 0.02 * result.before.position_rmse


@pytest.mark.parametrize("stiffness", [0.0, 20.0])
def test_a_force_that_wanders_over_seconds_is_no_spring_and_hides_no_spring(stiffness: float) -> None:
    """A free run alone takes 2 N that the load cell does not measure for a spring of 9 ± 4 N/m."""
    terms = (*AXIS.terms, term("coulomb_friction"), term("spring"))
    hidden = Model("hidden", terms, {**AXIS.values, "coulomb_force": 20.0, "spring_stiffness": stiffness})
    generator = np.random.default_rng(0)
    knots = np.arange(0.0, 27.0, 3.0)
    wanders = np.interp(TIME, knots, 2.0 * generator.standard_normal(knots.size))
    still = ForceRecord("axis", 0.0, PERIOD, np.zeros(TIME.size), FORCE + wanders)
    place = position_run(still, (0.0, 0.0), hidden, 0.0)
    force = FORCE + 0.5 * generator.standard_normal(TIME.size)
    record = ForceRecord("axis", 0.0, PERIOD, place, force)
    result = analyse_forces(
        [record], MODELS["fluid"], "driven", holdout=[record], mass=MASS, settings=GapSettings(most_effects=0)
    )
    assert ("spring_stiffness" in {quantity.name for quantity in result.parameters}) == (stiffness > 0.0)


@pytest.mark.parametrize("push", [-4.0, -6.0])
def test_a_constant_force_differs_between_records_only_beyond_its_interval(push: float) -> None:
    fitted, held = part(driven(AXIS, -4.0, 0.5), 0, 8000), part(driven(AXIS, push, 0.5), 8000, 16_000)
    result = analyse_forces(
        [fitted], MODELS["fluid"], "driven", holdout=[held], mass=MASS, settings=GapSettings(most_effects=0)
    )
    assert "constant_force" in result.verdict
    differing = [line for line in result.warnings if line.startswith("no parameters fit all records")]
    assert len(differing) == (push != -4.0)
    assert all("force zero 4.0" in line and "against 6.0" in line for line in differing)
    assert not any("± 0 " in line for line in result.warnings)


def test_the_zero_that_friction_by_direction_takes_for_itself_is_not_taken_off_the_force(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both directions of friction and the zero are two numbers: errors stay shares of one force."""
    monkeypatch.setattr(workflow, "EFFECTS", {"asymmetric_friction": EFFECTS["asymmetric_friction"]})
    hidden = Model("hidden", (*AXIS.terms, term("coulomb_friction")), {**AXIS.values, "coulomb_force": 20.0})
    records = [driven(hidden, -14.0, 2.0)]
    balance = ForceBalance(records, records, ["damping", "zero"], driven=True, mass=MASS)
    base, friction = searched(balance, "driven", 1, lambda _what, _share: None)
    assert friction.error < 0.5 * base.error
    assert friction.nrmse / base.nrmse == pytest.approx(friction.error / base.error)


def hardening(force: Array, seed: int) -> ForceRecord:
    """Return the record of a light mass on a hardening spring (68.6 Hz, 4.7 % of critical damping)."""
    period = 1.0 / 610.35
    values = {
        "mass": 5.38e-3,
        "viscous_coefficient": 0.218,
        "spring_stiffness": 1e3,
        "cubic_coefficient": 4e9,
    }
    terms = [term(name) for name in ("inertia", "viscous_friction", "spring", "cubic_stiffness")]
    still = ForceRecord("box", 0.0, period, np.zeros(force.size), force)
    place = position_run(still, (0.0, 0.0), Model("box", tuple(terms), values), 0.0)
    noise = np.random.default_rng(seed).standard_normal((2, force.size))
    return ForceRecord("box", 0.0, period, place + 1e-7 * noise[0], force + 1e-4 * noise[1])


def test_a_hardening_spring_fitted_to_small_motion_closes_the_gap_of_growing_motion() -> None:
    generator = np.random.default_rng(1)
    lines = np.zeros(3001, dtype=np.complex128)
    lines[1:1960:2] = np.exp(2j * np.pi * generator.uniform(size=980))
    multisine = np.fft.irfft(lines)
    noise = np.zeros(1501, dtype=np.complex128)
    noise[:490] = generator.standard_normal(490) + 1j * generator.standard_normal(490)
    arrow = np.fft.irfft(noise) * np.linspace(0.0, 1.0, 3000)
    fitted, held = (
        hardening(size * row / row.std(), 2) for size, row in ((0.0223, multisine), (0.02, arrow))
    )
    result = analyse_forces([fitted], MODELS["fluid"], "driven", holdout=[held])
    assert "constant_force" not in result.verdict
    assert result.verdict.startswith("cubic_stiffness")
    assert result.after.nrmse < 0.5 * result.before.nrmse


def test_left_out_parts_are_foreseen_by_the_others_and_best_with_the_effect_that_acts() -> None:
    hidden = Model("hidden", (*AXIS.terms, term("coulomb_friction")), {**AXIS.values, "coulomb_force": 20.0})
    records, columns = [driven(hidden, 0.0, 0.5)], ["damping", "mass", "zero"]
    acts: Chosen = ((EFFECTS["coulomb_friction"], {}),)
    without, by = (
        cross_validated(records, columns, chosen, MODELS["fluid"], None, by_position=False)
        for chosen in ((), acts)
    )
    travel = float(np.std(records[0].displacement))
    assert by < 0.5 * without < travel
    assert (
        cross_validated(records, columns[::2], acts, MODELS["fluid"], MASS, by_position=False) < 0.5 * without
    )
    short = [part(records[0], 0, 12_000)]
    assert math.isinf(cross_validated(short, columns, acts, MODELS["fluid"], None))


def part(record: ForceRecord, first: int, stop: int) -> ForceRecord:
    return replace(record, displacement=record.displacement[first:stop], force=record.force[first:stop])


def fitted_axis() -> tuple[ForceBalance, ForceFit]:
    """Return the balance of a driven mass and its fit, to fit and to judge on."""
    parts = [part(driven(AXIS, 0.0, 0.5), low, low + 8000) for low in (0, 8000)]
    balance = ForceBalance(parts[:1], parts[1:], ["damping", "mass", "zero"], driven=True)
    return balance, balance.fit([])


def worse(balance: ForceBalance, fit: ForceFit, chosen: Chosen) -> ForceFit:
    """Return ``fit`` with a drag that is a tenth too large."""
    changed = fit.coefficients.copy()
    changed[0] *= 1.1
    return balance.measured(replace(fit, coefficients=changed), chosen)


def test_an_effect_with_which_the_held_out_error_grows_is_refused_and_named() -> None:
    balance, fit = fitted_axis()
    entry = EFFECTS["constant_force"]
    chosen: Chosen = ((entry, {}),)
    grown = worse(balance, fit, ())
    ranking = [RankedHypothesis(entry.id, (), balance.nrmse(grown), 50.0, {"push": 1.0}, accepted=True)]
    kept, refused = workflow.without_growth(balance, [((), fit), (chosen, grown)], ranking)
    assert kept == [((), fit)]
    assert refused[0].startswith("Refused: constant force; on held-out data the error rises with it, from ")
    assert not ranking[0].accepted
    assert ranking[0].reason == "the error on held-out data rises with it"
    kept, refused = workflow.without_growth(balance, [((), grown), (chosen, fit)], [])
    assert len(kept) == 2
    assert not refused


def test_numbers_that_follow_the_position_are_kept_only_if_both_errors_fall(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    balance, fit = fitted_axis()
    bad = worse(balance, fit, ())
    base = MODELS["fluid"]
    for start, end, kept in ((bad, fit, True), (fit, bad, False), (fit, fit, False)):
        monkeypatch.setattr(workflow, "fitted_by_position", lambda *_given, end=end: end)
        assert (workflow.followed(balance, (), start, base) is end) == kept
    # A force error that grows is not made up for by a position that is followed better.
    monkeypatch.setattr(workflow, "fitted_by_position", lambda *_given: bad)
    places = iter([1e-3, 1e-6])
    monkeypatch.setattr(workflow, "free_run_error", lambda *_given: next(places))
    assert workflow.followed(balance, (), fit, base) is None


def test_a_known_mass_is_not_fitted() -> None:
    record = part(driven(AXIS, 0.0, 0.5), 0, 8000)
    result = analyse_forces([record], MODELS["fluid"], "driven", mass=MASS)
    assert "mass" not in {quantity.name for quantity in result.parameters}
    assert result.model.values["mass"] == MASS


def test_a_free_run_of_a_model_too_stiff_for_the_record_is_not_known() -> None:
    stiff = Model("stiff", AXIS.terms, {"mass": 1e-9, "viscous_coefficient": 1e5})
    assert math.isnan(position_rmse([driven(AXIS)], stiff, 0.0, 0.0))
