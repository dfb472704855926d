"""Contract of the catalogue: every effect that discovery finds says, moves and is found as it must."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_gap.catalogue import EFFECTS, effect
from spool_gap.effect import Effect, Motion, Scale
from spool_gap.likelihood.kernel import motions_for
from spool_gap.report import named
from spool_sim.integration.composed_motion import ComposedMotion, MotionState
from spool_sim.model import MODELS
from spool_sim.terms import term

CONTRACT = {
    "coulomb_friction", "stribeck_friction", "mixed_friction", "asymmetric_friction", "presliding_friction",
    "quadratic_damping", "cubic_stiffness", "end_stop", "spring_backlash", "spring_preload", "periodic_force",
    "constant_force", "damping_drift", "spool_gain_error", "spool_delay", "sensor_saturation",
}  # fmt: skip
FORCES = sorted(name for name, entry in EFFECTS.items() if entry.terms)
#: Coefficients of signatures, where 1 is not a sensible one.
COEFFICIENTS = {
    "coulomb_friction": [0.5], "stribeck_friction": [0.3, 0.2], "mixed_friction": [0.4, 0.01],
    "presliding_friction": [0.5], "quadratic_damping": [18.0], "cubic_stiffness": [5e7],
    "spring_backlash": [1632.0], "spring_preload": [0.4], "periodic_force": [0.3, 0.1],
    "constant_force": [0.7], "damping_drift": [-0.2], "asymmetric_friction": [0.5, 0.1],
}  # fmt: skip
PERIOD = 1e-4


@pytest.fixture(scope="module")
def motion() -> Motion:
    time = np.arange(0.0, 1.0, PERIOD)
    turn = 2.0 * np.pi * 15.0
    z = 1e-3 * (1.0 + 0.5 * np.sin(2.0 * np.pi * time)) * np.sin(turn * time)
    v, a = np.gradient(z, PERIOD), np.gradient(np.gradient(z, PERIOD), PERIOD)
    return Motion(z, v, a, time, PERIOD, 1e-6, 0.18, 1632.0, 4.0, (47.0,))


def test_every_effect_of_the_contract_is_there() -> None:
    assert set(EFFECTS) >= CONTRACT


def test_an_unknown_effect_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"unknown effect 'rust'.*coulomb_friction"):
        effect("rust")


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_says_what_a_reader_needs(name: str) -> None:
    entry = EFFECTS[name]
    assert entry.id == name
    assert entry.law
    assert entry.on_the_machine
    assert entry.to_check
    assert entry.distinguished_by
    assert entry.fitted
    assert set(entry.confusable_with) | set(entry.replaces) <= set(EFFECTS)
    assert set(entry.amplitudes) <= set(entry.fitted)
    assert [number.name for number in entry.numbers] == list(dict.fromkeys(n.name for n in entry.numbers))
    for number in entry.numbers:
        assert number.unit
        assert number.meaning
        assert number.low <= number.start <= number.high
    assert {parameter.name for law in entry.terms for parameter in term(law).parameters} >= (
        set(entry.fitted) if entry.terms else set()
    )


def test_the_sentence_says_of_every_effect_what_it_is_on_the_machine_and_what_to_check() -> None:
    sentence = named([(name, ()) for name in EFFECTS], 0.5, 0.1, 0.05, "the force")
    told = (text for entry in EFFECTS.values() for text in (entry.on_the_machine, entry.to_check))
    assert [text for text in told if text not in sentence] == []


@pytest.mark.parametrize("name", FORCES)
def test_a_signature_is_a_finite_force_and_some_coefficients_make_sense(name: str, motion: Motion) -> None:
    entry = EFFECTS[name]
    shapes = entry.shapes(motion)
    assert shapes
    for shape in shapes:
        columns = entry.signature(motion, shape)
        assert columns.shape[1] == motion.time.size
        assert np.isfinite(columns).all()
        sensible = [
            entry.values(np.full(columns.shape[0] - bool(entry.changes), sign), shape, motion)
            for sign in (1.0, -1500.0)
        ]
        assert any(values is not None for values in sensible)


@pytest.mark.parametrize("name", [name for name in FORCES if name != "end_stop"])
def test_the_signature_is_the_law_of_the_simulator(name: str, motion: Motion) -> None:
    """Of an end stop the signature is the elastic part alone."""
    entry = EFFECTS[name]
    shapes = entry.shapes(motion)
    shape = shapes[len(shapes) // 2 - len(shapes) // 2 % 2]
    columns = entry.signature(motion, shape)
    coefficients = COEFFICIENTS.get(name, np.ones(columns.shape[0]))
    values = entry.values(np.array([] if entry.changes else coefficients), shape, motion)
    assert values is not None
    own = np.array(coefficients) @ columns
    law = _force(entry, values, motion)
    # Reversals within a sample are softened in the signature: judged is the motion between them.
    between = np.abs(motion.sign) == 1.0
    assert between.mean() > 0.9
    assert np.sqrt(np.mean((own - law)[between] ** 2)) < 0.01 * np.sqrt(np.mean(law**2))


def _force(entry: Effect, values: dict[str, float], motion: Motion) -> NDArray[np.float64]:
    names = [parameter.name for law in entry.terms for parameter in term(law).parameters]
    usual = {"spring_stiffness": motion.stiffness, "viscous_coefficient": motion.damping}
    given = {p.name: p.start for law in entry.terms for p in term(law).parameters} | usual | values
    assert set(values) <= set(names)
    return np.asarray(
        term(entry.terms[0]).force(
            motion.displacement, motion.velocity, motion.acceleration, given, motion.time
        )
    )


@pytest.mark.parametrize("name", [name for name in FORCES if EFFECTS[name].searched])
def test_fits_begin_from_several_sizes_within_the_bounds(name: str) -> None:
    entry, seconds = EFFECTS[name], 20.0
    guesses = entry.guesses(Scale(0.7, 1.5e-3, 0.12, seconds, ((47.0, 0.1, 0.3), (61.0, 0.05, 2.0))))
    first = (entry.amplitudes or entry.fitted)[0]
    assert len({abs(guess[first]) for guess in guesses}) > 1
    for guess in guesses:
        assert set(guess) >= set(entry.amplitudes)
        bounds = {one.name: (one.low, one.high) for one in entry.unknowns(guess, seconds)}
        assert set(bounds) <= {parameter.name for parameter in entry.numbers}
        for number in set(bounds) & set(guess):
            assert bounds[number][0] <= guess[number] <= bounds[number][1]


@pytest.mark.parametrize("name", FORCES)
def test_the_switched_kernel_moves_the_spool_as_a_kernel_of_its_own(name: str) -> None:
    laws = (*(entry.name for entry in MODELS["fluid"].terms), *EFFECTS[name].terms)
    alone = ComposedMotion([term(law) for law in laws])
    values = {p.name: p.start for p in alone.parameters} | {"mass": 0.18, "viscous_coefficient": 4.0}
    rate, substeps, samples = 2000.0, 4, 400
    time = np.arange(2 * samples * substeps + 1) / (2.0 * substeps * rate)
    excitation = 12.0 * np.sin(2.0 * np.pi * (10.0 * time + 20.0 * time**2))
    options = {"sample_period": 1.0 / rate, "substeps": substeps}
    expected, _ = alone.advance(MotionState(), excitation, alone.table(values, samples), **options)
    switched = next(motion for motion in motions_for(MODELS["fluid"]) if motion.has(laws))
    found, _ = switched.advance(MotionState(), excitation, switched.row(laws, values)[np.newaxis], **options)
    np.testing.assert_allclose(found.displacement, expected.displacement, rtol=1e-9, atol=1e-15)
