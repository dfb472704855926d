from __future__ import annotations

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_estimator.friction_motion import MOTION_STATES, advance_sample, spread_jump
from spool_sim.excitation import PRESETS
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import load_model

MASS, RATE = 0.18, 2000.0


def run(parameters: Array, excitation: str = "multisine", seconds: float = 1.0, pieces: int = 1) -> Array:
    """Return the states at each sample, shape (n, MOTION_STATES)."""
    samples = round(seconds * RATE)
    body = PRESETS[excitation].acceleration(half_step_times(0, samples, RATE, 1))
    state, spread = np.zeros(MOTION_STATES), np.zeros((4, 4))
    states = np.empty((samples, MOTION_STATES))
    for n in range(samples):
        states[n] = state
        a0, am, a1 = body[2 * n : 2 * n + 3]
        advance_sample(state, a0, am, a1, 1.0 / RATE, pieces, MASS, parameters, spread)
    return states


@pytest.mark.parametrize("coulomb_force", [0.0, 0.3, 1.2])
@pytest.mark.parametrize("excitation", ["multisine", "sweep"])
def test_moves_as_the_simulator_does(excitation: str, coulomb_force: float) -> None:
    substeps, samples = 4, round(RATE)
    simulated = ComposedMotion(load_model("coulomb").terms)
    values = {
        "mass": MASS,
        "viscous_coefficient": 4.0,
        "spring_stiffness": 1632.0,
        "coulomb_force": coulomb_force,
    }
    expected, _ = simulated.advance(
        MotionState(),
        PRESETS[excitation].acceleration(half_step_times(0, samples, RATE, substeps)),
        simulated.table(values, samples),
        sample_period=1.0 / RATE,
        substeps=substeps,
    )
    states = run(np.array([1632.0, 4.0, coulomb_force]), excitation)
    for column, motion in ((0, expected.displacement), (1, expected.velocity)):
        np.testing.assert_allclose(states[:, column], motion, rtol=0.0, atol=1e-4 * np.abs(motion).max())
    assert (states[1:, 2] == 0.0).any() == expected.stuck[1:].any()


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("coulomb_force", [0.3, 0.9])
def test_derivatives_are_those_of_the_motion(which: int, coulomb_force: float) -> None:
    parameters = np.array([1632.0, 4.0, coulomb_force])
    change = 1e-6 * parameters[which]
    ahead, behind = parameters.copy(), parameters.copy()
    ahead[which] += change
    behind[which] -= change
    slope = (run(ahead)[:, 0] - run(behind)[:, 0]) / (2.0 * change)
    derivative = run(parameters)[:, 3 + 2 * which]
    np.testing.assert_allclose(derivative, slope, rtol=0.0, atol=2e-3 * np.abs(slope).max())


def test_more_pieces_change_next_to_nothing() -> None:
    parameters = np.array([5846.0, 8.2, 0.3])
    one, four = run(parameters)[:, 0], run(parameters, pieces=4)[:, 0]
    np.testing.assert_allclose(one, four, rtol=0.0, atol=1e-5 * np.abs(one).max())


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9])
def test_a_spread_jump_has_its_place_and_height(share: float) -> None:
    """Through a smooth window, spread samples give the integral of the step itself."""
    count, middle = 400, 200
    samples = (np.arange(count) > middle).astype(float)
    spread = np.zeros((4, 4))
    spread_jump(spread, share, 1.0, 2.0, 0.0, 0.0)
    samples[middle - 1 : middle + 3] += spread[0]
    fine = (np.arange(count * 200) + 0.5) / 200.0 - 0.5

    def window(times: Array) -> Array:
        return np.asarray(np.exp(-(((times - middle - 0.3) / 3.0) ** 2)))

    exact = np.sum(window(fine) * (fine > middle + share)) / 200.0
    got = np.sum(window(np.arange(count)) * samples)
    assert got == pytest.approx(exact, abs=0.004)
    assert abs(got - exact) < 0.02 * (1.0 + abs(0.5 - share))
    assert spread[1].sum() == pytest.approx(2.0)
    assert spread[1] @ np.array([-1.0, 0.0, 1.0, 2.0]) == pytest.approx(2.0 * share)
