from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from spool_core.numbers import Array
from spool_sim.excitation import SteadySine, SweptSine
from spool_sim.integration.composed_motion import (
    ComposedMotion,
    MotionState,
    Trajectory,
    half_step_times,
    substeps_for,
)
from spool_sim.model import MODELS, model_from_mapping
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve

MASS, STIFFNESS = 0.18, 1632.0
SWEEP = SweptSine(start_frequency=8.0, stop_frequency=110.0, duration=10.0, amplitude=10.0, soft_start=0.0)


def motion_of(*terms: str) -> ComposedMotion:
    return ComposedMotion(model_from_mapping({"name": "test", "terms": ["inertia", "spring", *terms]}).terms)


def harmonic(
    motion: ComposedMotion, values: dict[str, float], ratio: float, push: float, periods: int, rate: float
) -> tuple[Trajectory, int]:
    """Excite at ``ratio`` times the natural frequency with an inertia force of ``push`` N, peak."""
    frequency = ratio * math.sqrt(STIFFNESS / MASS) / (2.0 * math.pi)
    per_period = round(rate / frequency)
    rate = per_period * frequency
    sine = SteadySine(frequency=frequency, amplitude=push / MASS, soft_start=0.0)
    samples = periods * per_period
    given = {p.name: p.start for p in motion.parameters} | {"mass": MASS, "spring_stiffness": STIFFNESS}
    trajectory, _ = motion.advance(
        MotionState(),
        sine.acceleration(half_step_times(0, samples, rate, 1)),
        motion.table(given | values, samples),
        sample_period=1.0 / rate,
        substeps=1,
    )
    return trajectory, per_period


@pytest.mark.parametrize(("ratio", "friction"), [(1.5, 0.3), (1.5, 0.5), (2.5, 0.2), (0.7, 0.3)])
def test_den_hartog_s_amplitude_without_stops(ratio: float, friction: float) -> None:
    push = 2.0
    trajectory, period = harmonic(
        motion_of("coulomb_friction"), {"coulomb_force": friction * push}, ratio, push, 150, 5000.0
    )
    amplification = 1.0 / (1.0 - ratio**2)
    damping = math.sin(math.pi / ratio) / (ratio * (1.0 + math.cos(math.pi / ratio)))
    expected = push / STIFFNESS * math.sqrt(amplification**2 - (friction * damping) ** 2)
    last = trajectory.displacement[-10 * period :]
    assert trajectory.stuck[-10 * period :].mean() < 0.01
    assert 0.5 * (last.max() - last.min()) == pytest.approx(expected, rel=1e-3)


def one_stop_a_half_cycle(ratio: float, push: float, force: float, most: float = 1.1) -> tuple[float, float]:
    """Return amplitude (m) and share of time at rest, from the solution piece by piece."""
    natural = math.sqrt(STIFFNESS / MASS)
    omega = ratio * natural
    steady = push / STIFFNESS / (1.0 - ratio**2)

    def slide(amplitude: float) -> tuple[float, float]:
        start = math.asin((force - STIFFNESS * amplitude) / push) / omega
        cosine = -amplitude + force / STIFFNESS - steady * math.sin(omega * start)
        sine = -steady * ratio * math.cos(omega * start)

        def velocity(t: float) -> float:
            turn = natural * (t - start)
            return omega * steady * math.cos(omega * t) + natural * (
                sine * math.cos(turn) - cosine * math.sin(turn)
            )

        grid = start + np.linspace(1e-3, 1.0, 2000) * math.pi / omega
        signs = np.array([velocity(t) for t in grid])
        first = int(np.flatnonzero(signs <= 0.0)[0])
        end = brentq(velocity, grid[first - 1], grid[first], xtol=1e-14)
        turn = natural * (end - start)
        place = (
            -force / STIFFNESS
            + steady * math.sin(omega * end)
            + cosine * math.cos(turn)
            + sine * math.sin(turn)
        )
        return place, end - start

    # The slide from a larger amplitude falls short of it, from a smaller one it goes beyond.
    high = next(x for x in np.linspace(1e-6, 2.0, 80) * push / STIFFNESS if slide(x)[0] < x)
    amplitude = brentq(lambda x: slide(x)[0] - x, 1e-9, high, xtol=1e-14)
    return amplitude, 1.0 - slide(amplitude)[1] * omega / math.pi


@pytest.mark.parametrize(("ratio", "friction"), [(0.3, 0.8), (0.4, 0.7), (0.5, 0.85), (0.6, 0.6), (0.6, 0.9)])
def test_den_hartog_s_amplitude_with_stops(ratio: float, friction: float) -> None:
    push = 2.0
    amplitude, at_rest = one_stop_a_half_cycle(ratio, push, friction * push)
    trajectory, period = harmonic(
        motion_of("coulomb_friction"), {"coulomb_force": friction * push}, ratio, push, 40, 10_000.0
    )
    last = trajectory.displacement[-10 * period :]
    assert at_rest > 0.05
    assert 0.5 * (last.max() - last.min()) == pytest.approx(amplitude, rel=1e-4)
    assert trajectory.stuck[-10 * period :].mean() == pytest.approx(at_rest, abs=5e-3)


@pytest.mark.parametrize("stiffness", [5e3, 5e4])
def test_area_of_the_dahl_loop(stiffness: float) -> None:
    force = 0.5
    trajectory, period = harmonic(
        motion_of("viscous_friction", "presliding_friction"),
        {"viscous_coefficient": 2.0, "dahl_force": force, "dahl_stiffness": stiffness},
        0.8,
        1.0,
        100,
        20_000.0,
    )
    z = trajectory.displacement[-period - 1 :]
    friction = trajectory.memory[-period - 1 :, 0]
    area = float(np.sum(0.5 * (friction[1:] + friction[:-1]) * np.diff(z)))
    reach = 0.5 * (z.max() - z.min())
    expected = 4.0 * force * (reach - force / stiffness * math.tanh(stiffness * reach / force))
    assert area == pytest.approx(expected, rel=1e-3)


def test_stop_throws_the_spool_back_with_the_energy_it_brought() -> None:
    motion = motion_of("end_stop")
    values: dict[str, float | Array] = {
        "mass": MASS,
        "spring_stiffness": 1.0,
        "stop_gap": 1e-3,
        "stop_stiffness": 1e6,
        "stop_dissipation": 0.0,
        "stop_damping": 0.0,
    }
    rate = 20_000.0

    def hit(substeps: int = 1) -> Array:
        trajectory, _ = motion.advance(
            MotionState(0.0, 0.5, 1.0),
            np.zeros(2 * 80 * substeps + 1),
            motion.table(values, 80),
            sample_period=1.0 / rate,
            substeps=substeps,
        )
        depth = trajectory.displacement.max() - 1e-3
        return np.array([depth, trajectory.velocity[-1]])

    depth, back = hit()
    assert depth == pytest.approx(0.5 * math.sqrt(MASS / 1e6), rel=2e-3)
    assert back == pytest.approx(-0.5, rel=1e-5)
    values["stop_dissipation"] = 0.5
    assert -0.5 < hit()[1] < -0.3
    # Spring and damper that do not pull: the hit ends where the force does.
    share, rest = 0.2, math.sqrt(1.0 - 0.2**2)
    values |= {"stop_dissipation": 0.0, "stop_damping": share * 2.0 * math.sqrt(1e6 * MASS)}
    turn = (math.pi - math.atan(2.0 * share * rest / (1.0 - 2.0 * share**2))) / rest
    assert hit(16)[1] == pytest.approx(-0.5 * math.exp(-share * turn), rel=2e-3)


def test_static_friction_alone_holds_and_then_lets_go_without_any_drag() -> None:
    motion = motion_of("microwedge_friction")
    bound = 100.0 * 0.0021
    held, _ = harmonic(motion, {}, 0.5, 0.999 * bound, 3, 5000.0)
    assert held.stuck.all()
    assert not held.displacement.any()
    loose, _ = harmonic(motion, {}, 0.5, 1.001 * bound, 3, 5000.0)
    assert np.abs(loose.displacement).max() > bound / STIFFNESS


def sweep(name: str, valve: Valve, substeps: int, seconds: float, **values: float) -> Array:
    motion = ComposedMotion(MODELS[name].terms)
    table = motion.table(MODELS[name].values_for(valve, values), 1)
    state, parts, step = MotionState(), [], 1000
    for first in range(0, round(seconds * 2000.0), step):
        forcing = SWEEP.acceleration(half_step_times(first, step, 2000.0, substeps))
        part, state = motion.advance(
            state, forcing, table, sample_period=5e-4, substeps=substeps, first_sample=first
        )
        parts.append(part.displacement)
    return np.concatenate(parts)


def relative_rms(value: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean((value - reference) ** 2) / np.mean(reference**2)))


@pytest.mark.parametrize(
    ("name", "values", "least_order"),
    [
        ("fluid", {}, 3.8),
        ("coulomb", {"coulomb_force": 0.5}, 3.7),
        ("coulomb", {"coulomb_force": 1.2}, 3.7),
        ("stribeck", {}, 3.7),
        ("fluid_presliding_friction", {}, 3.5),
        ("fluid_spring_backlash", {"backlash": 2e-4}, 3.7),
        ("fluid_spring_preload", {}, 3.4),
        ("fluid_end_stop", {"stop_gap": 5e-4, "stop_stiffness": 1e5}, 3.4),
        ("fluid_periodic_force", {}, 3.7),
        # sqrt(abs(v)) has no derivative at v = 0: what is lost there bounds the order.
        ("mixed", {}, 1.4),
    ],
)
def test_convergence_order(name: str, values: dict[str, float], least_order: float, valve: Valve) -> None:
    reference = sweep(name, valve, 64, 2.0, **values)
    first, last = (relative_rms(sweep(name, valve, n, 2.0, **values), reference) for n in (2, 8))
    assert first < 1e-3
    assert math.log(first / last, 4.0) > least_order


@pytest.mark.parametrize("stiffness", [1632.0, 5846.0])
@pytest.mark.parametrize("force", [0.5, 1.2])
@pytest.mark.parametrize("name", ["coulomb", "mixed"])
def test_two_steps_a_sample_agree_with_half_a_microsecond(
    name: str, stiffness: float, force: float, valve: Valve
) -> None:
    values: dict[str, Any] = {"spring_stiffness": stiffness, "viscous_coefficient": 2.65}
    if name == "coulomb":
        values["coulomb_force"] = force
    else:  # the same force at rest
        values |= {"mixed_inverse_coefficient": force * 0.01 / 1.687, "normal_load": 1.687}
    model = MODELS[name]
    assert substeps_for(model.terms, model.values_for(valve, values), 5e-4, 110.0) == 2
    reference = sweep(name, valve, 1000, 3.0, **values)  # through both resonances
    assert relative_rms(sweep(name, valve, 2, 3.0, **values), reference) < 1e-3


def amplification(
    source: Simulator, valve: Valve, frequency: float, damping: float, stiffness: float
) -> float:
    """Return by how much the spool moves more than the body, over what theory has of a linear valve."""
    blocks = list(source.records(1.0))
    body, spool = (
        np.concatenate([getattr(one, name) for one in blocks])[-1000:] for name in ("body", "spool")
    )
    held = stiffness + 2j * math.pi * frequency * damping
    expected = abs(held / (held - valve.moving_mass * (2.0 * math.pi * frequency) ** 2))
    return float(spool.std() / body.std() / expected)


@pytest.mark.parametrize(
    "drifts",
    [
        [("spring_stiffness", 1e7, 0.0)],
        [("viscous_coefficient", 3000.0, 0.0)],
        [("oil_temperature", -30.0, 0.0), ("viscous_coefficient", 100.0, 0.0)],
        # Still cold when the coefficient steps, and thin at the end of its way.
        [
            ("oil_temperature", -30.0, 0.0),
            ("oil_temperature", 60.0, 1e6),
            ("viscous_coefficient", 100.0, 0.0),
        ],
        # Still thick when the oil is cold, and thin at the end.
        [
            ("viscous_coefficient", 100.0, 0.0),
            ("viscous_coefficient", 1.0, 1e6),
            ("oil_temperature", -30.0, 0.0),
        ],
    ],
    ids=["stiffer", "thicker", "colder", "thicker while cold oil warms", "colder while it thins"],
)
def test_a_valve_that_drifts_to_a_faster_motion_answers_as_theory_has_it(
    drifts: list[tuple[str, float, float]], valve: Valve
) -> None:
    frequency = 90.0
    source = Simulator(valve, SteadySine(frequency=frequency, amplitude=10.0), model="fluid")
    for quantity, target, duration in drifts:
        source.set_drift(quantity, target, duration)
    truth = source.truth
    found = amplification(source, valve, frequency, truth.viscous_coefficient, truth.spring_stiffness)
    assert found == pytest.approx(1.0, rel=1e-5)
