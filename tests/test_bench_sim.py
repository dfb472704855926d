"""The peers of the simulation get the problem that ours solves, and ours is held against them."""

from __future__ import annotations

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_core.uncertainty import as_json
from spool_evaluation.benchmarks import sim, sim_peer
from spool_evaluation.benchmarks import sim as sim_compiled
from spool_evaluation.benchmarks.sim import PLANT, SWEEP, Ours, TimedRun
from spool_evaluation.results.timing import Timing
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.model import MODELS

SAMPLES, PERIOD = round(sim_peer.SECONDS * sim_peer.RATE), 1.0 / sim_peer.RATE


@pytest.fixture(scope="module")
def motion() -> Array:
    """Return our displacement with two steps a sample, m."""
    sweep = SweptSine(
        start_frequency=sim_peer.LOW,
        stop_frequency=sim_peer.HIGH,
        duration=sim_peer.SECONDS,
        amplitude=sim_peer.AMPLITUDE,
        soft_start=0.0,
    )
    return sim._ours(ComposedMotion(MODELS["coulomb"].terms), sweep, 2)


def test_the_solvers_are_given_the_problem_that_ours_solves(motion: Array) -> None:
    solved = sim_peer.solve("RK45", "tanh(v/1e-4)", 1e-6, 120.0)
    assert solved.displacement is not None
    assert solved.evaluations > SAMPLES
    assert 1e-6 < sim._error(motion, solved.displacement) < 1e-3


@pytest.mark.slow
def test_two_other_event_locating_schemes_find_our_motion_to_a_ten_millionth(motion: Array) -> None:
    solved = sim_peer.solve("DOP853", sim_peer.EVENTS, 1e-9, 120.0)
    assert solved.displacement is not None
    assert sim._error(motion, solved.displacement) < 1e-7
    compiled, _ = sim_compiled.located(SAMPLES, PERIOD, 4, PLANT, SWEEP)
    assert sim._error(motion, compiled) < 1e-7


def test_compiled_schemes_without_events_come_nearer_with_smaller_steps(motion: Array) -> None:
    errors = [
        sim._error(sim_compiled.moreau(SAMPLES, PERIOD, n, PLANT, SWEEP)[0], motion) for n in (4, 16, 64)
    ]
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]
    wide, narrow = (
        sim._error(sim_compiled.smoothed(SAMPLES, PERIOD, n, PLANT, SWEEP, width)[0], motion)
        for n, width in sim.SMOOTHED[:2]
    )
    assert narrow < 0.5 * wide < 1e-3


def test_a_solver_that_needs_too_long_gives_up_and_says_so() -> None:
    solved = sim_peer.solve("RK45", "sgn", 1e-9, 0.2)
    assert solved.displacement is None
    assert solved.seconds >= 0.2


def test_ours_is_never_held_against_a_peer_that_is_more_exact() -> None:
    ours = Ours([TimedRun(1.0, 1e-3), TimedRun(2.0, 1e-6), TimedRun(4.0, 1e-9)], np.zeros(1))
    assert ours.comparable(1e-2).seconds == 1.0
    assert ours.comparable(1e-5).seconds == 2.0
    assert ours.comparable(None).seconds == ours.comparable(1e-12).seconds == 4.0


def test_a_ratio_is_the_product_of_compiling_and_scheme() -> None:
    row = as_json(Timing("a", "b", 0.5, 6.0, compiling=4.0))
    assert row["ratio"] == row["ratio_of_compiling"] * row["ratio_of_scheme"] == 12.0
