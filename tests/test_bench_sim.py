from __future__ import annotations

import numpy as np
from spool_bringup.benchmarks import sim, sim_peer
from spool_sim.composed_motion import ComposedMotion, MotionState
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.motion import half_step_times


def test_the_solvers_are_given_the_problem_that_ours_solves() -> None:
    _, found = sim_peer.solve("RK45", "tanh(v/1e-4)", 1e-6, 120.0)
    assert found is not None
    motion = ComposedMotion(MODELS["coulomb"].terms)
    sweep = SweptSine(
        start_frequency=sim_peer.LOW,
        stop_frequency=sim_peer.HIGH,
        duration=sim_peer.SECONDS,
        amplitude=sim_peer.AMPLITUDE,
        soft_start=0.0,
    )
    ours, _ = motion.advance(
        MotionState(),
        sweep.acceleration(half_step_times(0, found.size, sim_peer.RATE, 2)),
        motion.table(sim.VALUES, 1),
        sample_period=1.0 / sim_peer.RATE,
        substeps=2,
    )
    error = np.sqrt(np.mean((found - ours.displacement) ** 2) / np.mean(ours.displacement**2))
    assert 1e-6 < error < 1e-3


def test_a_solver_that_needs_too_long_gives_up_and_says_so() -> None:
    seconds, found = sim_peer.solve("RK45", "sgn", 1e-9, 0.2)
    assert found is None
    assert 0.2 <= seconds < 5.0
