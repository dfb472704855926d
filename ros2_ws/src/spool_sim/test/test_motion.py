from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_sim.excitation import SteadySine, SweptSine
from spool_sim.integration.composed_motion import (
    ComposedMotion,
    MotionState,
    Trajectory,
    half_step_times,
    halving_error,
    substeps_needed,
)
from spool_sim.model import load_model

MOTION = ComposedMotion(load_model("coulomb").terms)
MASS = 0.18
SOFT: dict[str, Any] = {"mass": MASS, "viscous_coefficient": 2.65, "spring_stiffness": 1632.0}
FREE = {**SOFT, "coulomb_force": 0.0}
SWEEP = SweptSine(start_frequency=8.0, stop_frequency=110.0, duration=3.0, amplitude=10.0, soft_start=0.0)


def run(
    forcing: Array, substeps: int, rate: float, state: MotionState | None = None, **force: Any
) -> tuple[Trajectory, MotionState]:
    table = MOTION.table({**FREE, **force}, max(1, (forcing.size - 1) // (2 * substeps)))
    return MOTION.advance(state or MotionState(), forcing, table, sample_period=1.0 / rate, substeps=substeps)


def sweep(substeps: int, seconds: float = 3.0, rate: float = 2000.0, **force: Any) -> Trajectory:
    times = half_step_times(0, round(seconds * rate), rate, substeps)
    return run(SWEEP.acceleration(times), substeps, rate, **force)[0]


def relative_rms(value: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean((value - reference) ** 2) / np.mean(reference**2)))


def slow_reference(body: Array, h: float, coulomb_force: float, every: int) -> Array:
    """Moreau's implicit midpoint step in Python: another scheme, sticking by projection."""
    m, c, k = MASS, SOFT["viscous_coefficient"], SOFT["spring_stiffness"]
    inertia = m + 0.5 * h * c + 0.25 * h * h * k
    z = v = 0.0
    out = []
    for i, a in enumerate(body[1::2].tolist()):
        if i % every == 0:
            out.append(z)
        impulse = m * v - h * (m * a + 0.5 * c * v + k * (z + 0.25 * h * v))
        over = abs(impulse) - h * coulomb_force
        after = 0.0 if over <= 0.0 else math.copysign(over, impulse) / inertia
        z += 0.5 * h * (v + after)
        v = after
    return np.array(out)


@pytest.mark.parametrize("coulomb_force", [0.0, 0.5, 1.2])
def test_kernel_agrees_with_a_slow_reference(coulomb_force: float) -> None:
    seconds, rate, fine = 0.5, 2000.0, 100
    times = half_step_times(0, round(seconds * rate), rate, fine)
    sine = SteadySine(frequency=20.0, amplitude=12.0, soft_start=0.0)
    forcing = sine.acceleration(times)
    reference = slow_reference(forcing, 1.0 / (rate * fine), coulomb_force, fine)
    coarse = sine.acceleration(half_step_times(0, reference.size, rate, 2))
    trajectory, _ = run(coarse, 2, rate, coulomb_force=coulomb_force)
    assert relative_rms(trajectory.displacement, reference) < 5e-4


def test_free_decay_under_coulomb_friction_loses_four_forces_over_stiffness() -> None:
    k, coulomb_force, rate = 1632.0, 0.4, 20_000.0
    start = 20.3 * coulomb_force / k
    forcing = np.zeros(2 * 20_000 + 1)
    trajectory, end = run(
        forcing,
        1,
        rate,
        MotionState(displacement=start),
        viscous_coefficient=0.0,
        coulomb_force=coulomb_force,
    )
    z = trajectory.displacement
    turning = np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:])) + 1
    peaks = np.concatenate(([start], z[turning]))
    assert peaks.size >= 4
    np.testing.assert_allclose(np.diff(peaks), -4.0 * coulomb_force / k, rtol=2e-3)
    # 20.3 F/k loses 2 F/k a half swing until it lies within F/k: ten half swings, 0.3 F/k on the same side.
    assert end.direction == 0.0
    assert end.velocity == 0.0
    assert end.displacement == pytest.approx(0.3 * coulomb_force / k, rel=1e-6)
    assert trajectory.stuck[-1]


@pytest.mark.parametrize("frequency", [5.0, 10.0, 15.15, 30.0, 60.0, 120.0])
@pytest.mark.parametrize("viscous_coefficient", [2.65, 8.2])
def test_linear_transmissibility(frequency: float, viscous_coefficient: float) -> None:
    rate, seconds = 2000.0, 6.0
    parameters = {**SOFT, "viscous_coefficient": viscous_coefficient}
    substeps = substeps_needed(1.0 / rate, **parameters, highest_frequency=frequency)
    sine = SteadySine(frequency=frequency, amplitude=10.0, soft_start=0.0)
    times = half_step_times(0, round(seconds * rate), rate, substeps)
    trajectory, _ = run(sine.acceleration(times), substeps, rate, viscous_coefficient=viscous_coefficient)
    settled = slice(round(4.0 * rate), None)
    t = np.arange(trajectory.acceleration.size)[settled] / rate
    basis = np.column_stack((np.sin(2.0 * np.pi * frequency * t), np.cos(2.0 * np.pi * frequency * t)))
    in_phase, quadrature = np.linalg.lstsq(basis, trajectory.acceleration[settled], rcond=None)[0]
    omega = 2.0 * np.pi * frequency
    stiff = SOFT["spring_stiffness"] + 1j * omega * viscous_coefficient
    expected = stiff / (stiff - MASS * omega**2)
    assert abs((in_phase + 1j * quadrature) / 10.0 - expected) < 1e-3 * abs(expected)


def test_spool_sticks_exactly_while_the_force_stays_within_the_bound() -> None:
    rate, coulomb_force = 2000.0, 1.2
    below = SteadySine(frequency=20.0, amplitude=0.999 * coulomb_force / MASS, soft_start=0.0)
    above = SteadySine(frequency=20.0, amplitude=1.001 * coulomb_force / MASS, soft_start=0.0)
    times = half_step_times(0, 2000, rate, 2)
    held, _ = run(below.acceleration(times), 2, rate, coulomb_force=coulomb_force)
    assert held.stuck.all()
    assert not held.displacement.any()
    assert not held.velocity.any()
    np.testing.assert_array_equal(held.acceleration, below.acceleration(times)[:-1:4])
    loose, _ = run(above.acceleration(times), 2, rate, coulomb_force=coulomb_force)
    assert loose.displacement.any()


def test_sticking_and_slipping_are_distinguished_at_every_sample() -> None:
    rate, substeps, coulomb_force = 2000.0, 2, 1.2
    forcing = SWEEP.acceleration(half_step_times(0, 6000, rate, substeps))
    trajectory, _ = run(forcing, substeps, rate, coulomb_force=coulomb_force)
    body = forcing[: -1 : 2 * substeps]
    push = MASS * body + SOFT["spring_stiffness"] * trajectory.displacement
    stuck = trajectory.stuck
    assert 0.05 < stuck.mean() < 0.95
    assert np.all(np.abs(push[stuck]) <= coulomb_force * (1.0 + 1e-9))
    assert not trajectory.velocity[stuck].any()
    np.testing.assert_array_equal(trajectory.acceleration[stuck], body[stuck])
    slip = ~stuck & (trajectory.velocity != 0.0)
    force = (
        SOFT["viscous_coefficient"] * trajectory.velocity
        + SOFT["spring_stiffness"] * trajectory.displacement
        + coulomb_force * np.sign(trajectory.velocity)
    )
    np.testing.assert_allclose(trajectory.acceleration[slip], -force[slip] / MASS, rtol=1e-9, atol=1e-12)


def test_step_error_tells_what_the_chosen_step_costs() -> None:
    substeps = substeps_needed(1.0 / 2000.0, **SOFT, highest_frequency=110.0)
    values = {**SOFT, "coulomb_force": 0.5}
    told = halving_error(
        MOTION, values, SWEEP.acceleration, seconds=3.0, sample_rate=2000.0, substeps=substeps
    )
    true = relative_rms(
        sweep(substeps, coulomb_force=0.5).displacement, sweep(64, coulomb_force=0.5).displacement
    )
    assert 0.3 * true < told < 3.0 * true
    assert told < 1e-5


def test_a_spool_that_rests_has_no_step_error() -> None:
    error = halving_error(MOTION, FREE, np.zeros_like, seconds=0.1, sample_rate=2000.0, substeps=1)
    assert error == 0.0


@pytest.mark.parametrize(
    ("body", "velocity", "rough"),
    [
        ((1.6, -1.0, -3.0), 0.001, 1e-3),  # dips through zero, slips back, reverses again
        ((3.0, -1.1, -4.0), 0.005, 1e-3),
        ((0.9, 1.2, 0.9), 0.0, 1e-3),  # breaks away and comes to rest again
        ((20.0, 1.5, -40.0), 0.05, 1e-3),
    ],
)
def test_several_events_within_one_long_step(
    body: tuple[float, float, float], velocity: float, rough: float
) -> None:
    rate = 100.0
    direction = 1.0 if velocity else 0.0
    state = MotionState(velocity=velocity, direction=direction)
    parameters = {"viscous_coefficient": 0.0, "spring_stiffness": 1.0, "coulomb_force": 0.18}
    _, coarse = run(np.array(body), 1, rate, state, **parameters)
    x = np.linspace(0.0, 1.0, 401)
    a0, am, a1 = body
    parabola = a0 + x * (-3.0 * a0 + 4.0 * am - a1) + x**2 * (2.0 * a0 - 4.0 * am + 2.0 * a1)
    _, fine = run(parabola, 200, rate, state, **parameters)
    assert coarse.direction == fine.direction
    assert coarse.velocity == pytest.approx(fine.velocity, rel=rough, abs=1e-9)
    assert coarse.displacement == pytest.approx(fine.displacement, rel=rough, abs=1e-9)
    assert fine.displacement != 0.0


def test_wrong_lengths_and_too_stiff_parameters_are_refused() -> None:
    with pytest.raises(ValueError, match="holds 6 values"):
        run(np.zeros(6), 2, 2000.0)
    with pytest.raises(InputError, match="at most"):
        substeps_needed(1.0, mass=1e-4, viscous_coefficient=1e5, spring_stiffness=1e8)


def test_a_motion_that_diverges_has_no_numbers_from_there_on() -> None:
    """A bristle that is far stiffer than the steps can follow: no velocity of 0 that looks like rest."""
    motion = ComposedMotion(load_model("fluid_presliding_friction").terms)
    values = {**SOFT, "dahl_force": 1e-6, "dahl_stiffness": 1e9}
    body = 10.0 * np.sin(0.1 * np.arange(2 * 200 + 1))
    table = motion.table(values, 200)
    found, last = motion.advance(MotionState(), body, table, sample_period=5e-4, substeps=1)
    for one in (found.displacement, found.velocity, found.acceleration, found.memory[:, 0]):
        assert np.isfinite(one[0])
        assert np.isnan(one[-100:]).all()
    assert not found.stuck[-100:].any()
    assert np.isnan(last.displacement)
