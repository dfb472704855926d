"""What a structure leaves: noise under the truth, numbers recovered from afar, missing samples."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from spool_estimator.identification.chain import CHAIN_PARTS
from spool_estimator.identification.record import Record, records_from_blocks
from spool_estimator.identification.spectra import delayed
from spool_gap.catalogue import EFFECTS
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.readings import bridged, readings_of
from spool_gap.likelihood.structure import DELAY, GAIN, Limits, Structure, structure_of
from spool_gap.likelihood.structure_fit import StructureFit, fit_structure
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS, Model, model_from_mapping
from spool_sim.observation import INSTANTS, MEAN, Observation
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
BASE = MODELS["fluid"]
MOTIONS = motions_for(BASE)
NOISE = 0.03
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=60.0, duration=6.0, amplitude=9.0)


@lru_cache
def record(effect: str = "", seconds: float = 12.0, **given: float) -> Record:
    terms = () if not effect else (term(effect),)
    simulator = Simulator(
        VALVE, SWEEP, model=Model("hidden", (*BASE.terms, *terms), {}), parameters=given,
        sample_rate=1000.0, block_size=50, seed=5,
        body_sensor=Sensor(noise=NOISE), spool_sensor=Sensor(noise=NOISE),
    )  # fmt: skip
    (found,) = records_from_blocks(simulator.records(seconds), effect)
    return found


def with_play() -> Record:
    return record("spring_backlash", backlash=2e-4)


def prediction(of: Record, missing: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None) -> Prediction:
    return Prediction(readings_of(of, missing=missing), VALVE, MOTIONS)


def structure(*effects: str, **values: float) -> Structure:
    """Return the base with ``effects``; sensors of the simulator sample at instants."""
    return structure_of(BASE, VALVE, effects, (), values).read_by(Observation(INSTANTS))


def fitted(of: Record, *effects: str, **start: float) -> StructureFit:
    return fit_structure(Predictions([prediction(of)]), structure(*effects, **start))


def error_rms(one: Prediction, own: Structure) -> float:
    """Return the rms of the remainder within the band, m/s^2, as if it were the whole band."""
    lines = one.errors([own])[0]
    window = round(1.0 / one.period)
    return float(np.sqrt(np.mean(np.abs(lines) ** 2) / (0.9375 * window)))


def test_the_truth_leaves_the_noise_of_both_sensors() -> None:
    # Where the spool follows the body by |H|, the noises add up to sqrt(1 + |H|^2) times that of one sensor.
    left = error_rms(prediction(record()), structure())
    assert NOISE * 0.97 < left < NOISE * 1.5


def test_a_free_run_that_starts_again_in_each_window_leaves_noise_as_well() -> None:
    of = readings_of(record())
    left = error_rms(Prediction(of, VALVE, MOTIONS, restarts=1.0), structure())
    assert left == pytest.approx(error_rms(Prediction(of, VALVE, MOTIONS), structure()), rel=0.02)


@pytest.mark.parametrize(("ahead", "ends_early"), [(-1.0, False), (1e9, True)])
def test_a_fit_ends_early_only_where_it_cannot_come_to_its_goal(ahead: float, *, ends_early: bool) -> None:
    """Pace is that of its best step so far."""
    of, start = Predictions([prediction(with_play())]), structure("spring_backlash", backlash=4e-4)
    whole = fit_structure(of, start)
    again = fit_structure(of, start, goal=whole.log_likelihood + ahead)
    assert (again.log_likelihood < whole.log_likelihood - 1.0) == ends_early


def test_structures_whose_motion_is_one_simulation_leave_the_same_as_each_alone() -> None:
    one = prediction(record("coulomb_friction", coulomb_force=0.5))
    own = structure_of(BASE, VALVE, ("coulomb_friction",), (), {"coulomb_force": 0.4})
    softer = own.moved({"spring_stiffness": 0.9 * own.values["spring_stiffness"]})
    several = [
        own, softer, own.moved({GAIN: 0.1}), softer.moved({DELAY: 1e-4}), own.read_by(Observation(MEAN)),
    ]  # fmt: skip
    alone = [one.errors([each])[0] for each in several]
    np.testing.assert_array_equal(one.errors(several), alone)


def test_predictions_take_the_kernels_that_the_warm_up_compiles() -> None:
    for motion in MOTIONS:
        motion.warm_up()
    one = prediction(with_play())
    for effects in ((), ("spring_backlash",)):
        own = structure(*effects)
        one.errors([own])
        one.force_of(own, own.terms)
    kernels = [kernel for motion in MOTIONS for kernel in vars(motion._kernel).values()]
    taken = {"read_batch_kernel", "force_kernel"}
    assert [len(one.signatures) for one in kernels if getattr(one, "__name__", "") in taken] == [1] * 4


def test_the_truth_leaves_noise_where_the_motion_is_sensitive_to_its_start() -> None:
    one = prediction(with_play())
    assert error_rms(one, structure("spring_backlash", backlash=2e-4)) < 1.6 * NOISE
    assert error_rms(one, structure()) > 10.0 * NOISE


def test_play_is_found_from_half_of_it() -> None:
    fit = fitted(with_play(), "spring_backlash", backlash=1e-4)
    assert fit.structure.values["backlash"] == pytest.approx(2e-4, rel=0.01)
    assert fit.structure.values["spring_stiffness"] == pytest.approx(VALVE.spring_stiffness, rel=2e-3)


@pytest.mark.parametrize(
    ("effect", "true", "start"),
    [
        ("coulomb_friction", {"coulomb_force": 0.4}, {"coulomb_force": 0.25}),
        ("cubic_stiffness", {"cubic_coefficient": 8e7}, {"cubic_coefficient": 4e7}),
        ("quadratic_damping", {"quadratic_coefficient": 20.0}, {"quadratic_coefficient": 10.0}),
        (
            "spring_preload",
            {"preload_force": 0.4, "preload_travel": 2e-5},
            {"preload_force": 0.2, "preload_travel": 4e-5},
        ),
    ],
)
def test_numbers_are_recovered_from_half_of_them(
    effect: str, true: dict[str, float], start: dict[str, float]
) -> None:
    fit = fitted(record(effect, **true), effect, **start)
    first = next(iter(true))
    assert fit.structure.values[first] == pytest.approx(true[first], rel=0.02)


def test_the_effect_that_acts_is_more_likely_than_another_one() -> None:
    of = record("coulomb_friction", coulomb_force=0.4)
    right = fitted(of, "coulomb_friction", coulomb_force=0.2)
    others = [fitted(of), fitted(of, "quadratic_damping"), fitted(of, "cubic_stiffness")]
    assert right.evidence > max(one.evidence for one in others) + 100.0


def test_an_effect_that_does_not_act_costs_more_than_it_explains() -> None:
    of = record()
    assert fitted(of).evidence > fitted(of, "cubic_stiffness", cubic_coefficient=1e6).evidence


def test_gain_and_delay_of_the_spools_channel_are_recovered() -> None:
    of = record()
    late = replace(of, spool=1.02 * delayed(of.spool, 2e-4, of.sample_period))
    values = fitted(late).structure.values
    assert values["spool_gain_error"] == pytest.approx(0.02, abs=2e-3)
    assert values["spool_delay"] == pytest.approx(2e-4, abs=1e-5)


def test_the_likelihood_is_the_same_for_sensors_that_are_both_turned_round() -> None:
    of = record("coulomb_friction", coulomb_force=0.4)
    truth = structure("coulomb_friction", coulomb_force=0.4)
    found = [
        likelihood(replace(of, body=sign * of.body, spool=sign * of.spool), truth) for sign in (1.0, -1.0)
    ]
    assert found[0] == pytest.approx(found[1], abs=1e-6)


def test_a_clipped_excitation_is_restored_and_counts() -> None:
    of = with_play()
    limit = 0.9 * float(np.abs(of.body).max())
    one = prediction(replace(of, body=np.clip(of.body, -limit, limit)))
    truth = structure("spring_backlash", backlash=2e-4)
    assert one.numbers > 0.97 * prediction(of).numbers
    assert error_rms(one, truth) < 2.0 * NOISE


def test_spikes_that_are_missing_leave_no_trace() -> None:
    of = record("coulomb_friction", coulomb_force=0.4)
    gone = np.zeros(of.spool.size, dtype=np.bool_)
    gone[500::700] = True
    nothing = np.zeros_like(gone)
    spiked = replace(of, spool=np.where(gone, 500.0, of.spool))
    truth = structure("coulomb_friction", coulomb_force=0.4)
    left = error_rms(prediction(spiked, (nothing, gone)), truth)
    assert left == pytest.approx(error_rms(prediction(of), truth), rel=0.05)


def test_a_base_without_viscous_drag_gets_none() -> None:
    bare = model_from_mapping({"name": "bare", "terms": ["inertia", "spring"]}, "own")
    fit = fit_structure(Predictions([prediction(record())]), structure_of(bare, VALVE))
    assert "viscous_friction" not in fit.structure.terms
    assert "viscous_coefficient" not in fit.names


def likelihood(of: Record, own: Structure, *missing: NDArray[np.bool_]) -> float:
    one = prediction(of, (missing[0], missing[1]) if missing else None)
    return one.log_likelihood(one.errors([own])[0])


@settings(max_examples=10)
@given(seconds=st.integers(-100, 100_000))
def test_the_likelihood_is_the_same_at_any_time_of_day(seconds: int) -> None:
    of = record("coulomb_friction", coulomb_force=0.4)
    truth = structure("coulomb_friction", coulomb_force=0.4)
    later = replace(of, start=of.start + seconds * 10**9, origin=of.start)
    assert likelihood(later, truth) == pytest.approx(likelihood(of, truth), abs=1e-6)


@settings(max_examples=10)
@given(channel=st.sampled_from(["body", "spool"]), size=st.floats(-100.0, 100.0), seed=st.integers(0, 99))
def test_what_stands_in_samples_that_are_missing_changes_nothing(
    channel: str, size: float, seed: int
) -> None:
    """As excitation, in the motion to start from, and where readings are compared."""
    of = record("coulomb_friction", coulomb_force=0.4)
    draw = np.random.default_rng(seed)
    gone, nothing = draw.random(of.spool.size) < 0.003, np.zeros(of.spool.size, dtype=np.bool_)
    masks = (gone, nothing) if channel == "body" else (nothing, gone)
    truth = structure("coulomb_friction", coulomb_force=0.4)
    found = []
    for row in (getattr(of, channel), getattr(of, channel) + size * draw.random(of.spool.size) * gone):
        found.append(likelihood(replace(of, **{channel: row}), truth, *masks))
    assert found[0] == pytest.approx(found[1], abs=1e-6)


@pytest.mark.parametrize("channel", ["body", "spool"])
def test_clipped_samples_are_restored_in_the_body_and_a_limit_in_the_spool(channel: str) -> None:
    of = record()
    row = getattr(of, channel)
    limit = 0.8 * float(np.abs(row).max())
    readings = readings_of(replace(of, **{channel: np.clip(row, -limit, limit)}))
    at_limit = np.abs(row) >= limit
    # What the body did there is restored, and the spool did at least that.
    counted = float(readings.counted[at_limit].mean())
    assert counted > 0.9 if channel == "body" else counted == 0.0
    assert np.std(readings.body - readings_of(of).body) < NOISE
    assert np.isnan(readings.rail[at_limit]).any() == (channel == "body")
    assert readings.heard[at_limit].any() == (channel == "body")
    assert getattr(readings, f"{channel}_limit") == pytest.approx(limit)


def test_the_rail_that_a_bias_moves_is_a_rail_too() -> None:
    """A sensor clips on both sides, its bias moves, and the logger clips at the same limit."""
    of = record()
    limit = 0.6 * float(np.abs(of.spool).max())
    bias = 0.02 * limit * (1.0 + np.linspace(0.0, 5.0, of.spool.size))
    moved = np.minimum(np.clip(of.spool, -limit, limit) + bias, limit)
    readings = readings_of(replace(of, spool=moved))
    assert not readings.heard[of.spool <= -limit].any()
    assert readings.heard[np.abs(of.spool) < 0.8 * limit].all()


def test_a_bias_and_its_drift_do_not_leak_from_where_samples_are_missing() -> None:
    of = record()
    gone, nothing = np.zeros(of.spool.size, dtype=np.bool_), np.zeros(of.spool.size, dtype=np.bool_)
    gone[np.arange(of.spool.size) % 37 < 6] = True
    one = prediction(of, (nothing, gone))
    for drift in (np.zeros(one.size), np.linspace(-1.0, 1.0, one.size)):
        biased = one.counted_lines(5.0 + drift)[one.inside]
        assert np.abs(biased).max() < 1e-9 * 5.0 * one.size


def test_samples_that_are_cut_off_are_bridged_by_the_model() -> None:
    of = record()
    limit = 0.6 * float(np.abs(of.spool).max())
    cut = readings_of(replace(of, spool=np.clip(of.spool, -limit, limit)))
    whole = readings_of(of)
    bridge = Prediction(cut, VALVE, MOTIONS).bridged(structure()).readings
    inside = slice(500, -500)
    error, before = (float(np.std((row.spool - whole.spool)[inside])) for row in (bridge, cut))
    assert error < before < NOISE


def test_a_bridge_ends_at_the_measured_samples_whatever_the_zero_of_the_guess() -> None:
    of, gone = record(), np.zeros(record().spool.size, dtype=np.bool_)
    gone[3000:3100] = True
    cut = readings_of(of, missing=(np.zeros_like(gone), gone))
    bridges = [bridged(cut, of.spool + zero).spool for zero in (0.0, 5.0)]
    np.testing.assert_allclose(bridges[1], bridges[0], atol=1e-9)


@pytest.mark.parametrize("channel", ["body", "spool"])
def test_a_mode_has_a_share_of_the_reading_and_the_damping_of_a_mounting(channel: str) -> None:
    key = f"{channel}_extra_mode"
    bounds = {one.name: (one.low, one.high) for one in structure_of(BASE, VALVE, (), (key,)).unknowns(10.0)}
    assert bounds[f"{channel}_mode_share"] == (0.0, 1.0)
    assert bounds[f"{channel}_mode_damping"] == (2e-3, 0.2)


@given(slowest=st.floats(1e-4, 0.1), reach=st.floats(1e-5, 1e-2), force=st.floats(1e-3, 10.0))
def test_laws_of_friction_keep_to_what_the_record_resolves(
    slowest: float, reach: float, force: float
) -> None:
    start = structure_of(BASE, VALVE, ("stribeck_friction",), (), {"stribeck_velocity": 1e-5})
    fitted = replace(start, limits=Limits(slowest, reach)).bounded(10.0)
    assert fitted.values["stribeck_velocity"] == slowest
    values = {"dahl_force": force, "dahl_stiffness": 1.0}
    start = structure_of(BASE, VALVE, ("presliding_friction",), (), values)
    fitted = replace(start, limits=Limits(slowest, reach)).bounded(10.0)
    assert fitted.values["dahl_force"] / fitted.values["dahl_stiffness"] <= reach * (1.0 + 1e-9)


#: Numbers of each part of the measuring chain.
CHAINS = {
    "ac_coupling": (0.8,), "anti_alias": (1.5e-3,), "extra_mode": (0.3, 90.0, 0.05), "gain_drift": (0.004,),
    "nonlinearity": (5e-3, 2e-3),
}  # fmt: skip


@pytest.mark.parametrize("key", CHAIN_PARTS)
def test_a_part_of_the_chain_without_size_does_nothing(key: str) -> None:
    part, own = CHAIN_PARTS[key], prediction(record())
    wider = structure().having((), (key,), {one.name: 0.0 for one in part.parameters if one.low <= 0.0})
    np.testing.assert_allclose(own.errors([wider]), own.errors([structure()]), atol=1e-6)


def passed(of: Record, key: str) -> tuple[Record, dict[str, float]]:
    """Return ``of`` with what the part ``key`` makes of its channel, and the numbers of the part."""
    part = CHAIN_PARTS[key]
    numbers, row = CHAINS[part.id], getattr(of, part.channel)
    if part.id == "nonlinearity":
        made = row + numbers[0] * row**2 / 9.80665 + numbers[1] * row**3 / 9.80665**2
    elif part.response is None:
        made = row * (1.0 + numbers[0] * of.sample_period * np.arange(row.size))
    else:
        frequency = np.maximum(np.fft.rfftfreq(row.size, of.sample_period), 1e-3)
        made = np.fft.irfft(np.fft.rfft(row) * part.response(frequency, numbers), row.size)
    names = (parameter.name for parameter in part.parameters)
    return replace(of, **{part.channel: made}), dict(zip(names, numbers, strict=True))


@pytest.mark.parametrize("key", CHAIN_PARTS)
def test_what_a_part_of_the_chain_makes_of_a_record_its_model_explains(key: str) -> None:
    """The body's part is taken off the excitation, the spool's is put on the reading."""
    changed, values = passed(record(), key)
    before, one = error_rms(prediction(record()), structure()), prediction(changed)
    assert error_rms(one, structure().having((), (key,), values)) == pytest.approx(before, rel=0.15)
    assert error_rms(one, structure()) > 2.0 * before


@pytest.mark.parametrize("key", ["body_ac_coupling", "spool_ac_coupling"])
def test_the_high_pass_of_a_channel_is_found_with_its_corner(key: str) -> None:
    changed, values = passed(record(), key)
    one = Predictions([prediction(changed)])
    found = fit_structure(one, structure().having((), (key,)))
    for name, true in values.items():
        assert found.structure.values[name] == pytest.approx(true, rel=0.1)
    assert found.evidence > fit_structure(one, structure()).evidence


SMALL = {
    "quadratic_damping": (0.2, lambda z, v: v * np.abs(v)),
    "cubic_stiffness": (1e6, lambda z, v: z**3),
    "coulomb_friction": (0.005, lambda z, v: np.sign(v)),
}


@pytest.mark.parametrize("effect", sorted(SMALL))
def test_what_a_small_force_adds_is_the_difference_of_two_predictions(effect: str) -> None:
    one, own = prediction(record()), structure()
    size, law = SMALL[effect]
    wider = own.having((effect,), (), {EFFECTS[effect].fitted[0]: size})
    motion, lines = one.responses([own]), one.errors([own])[0]
    weights = one.weights(lines)
    force = size * law(motion.displacement, motion.velocity)
    column = one.weighed(one.lines_of_forces(force, own)[0], weights)
    changed = motion.acceleration[0] - one.responses([wider]).acceleration[0]
    difference = one.weighed(one.counted_lines(changed), weights)
    sizes = float(np.linalg.norm(column)), float(np.linalg.norm(difference))
    assert float(column @ difference) > 0.95 * sizes[0] * sizes[1]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.1)


@pytest.mark.parametrize("effect", sorted(SMALL))
def test_the_force_of_an_effect_is_its_own_without_that_of_the_base(effect: str) -> None:
    size, law = SMALL[effect]
    one = prediction(record())
    own = structure(effect, **{EFFECTS[effect].fitted[0]: size})
    motion = one.responses([own])
    force = size * law(motion.displacement[0], motion.velocity[0])
    assert one.force_of(own, EFFECTS[effect].terms) == pytest.approx(force, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("hit", [14.7, 20.2, 27.9])
def test_excerpts_count_the_window_in_which_something_is_hit(hit: float) -> None:
    """An excerpt of 5.5 s counts 4 windows: the time before them lets the motion come in."""
    quiet = record(seconds=33.0)
    spool = quiet.spool.copy()
    place = round(hit / quiet.sample_period)
    spool[place : place + 3] += 20.0 * quiet.spool.std()
    every = Predictions([prediction(replace(quiet, spool=spool))])
    excerpts = every.excerpt().parts
    assert [int(one.inside.sum()) for one in excerpts] == [4, 4]
    inside = [one.samples_of(one.inside) for one in excerpts]
    largest = max(float(np.abs(one.spool[own]).max()) for one, own in zip(excerpts, inside, strict=True))
    assert largest > 0.9 * float(np.abs(spool).max())
