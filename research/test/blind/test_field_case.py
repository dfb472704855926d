"""Field cases: what is hidden is there, its importance is that of its record, and a seed makes it again."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
import spool_blind
from spool_blind.condition import KINDS, OPERATION, draw_excitation
from spool_blind.field.case import (
    LOOK_AHEAD,
    WINDOWS,
    Importance,
    accepted_verdicts,
    make_field,
    threshold,
    window_of,
)
from spool_blind.field.hiding import BLOCK, FIELD_LAWS, HiddenPhysics, field_hidden_by, warming
from spool_blind.field.nuisances import Clipping
from spool_blind.hidden import EFFECTS, Hidden, kind_of
from spool_blind.simulator import Plant, move

BASE = {"mass": 0.18, "stiffness": 1632.0, "damping": 4.0}
H = 20e-6
LARGE, SMALL = Importance(0.1, 0.1, 1e4, 6.6), Importance(0.01, 0.001, 1e4, 6.6)
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


def times(seconds):
    return (np.arange(round(seconds / H)) + 0.5) * H


def answer(numbers, frequency, amplitude=2.0):
    """Complex amplitude of the spool's acceleration over the body's, settled."""
    t = times(3.0)
    body = amplitude * np.sin(2.0 * np.pi * frequency * t) * np.clip(t / 0.5, 0.0, 1.0)
    spool = move(Plant(numbers), t, H, body).spool
    late = t > 3.0 - round(frequency) / frequency
    turn = np.exp(-2j * np.pi * frequency * t[late])
    return np.mean(spool[late] * turn) / np.mean(body[late] * turn)


@pytest.mark.parametrize("frequency", [4.0, 16.0, 45.0])
def test_an_oil_chamber_that_leaks_is_a_spring_and_a_dashpot_in_series(frequency):
    k, tau = 800.0, 0.008
    s = 2j * np.pi * frequency
    inner = BASE["damping"] * s + BASE["stiffness"] + k * tau * s / (1.0 + tau * s)
    expected = inner / (BASE["mass"] * s * s + inner)
    numbers = {**BASE, "chamber_stiffness": k, "chamber_time": tau}
    assert answer(numbers, frequency) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("frequency", [4.0, 16.0, 60.0, 90.0])
def test_the_coils_of_a_spring_have_a_mode_of_their_own(frequency):
    mass, drag = 0.02, 0.4
    s = 2j * np.pi * frequency
    k = BASE["stiffness"]
    # Coils y and spool z relative to the body; halves of the spring of 2 k each.
    whole = np.array(
        [
            [BASE["mass"] * s * s + BASE["damping"] * s + 2.0 * k, -2.0 * k],
            [-2.0 * k, mass * s * s + drag * s + 4.0 * k],
        ]
    )
    z = np.linalg.solve(whole, [-BASE["mass"], -mass])[0]
    numbers = {**BASE, "surge_mass": mass, "surge_damping": drag}
    assert answer(numbers, frequency) == pytest.approx(1.0 + s * s * z, rel=0.02)


def test_slip_elements_hold_like_springs_and_slide_at_their_force():
    t = times(1.0)
    slip = {"slip_force": 0.5, "slip_travel": 1e-4}
    small = move(Plant({**BASE, **slip}), t, H, 0.005 * np.sin(2.0 * np.pi * 5.0 * t)).displacement
    stiffness = 25.0 / 12.0 * 0.5 / 1e-4
    assert np.abs(small[small.size // 2 :]).max() == pytest.approx(
        0.18 * 0.005 / (1632.0 + stiffness), rel=0.05
    )
    # Sliding all the time they take the energy of Coulomb friction of the same force.
    body = 10.0 * np.sin(2.0 * np.pi * 12.0 * t)
    slid, dry = (
        move(Plant({**BASE, **friction}), t, H, body).displacement
        for friction in ({"slip_force": 0.5, "slip_travel": 1e-6}, {"coulomb_force": 0.5})
    )
    assert np.std(slid - dry) < 0.01 * np.std(dry)


def test_a_contact_on_one_side_pushes_and_never_pulls():
    t = times(1.0)
    body = 12.0 * np.sin(2.0 * np.pi * 11.0 * t)
    seat = {"seat_place": 5e-4, "seat_stiffness": 4000.0, "seat_dissipation": 20.0}
    motion = move(Plant({**BASE, **seat}), t, H, body)
    z = motion.displacement
    v = np.gradient(z, H)
    force = -BASE["mass"] * (motion.spool) - BASE["stiffness"] * z - BASE["damping"] * v
    touching = z > 5e-4
    assert touching.any()
    assert np.abs(force[~touching]).max() < 0.02 * np.abs(force).max()
    assert force.min() > -0.02 * force.max()


def test_preload_that_is_smoothed_is_a_preload_far_from_its_travel():
    t = times(1.0)
    body = 12.0 * np.sin(2.0 * np.pi * 11.0 * t)
    soft, sharp = (
        move(Plant({**BASE, **preload}), t, H, body).displacement
        for preload in (
            {"soft_preload": 0.4, "soft_travel": 1e-5},
            {"preload_force": 0.4, "preload_travel": 1e-5},
        )
    )
    assert np.std(soft - sharp) < 0.02 * np.std(sharp)


def test_flow_force_without_ripple_and_overlap_is_a_spring():
    stiffer = {**BASE, "stiffness": BASE["stiffness"] + 500.0}
    flow = {"flow_stiffness": 500.0, "flow_overlap": 1e-12, "flow_frequency": 100.0}
    assert answer({**BASE, **flow}, 13.0) == pytest.approx(answer(stiffer, 13.0), rel=1e-6)


def test_drag_that_warms_begins_as_a_line_and_ends_at_its_share():
    condition = make_field(33, "none", ()).condition
    seconds = condition.duration
    linear = Hidden({"damping_rate": -0.4 / seconds}, {}, {"damping_drift_rate": -0.4 / seconds})
    bent = [warming(np.random.default_rng(seed), linear, condition) for seed in range(40)]
    courses = [one for one in bent if "warming_share" in one.plant]
    assert 10 <= len(courses) <= 30
    for one in courses:
        share, constant = one.plant["warming_share"], one.plant["warming_time"]
        assert share * (1.0 - np.exp(-seconds / constant)) == pytest.approx(-0.4)
        assert one.truth["damping_drift_rate"] == pytest.approx(share / constant)


def test_a_seed_makes_the_same_record_again_and_another_one_another():
    one, other = (make_field(33, "none", ("hum", "jitter", "spikes")) for _ in range(2))
    assert np.array_equal(one.spool, other.spool, equal_nan=True)
    assert np.array_equal(one.body, other.body, equal_nan=True)
    assert [n.sizes for n in one.nuisances] == [n.sizes for n in other.nuisances]
    assert not np.array_equal(one.spool[:100], make_field(151, "none", ()).spool[:100])


def test_without_nuisances_the_record_is_the_motion_and_white_noise():
    case = make_field(33, "none", ())
    assert case.accepted == ("none",)
    motion = case.condition.move(Plant(case.plant))
    assert case.time[-1] == pytest.approx(case.condition.duration - LOOK_AHEAD, abs=2e-3)
    for channel, row in (("body", case.body), ("spool", case.spool)):
        noise = row - case.chain.quiet(channel, motion, case.time)
        assert noise.std() == pytest.approx(case.chain.noise[channel], rel=0.03)
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.03


def test_any_twelve_seeds_in_a_row_hold_every_kind_and_every_law_comes_up():
    for first in (0, 100_000, 300_000 - BLOCK * 5):
        start = first - first % BLOCK
        kinds = [kind_of(field_hidden_by(seed)) for seed in range(start, start + BLOCK)]
        assert [kinds.count(kind) for kind in ("none", "effect", "pair", "out_of_catalogue")] == [4, 4, 2, 2]
    assert set(FIELD_LAWS) <= {field_hidden_by(seed) for seed in range(60)}


def test_windows_of_seeds_do_not_touch():
    assert [window_of(seed) for seed in (0, 399_999, 100_000, 250_000, 599_999)] == [
        "development", "development", "calibration", "check", "report",
    ]  # fmt: skip
    assert sum(len(seeds) for seeds in WINDOWS.values()) == len(set().union(*WINDOWS.values()))


@pytest.mark.parametrize("kind", KINDS)
def test_an_excitation_begins_at_rest_and_has_the_size_that_is_told(kind):
    excitation = draw_excitation(np.random.default_rng(3), kind, 15.0, -1.0, 20.0)
    t = np.arange(-1.0, 20.0, 1e-3)
    row = excitation.at(t)
    assert abs(row[0]) < 1e-9
    assert 0.1 < row.std() < 0.8
    seconds = row.reshape(-1, 500)
    if kind == OPERATION:
        assert np.abs(seconds).max(axis=1).min() < 1e-9  # it stands still in between


#: One that matters and one that does not, the others in the slow tests.
QUICK = ("oil_chamber", "spring_surge")


@pytest.mark.parametrize(
    "law", [law if law in QUICK else pytest.param(law, marks=pytest.mark.slow) for law in FIELD_LAWS]
)
def test_a_law_of_no_catalogue_is_never_a_name_alone_unless_it_is_that_one(law):
    case = make_field(33, law, ())
    assert case.importance[law].with_without > 0.0
    assert "unexplained" in case.accepted
    assert set(case.accepted) <= {"none", "unexplained", "presliding_friction"}
    assert ("none" in case.accepted) is not case.importance[law].matters


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_of_the_catalogue_changes_the_record_and_its_name_is_right(effect):
    case = make_field(33, effect, ())
    assert case.kind == "effect"
    assert case.importance[effect].with_without > 0.0
    assert effect in case.accepted
    assert case.truth[effect]


def test_the_threshold_is_where_half_of_the_records_pass_the_test():
    generator = np.random.default_rng(1)
    evidence = threshold(2)
    draws = generator.standard_normal((200_000, 2)) + np.array([np.sqrt(evidence), 0.0])
    critical = -2.0 * np.log(0.01)  # of two numbers
    assert np.mean(np.sum(draws**2, axis=1) > critical) == pytest.approx(0.5, abs=0.01)


def test_what_matters_is_named_and_what_does_not_may_be():
    pair = HiddenPhysics("end_stop+periodic_force", {"end_stop": Hidden(), "periodic_force": Hidden()}, 1.0)
    both = accepted_verdicts(pair, {"end_stop": LARGE, "periodic_force": LARGE}, set(), ())
    assert both == ("end_stop+periodic_force",)
    one = accepted_verdicts(pair, {"end_stop": LARGE, "periodic_force": SMALL}, set(), ())
    assert set(one) == {"end_stop", "end_stop+periodic_force"}
    clipped = Clipping({"spool": 5.0}, 0)
    none = HiddenPhysics("none", {}, 1.0)
    assert set(accepted_verdicts(none, {}, set(), (clipped,))) == {"none", "sensor_saturation"}
    stribeck = HiddenPhysics("stribeck_friction", {"stribeck_friction": Hidden()}, 1.0)
    alike = accepted_verdicts(stribeck, {"stribeck_friction": LARGE}, {"stribeck_friction"}, ())
    assert set(alike) == {"stribeck_friction", "coulomb_friction"}


def test_importance_grows_with_the_effect_and_counts_what_the_base_cannot_take():
    case = make_field(33, "quadratic_damping", ())
    found = case.importance["quadratic_damping"]
    # Part of it is viscous drag to any fit.
    assert 0.0 < found.share < found.with_without
    assert found.evidence > found.threshold
    assert not SMALL.matters
    assert LARGE.matters
