from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_estimator.identification.determination import sentences
from spool_gap.catalogue.friction import dahl_state, slider_state
from spool_gap.report import result_to_dict
from spool_gap.result import GapSettings
from spool_rigs.analyse import TriedForces, analyse_forces, decide, probabilities
from spool_rigs.balance import ForceBalance, ForceFit
from spool_rigs.records import ForceRecord
from spool_rigs.result import check_one_mass, determined
from spool_sim.model import MODELS

PERIOD = 0.005


def rig(seed: int, seconds: float = 12.0) -> tuple[Array, Array, Array]:
    time = np.arange(0.0, seconds, PERIOD)
    place = np.zeros(time.size)
    phases = np.random.default_rng(seed).uniform(0.0, 6.28, 3)
    for frequency, amplitude, phase in zip((0.4, 0.9, 1.7), (6e-3, 3e-3, 1e-3), phases, strict=True):
        place += amplitude * np.sin(2.0 * np.pi * frequency * time + phase)
    return time, place, np.gradient(place, PERIOD)


def forced(
    seed: int, extra: Array, damping: float = 900.0, sign: float = 1.0, zero: float = 20.0
) -> ForceRecord:
    time, place, speed = rig(seed)
    noise = 0.4 * np.random.default_rng(seed + 100).standard_normal(time.size)
    return ForceRecord(
        "rig", 0.0, PERIOD, place, zero + sign * (damping * speed + 800.0 * place + extra) + noise
    )


def test_hysteretic_friction_is_named_though_the_rig_counts_the_other_way() -> None:
    records = [forced(seed, 30.0 * dahl_state(rig(seed)[1], 2e-4), sign=-1.0) for seed in (1, 2)]
    result = analyse_forces(records[:1], MODELS["fluid"], "imposed", holdout=records[1:])
    assert result.verdict == "presliding_friction"
    force = next(q for q in result.effects[0].parameters if q.name == "dahl_force")
    assert force.value == pytest.approx(30.0, rel=0.05)
    assert result.after.nrmse < 0.3 * result.before.nrmse
    json.dumps(result_to_dict(result), allow_nan=False)


def test_coulomb_friction_is_named() -> None:
    speed = rig(3)[2]
    result = analyse_forces([forced(3, 15.0 * np.sign(speed))], MODELS["fluid"], "imposed")
    assert result.verdict == "coulomb_friction"


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("zero", [-1e5, 0.0, 1e5])
@pytest.mark.parametrize("way", [-0.02, 0.02])
def test_the_rig_s_sign_of_force_is_found_whatever_its_zero_and_where_the_motion_ends(
    sign: float, zero: float, way: float
) -> None:
    time, place, speed = rig(1)
    place, speed = place + way * time / time[-1], speed + way / time[-1]
    record = ForceRecord("rig", 0.0, PERIOD, place, zero + sign * 900.0 * speed)
    assert ForceBalance([record], [record], ("damping", "zero")).sign == sign


def test_the_error_while_it_slides_is_a_share_whatever_the_unit_of_force() -> None:
    found = []
    for unit in (1.0, 1000.0):
        records = [replace(one, force=unit * one.force) for one in (forced(1, 30.0), forced(2, 20.0))]
        balance = ForceBalance(records[:1], records[1:], ("damping", "zero"))
        found.append(balance.sliding_error(balance.fit([])))
    assert found[1] == pytest.approx(found[0])


def test_nothing_is_named_where_nothing_is_missing() -> None:
    result = analyse_forces([forced(4, np.zeros(rig(4)[0].size))], MODELS["fluid"], "imposed")
    assert result.verdict == "none"


def test_the_mass_is_found_where_a_force_drives_it() -> None:
    time, place, speed = rig(5)
    force = 40.0 * np.gradient(speed, PERIOD) + 300.0 * speed + 900.0 * place + 2e7 * place**3
    force = force + 0.1 * np.random.default_rng(5).standard_normal(time.size)
    result = analyse_forces([ForceRecord("rig", 0.0, PERIOD, place, force)], MODELS["fluid"], "driven")
    mass = next(q for q in result.parameters if q.name == "mass")
    assert mass.value == pytest.approx(40.0, rel=0.05)
    assert result.verdict == "cubic_stiffness"


def tones(*frequencies: float, noise: float) -> ForceRecord:
    """Return the record of 40 kg on 900 N/m with 300 N s/m, driven at ``frequencies``, Hz."""
    time = np.arange(0.0, 24.0, PERIOD)
    omegas = 2.0 * np.pi * np.array(frequencies)[:, np.newaxis]
    place = 5e-3 * np.sin(omegas * time).sum(axis=0)
    speed = 5e-3 * (omegas * np.cos(omegas * time)).sum(axis=0)
    force = 300.0 * speed + 5e-3 * ((900.0 - 40.0 * omegas**2) * np.sin(omegas * time)).sum(axis=0)
    generator = np.random.default_rng(1)
    place = place + noise * generator.standard_normal(time.size)
    return ForceRecord("rig", 0.0, PERIOD, place, force + 0.1 * generator.standard_normal(time.size))


@pytest.mark.parametrize("noise", [0.0, 1e-6, 2e-5])
@pytest.mark.parametrize("frequency", [0.5, 1.7])
def test_one_frequency_shows_stiffness_and_mass_only_together(frequency: float, noise: float) -> None:
    """Force in phase: (k - m w^2) z, below and above the resonance of 0.75 Hz."""
    record = tones(frequency, noise=noise)
    with pytest.raises(
        InputError, match=r"mass: known only together with .*spring stiffness; state the mass"
    ):
        analyse_forces([record], MODELS["fluid"], "driven")
    for mass in (40.0, 60.0):
        given = ForceBalance([record], [record], ("damping", "stiffness", "zero"), driven=True, mass=mass)
        assert not check_one_mass(given, MODELS["fluid"], "rig")
        assert sentences(determined(given, MODELS["fluid"], given.fit([]))) == [
            "The record determines: viscous coefficient, spring stiffness."
        ]


def test_two_frequencies_determine_stiffness_and_mass() -> None:
    result = analyse_forces([tones(0.5, 1.7, noise=1e-6)], MODELS["fluid"], "driven")
    assert result_to_dict(result)["determined"].keys() == {"viscous_coefficient", "spring_stiffness", "mass"}
    assert {one.verdict for one in result.determinations} == {"identifiable"}
    values = {one.name: one.value for one in result.parameters}
    assert values["mass"] == pytest.approx(40.0, rel=0.01)
    assert values["spring_stiffness"] == pytest.approx(900.0, rel=0.02)


@pytest.mark.parametrize("half", [1e-3, 4e-3])
def test_a_slider_behind_play_is_named_with_its_play(half: float) -> None:
    """Plays from a tenth of the stroke to half of it; the drive moves 1 cm to either side."""
    records = [forced(seed, 60.0 * slider_state(rig(seed)[1], half, 2e-4)) for seed in (1, 2)]
    result = analyse_forces(records[:1], MODELS["fluid"], "imposed", holdout=records[1:])
    assert result.verdict == "play_friction"
    (found,) = result.effects
    values = {one.name: one for one in found.parameters}
    assert values["slider_force"].value == pytest.approx(60.0, rel=1e-3)
    assert values["slider_play"].value == pytest.approx(half, rel=1e-3)
    assert values["slider_stiffness"].value == pytest.approx(3e5, rel=0.01)
    for name, true in {"slider_play": half, "slider_stiffness": 3e5}.items():
        assert abs(values[name].value - true) < 3.0 * values[name].standard_deviation


def test_a_name_that_closes_little_beside_an_unknown_force_is_none() -> None:
    """A force of another machine beside a hardening spring."""
    rows = []
    for seed in (3, 4):
        noise = gaussian_filter1d(np.random.default_rng(seed).standard_normal(rig(seed)[1].size), 12.0)
        rows.append(forced(seed, 1.2e8 * rig(seed)[1] ** 3 + 15.0 * noise / float(np.std(noise))))
    result = analyse_forces(rows[:1], MODELS["fluid"], "imposed", holdout=rows[1:])
    assert result.verdict == "unexplained"
    assert result.candidates == ("cubic_stiffness",)
    assert result.after.nrmse == result.before.nrmse
    first, other = result.explanations
    assert first.effects == ("unexplained",)
    assert other.effects == ("cubic_stiffness",)
    assert first.probability >= other.probability


def test_a_spring_that_pushes_outward_is_remarked_and_judged_beside_the_friction() -> None:
    """A negative stiffness: the record determines what the reported model has, and a warning names it."""
    time, place, speed = rig(1)
    force = 900.0 * speed - 800.0 * place + 60.0 * np.sign(speed)
    force += 0.4 * np.random.default_rng(9).standard_normal(time.size)
    record = ForceRecord("rig", 0.0, PERIOD, place, force)
    result = analyse_forces([record], MODELS["fluid"], "imposed")
    assert [line for line in result.warnings if "spring stiffness" in line and "on no machine" in line]
    (stiffness,) = [one for one in result.determinations if one.name == "spring_stiffness"]
    assert stiffness.low < -800.0 < stiffness.high < 0.0


@pytest.mark.slow
def test_a_driven_mass_with_mixed_friction_ends_in_a_result() -> None:
    time, place, speed = rig(7)
    size = np.abs(speed) / 0.01
    friction = np.sign(speed) * (6.0 * np.sqrt(size) + 4.0 / (size + 0.05))
    force = 40.0 * np.gradient(speed, PERIOD) + 100.0 * speed + 900.0 * place + friction
    force = force + 0.1 * np.random.default_rng(7).standard_normal(time.size)
    result = analyse_forces([ForceRecord("rig", 0.0, PERIOD, place, force)], MODELS["fluid"], "driven")
    assert result.after.nrmse < 0.5 * result.before.nrmse


def probability_of(tried: list[TriedForces], effects: frozenset[str]) -> float:
    shares = probabilities(tried, effects)
    assert sum(shares.values()) == pytest.approx(0.9)
    assert max(shares.values()) == shares[effects]
    return shares[effects]


def tried(before: TriedForces | None, error: float, *names: str) -> TriedForces:
    """Return a set of effects of one number each that leaves ``error``, white over 1000 samples."""
    numbers, held = np.ones(len(names)), error * np.random.default_rng(1).standard_normal(1000)
    fit = ForceFit(names, ({},) * len(names), names, numbers, numbers, (), (held,), 1.0)
    return TriedForces((), fit, error, before)


def test_the_best_single_effect_need_not_be_in_the_best_set() -> None:
    base = tried(None, 0.5)
    drag, spring = (tried(base, *one) for one in ((0.2, "quadratic_damping"), (0.25, "cubic_stiffness")))
    pair = tried(spring, 0.05, "cubic_stiffness", "coulomb_friction")
    assert decide([base, drag, spring, pair]) is pair
    assert 0.85 < probability_of([base, drag, spring, pair], pair.effects) <= 0.9


def test_a_second_effect_needs_evidence_and_the_same_set_counts_alike_by_any_path() -> None:
    base = tried(None, 0.5)
    drag, spring = (tried(base, *one) for one in ((0.2, "quadratic_damping"), (0.25, "cubic_stiffness")))
    both = tried(spring, 0.1995, "cubic_stiffness", "quadratic_damping")
    sets = [base, drag, spring, both]
    assert decide(sets) is drag
    assert probability_of(sets, drag.effects) < probability_of(sets[:3], drag.effects)


@pytest.mark.parametrize(("error", "kept"), [(0.22, True), (0.24, False)])
def test_a_plain_law_stays_where_a_richer_one_leaves_hardly_less(error: float, kept: bool) -> None:
    base = tried(None, 0.5)
    plain, rich = tried(base, error, "coulomb_friction"), tried(base, 0.2, "presliding_friction")
    assert decide([base, plain, rich]) is (plain if kept else rich)
    if kept:
        equal = tried(base, 0.2, "coulomb_friction")
        sure, surest = (probability_of([base, one, rich], plain.effects) for one in (plain, equal))
        assert sure < 0.75 * surest


@pytest.mark.parametrize("effect", [pytest.param("spring_backlash", marks=pytest.mark.slow), "damping_drift"])
def test_effects_that_share_numbers_with_the_base_keep_the_fitted_ones(effect: str) -> None:
    time, place, speed = rig(9, 24.0)
    if effect == "spring_backlash":
        force = 900.0 * speed + 5e4 * (np.abs(place) > 2e-3) * (place - 2e-3 * np.sign(place))
    else:
        force = 900.0 * speed * (1.0 - 0.03 * time) + 800.0 * place
    force += 0.4 * np.random.default_rng(9).standard_normal(time.size)
    result = analyse_forces([ForceRecord("rig", 0.0, PERIOD, place, force)], MODELS["fluid"], "imposed")
    assert effect in result.verdict
    assert result.model is not None
    fitted = {one.name: one.value for one in result.parameters}
    for name in ("spring_stiffness", "viscous_coefficient"):
        assert result.model.values[name] == pytest.approx(fitted[name])


def stick_slip(rate: float, speed: float, seconds: float = 24.0) -> ForceRecord:
    """Return the record of a slider of 30 g that a spring of 2254 N/m pulls along: it sticks and jumps on."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    pulled = speed * time
    jump = 2.0 * (1.2 - 0.6) / 2254.0
    place = jump * np.floor(pulled / jump)
    noise = np.random.default_rng(8).standard_normal((2, time.size))
    force = 2254.0 * (pulled - place) + 0.02 * noise[0]
    return ForceRecord("slider", 0.0, 1.0 / rate, place + 1e-6 * noise[1], force)


@pytest.mark.parametrize("mass", [None, 0.03])
@pytest.mark.parametrize(("rate", "speed"), [(200.0, 0.002), (500.0, 0.0005)])
def test_a_driven_mass_that_sticks_nearly_throughout_is_refused(
    rate: float, speed: float, mass: float | None
) -> None:
    with pytest.raises(InputError, match="sticks in the others: too few to balance its forces"):
        analyse_forces([stick_slip(rate, speed)], MODELS["fluid"], "driven", mass=mass)


def test_imposed_stick_slip_is_nothing_that_the_catalogue_knows() -> None:
    result = analyse_forces([stick_slip(200.0, 0.002)], MODELS["fluid"], "imposed")
    assert "unexplained" in result.verdict
    assert result.after.nrmse <= result.before.nrmse
    json.dumps(result_to_dict(result), allow_nan=False)


def test_one_speed_cannot_tell_viscous_from_coulomb_friction() -> None:
    time = np.arange(0.0, 24.0, PERIOD)
    place = 0.02 * np.abs((time / 4.0) % 2.0 - 1.0)
    speed = np.gradient(place, PERIOD)
    force = 800.0 * speed + 5.0 * np.sign(speed) + 0.1 * np.random.default_rng(6).standard_normal(time.size)
    result = analyse_forces([ForceRecord("rig", 0.0, PERIOD, place, force)], MODELS["fluid"], "imposed")
    assert result.verdict == "unexplained"
    assert any("cannot be distinguished" in line for line in result.warnings)
    assert {"viscous_friction", "coulomb_friction"} <= set(result.candidates)


def test_a_record_in_which_nothing_moves_is_refused() -> None:
    still = ForceRecord("rig", 0.0, PERIOD, np.zeros(4000), np.ones(4000))
    with pytest.raises(InputError, match="displacement_m does not change"):
        analyse_forces([still], MODELS["fluid"], "imposed")


def test_numbers_that_differ_between_two_records_are_reported() -> None:
    """One friction of 15 N, one of 20 N, and another zero of the load cell."""
    one = forced(3, 15.0 * np.sign(rig(3)[2]))
    other = forced(5, 20.0 * np.sign(rig(5)[2]), zero=30.0)
    (line,) = _differing([one], [other])
    assert "coulomb force" in line
    assert "force zero" in line
    assert "viscous" not in line
    same = forced(5, 15.0 * np.sign(rig(5)[2]))
    assert _differing([one], [same]) == []


def _differing(records: list[ForceRecord], holdout: list[ForceRecord]) -> list[str]:
    result = analyse_forces(records, MODELS["fluid"], "imposed", holdout=holdout)
    return [line for line in result.warnings if line.startswith("no parameters fit all records")]


def test_a_load_cell_s_record_tells_which_of_its_numbers_it_determines() -> None:
    """A rig at two speeds of one sign of slip knows a force, and not the speed at which friction falls."""
    time = np.arange(0.0, 24.0, 2e-3)
    draw = np.random.default_rng(3)
    place = 0.02 * np.sin(2.0 * np.pi * 0.5 * time) + 0.004 * np.sin(2.0 * np.pi * 2.3 * time)
    speed = np.gradient(place, time)
    force = 6.0 * speed + 800.0 * place + 0.7 * np.sign(speed) + 0.02 * draw.standard_normal(time.size)
    result = analyse_forces(
        [ForceRecord("rig", 0.0, 2e-3, place, force)], MODELS["fluid"], "imposed",
        settings=GapSettings(profiles=True),
    )  # fmt: skip
    assert "coulomb_friction" in result.verdict
    profile = next(one for one in result.profiles if one.name == "coulomb_force")
    assert profile.verdict == "identifiable"
    assert profile.low is not None
    assert profile.high is not None
    assert 0.68 < profile.low < profile.high < 0.72
