"""What is hidden is there, can be seen, and is the same each time."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import spool_blind
from spool_blind.case import (
    CLOSE,
    DISTINCT,
    NONE,
    BlindTrial,
    hidden_by,
    kind_of,
    limit_case,
    make,
    over_coulomb_friction,
)
from spool_blind.hidden import EFFECTS, OUT_OF_CATALOGUE, Hidden
from spool_blind.visibility import look, noncentrality, threshold

SOURCES = sorted(Path(spool_blind.__file__).parent.rglob("*.py"))


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.name)
def test_nothing_of_the_suite_is_shared_but_the_compiler(source):
    names = []
    for node in ast.walk(ast.parse(source.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.append(str(node.module))
    shared = {name for name in names if name.startswith("spool_") and not name.startswith("spool_blind")}
    assert shared <= {"spool_core.kernels.compiled"}


@pytest.mark.parametrize("hidden", [*EFFECTS, *OUT_OF_CATALOGUE])
def test_what_is_hidden_stands_out_of_the_noise(hidden):
    case = make(3, hidden)
    assert case.kind == kind_of(hidden)
    assert case.visibility.over_noise >= 1.0
    assert case.visibility.evidence > 10.0 * case.threshold
    assert np.isfinite(case.body).all()
    assert np.isfinite(case.spool).all()


def test_a_seed_makes_the_same_record_again():
    one, other = make(2), make(2)
    assert one.hidden == NONE
    assert np.array_equal(one.spool, other.spool)
    assert np.array_equal(one.body, other.body)
    assert not np.array_equal(one.spool[:100], make(1).spool[:100])


def test_any_twenty_seeds_in_a_row_hold_every_kind():
    for first in (0, 1000, 1040):
        kinds = [kind_of(hidden_by(seed)) for seed in range(first, first + 20)]
        assert [kinds.count(kind) for kind in ("none", "effect", "pair", "out_of_catalogue")] == [4, 10, 3, 3]
    hidden = {hidden_by(seed) for seed in range(1000, 1200)}
    assert set(EFFECTS) <= hidden
    assert set(OUT_OF_CATALOGUE) <= hidden


def test_with_nothing_hidden_the_base_leaves_only_noise():
    case = make(21)
    condition = case.condition
    rate = condition.sample_rate
    before = round(condition.before * rate)
    whole = np.arange(-before, case.time.size) / rate
    body = condition.amplitude * condition.excitation.at(whole)
    seen = look(case.plant, body, case.spool, rate, first=before, noise=case.channels.noise)
    assert seen.base["stiffness"] == pytest.approx(case.plant["stiffness"], rel=2e-3)
    assert seen.base["damping"] == pytest.approx(case.plant["damping"], rel=1e-2)
    assert seen.nrmse <= 1.05 * seen.noise_nrmse


def test_the_threshold_is_where_half_of_the_records_pass_the_test():
    generator = np.random.default_rng(1)
    evidence = threshold(2)
    draws = generator.standard_normal((200_000, 2)) + np.array([np.sqrt(evidence), 0.0])
    critical = -2.0 * np.log(0.01)  # of two numbers
    assert np.mean(np.sum(draws**2, axis=1) > critical) == pytest.approx(0.5, abs=0.01)


def test_two_records_are_distinguished_by_the_square_of_their_difference():
    numbers = {"mass": 0.18, "stiffness": 1632.0, "damping": 4.0}
    time = np.arange(2000) / 1000.0
    difference = np.sin(2.0 * np.pi * 200.0 * time)  # far above resonance the body's noise does not pass
    once = noncentrality(difference, numbers, 1000.0, 0.5)
    assert once == pytest.approx(np.sum(difference**2) / 0.5**2, rel=0.01)
    assert noncentrality(2.0 * difference, numbers, 1000.0, 0.5) == pytest.approx(4.0 * once)


def test_friction_by_direction_is_clear_where_the_start_tells_it_from_coulomb_friction():
    assert threshold(2) < DISTINCT
    case = make(6089, "asymmetric_friction")
    assert case.factor > 1.0  # at the size that was drawn only the friction would be clear
    forces = case.truth["asymmetric_friction"]
    assert forces["forward_force"] != pytest.approx(forces["backward_force"], rel=0.2)


def test_a_law_of_friction_is_harder_to_distinguish_from_coulomb_friction_than_from_none():
    case = make(3, "stribeck_friction", factor=0.02, moderate=True)
    coulomb = make(3, "coulomb_friction", factor=0.02, moderate=True)
    assert 1.0 < over_coulomb_friction(case) < 0.3 * case.visibility.evidence
    with pytest.raises(ValueError, match="does not contain Coulomb friction"):
        over_coulomb_friction(coulomb)


def test_a_law_that_does_not_fall_is_coulomb_friction():
    case = make(3, "stribeck_friction", factor=0.02, moderate=True)
    force = case.plant["coulomb_force"]
    flat = replace(case, plant={**case.plant, "static_force": force})
    assert over_coulomb_friction(flat) < 0.1


def test_a_stop_with_friction_differs_from_none_only_where_it_is_reached():
    """A stop makes steps finer, and how friction sticks depends on those: that alone is no difference."""
    case = make(3, "coulomb_friction", factor=1.0, moderate=True)
    quiet = replace(case.condition, noise_share=1e-9)
    friction = Hidden({"coulomb_force": case.plant["coulomb_force"]})
    dry = BlindTrial(quiet, [friction])
    for share, reached in ((1.2, False), (0.5, True)):
        gap = share * float(np.abs(dry.motion.displacement).max())
        stop = Hidden({"stop_gap": gap, "stop_stiffness": 1e6, "stop_damping": 5.0})
        both = BlindTrial(quiet, [friction, stop])
        assert both.plant.longest_step < dry.plant.longest_step
        assert both.differs(dry) is reached


@pytest.mark.parametrize(
    "hidden",
    [pytest.param(one, marks=pytest.mark.slow) for one in ("damping_drift", "quadratic_damping")]
    + ["spring_preload"],
)
def test_the_limit_is_where_the_evidence_meets_the_threshold_from_either_side(hidden):
    """The search may end just below the threshold: that size is the limit, not the last one above it."""
    for seed in (1000, 1001):
        case = limit_case(seed, hidden, moderate=True)
        assert abs(np.log(case.visibility.evidence / case.threshold)) < CLOSE
