from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from spool_estimator.friction_motion import MOTION_STATES, advance_sample, slip, slip_matrix

MASS = 0.18


@given(
    seed=st.integers(0, 10_000),
    direction=st.sampled_from([-1.0, 1.0]),
    rate=st.sampled_from([1000.0, 2000.0, 10000.0]),
    parameters=st.tuples(st.floats(500.0, 6000.0), st.floats(0.0, 20.0), st.floats(0.0, 2.0)),
)
@settings(max_examples=300, deadline=None)
def test_slip_moves_as_the_general_step_does_and_leaves_reversals_to_it(
    seed: int, direction: float, rate: float, parameters: tuple[float, float, float]
) -> None:
    generator = np.random.default_rng(seed)
    state = generator.standard_normal(MOTION_STATES) * np.repeat([1e-3, 0.02], [1, 8])
    state[1], state[2] = direction * abs(state[1]), direction
    before, expected, spread = state.copy(), state.copy(), np.zeros((4, 4))
    body = 10.0 * generator.standard_normal(3)
    given_parameters = np.array(parameters)
    matrix = np.empty((8, 8))
    slip_matrix(1.0 / rate, MASS, given_parameters, matrix)
    goes_on = slip(state, *body, matrix)
    first, _ = advance_sample(expected, *body, 1.0 / rate, 1, MASS, given_parameters, spread)
    if goes_on:
        assert first == 2.0
        np.testing.assert_allclose(state, expected, rtol=1e-10, atol=1e-13)
    else:
        assert np.array_equal(state, before)
        assert first <= 1.0 or expected[1] == 0.0


@given(speed=st.floats(1e-6, 1e-3))
def test_a_spool_that_is_slowed_to_rest_within_the_sample_does_not_slip_on(speed: float) -> None:
    state = np.zeros(MOTION_STATES)
    state[1], state[2] = speed, 1.0
    matrix = np.empty((8, 8))
    slip_matrix(5e-4, MASS, np.array([1632.0, 4.0, 1.0]), matrix)
    assume(speed < 5e-4 * 1.0 / MASS)
    assert not slip(state, 0.0, 0.0, 0.0, matrix)
