"""Runs synchronised to the measured motion follow it where free runs take another way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from spool_estimator.identification.record import records_from_blocks
from spool_gap.fitting.hypothesis import Fitting
from spool_gap.fitting.synchronised import following, synchronised_simulation, synchronised_start
from spool_gap.result import GapSettings
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch, stretches_of
from spool_gap.simulation.shooting import pieces_of
from spool_gap.simulation.simulate import Simulation
from spool_gap.workflow.preparation import motions_for
from spool_sim.excitation import SteppedSine
from spool_sim.model import MODELS, model_from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_stiff").model_copy(update={"dynamic_viscosity": 0.015})
FLUID = MODELS["fluid"]
PLAY = model_from_mapping(
    {"name": "play", "terms": [*(e.name for e in FLUID.terms), "spring_backlash"]}, "own"
)
TRUTH, NOISE = 2.5e-4, 0.02


@pytest.fixture(scope="module", name="play")
def _play() -> tuple[Fitting, list[Stretch], Point]:
    """A spool with play, at steps of frequency through its resonance: problem, stretches and the truth."""
    excitation = SteppedSine(
        start_frequency=15.0, stop_frequency=72.0, frequency_step=3.0, dwell=1.0, amplitude=4.0
    )
    sensor = Sensor(noise=NOISE)
    simulator = Simulator(
        VALVE, excitation, model=PLAY, parameters={"backlash": TRUTH}, sample_rate=2000.0, block_size=50,
        body_sensor=sensor, spool_sensor=sensor,
    )  # fmt: skip
    (record,) = records_from_blocks(simulator.records(20.0), "play")
    damping = VALVE.viscous_coefficient
    whole = stretches_of([record], [], FLUID, VALVE, damping=damping)
    pieces = pieces_of(whole, 30_000)
    fitting = Fitting(Simulation(pieces, motions_for(FLUID)), FLUID, VALVE, GapSettings())
    point = Point(fitting.terms_of(("spring_backlash",)), {**FLUID.values_for(VALVE), "backlash": TRUTH})
    return fitting, whole, point


def left(simulation: Simulation, point: Point) -> float:
    every = list(range(len(simulation.places)))
    return float(simulation.nrmse(simulation.errors([point], every), every)[0])


def test_synchronised_runs_of_the_truth_follow_the_motion_where_free_ones_go_another_way(
    play: tuple[Fitting, list[Stretch], Point],
) -> None:
    fitting, whole, truth = play
    noise = math.sqrt(2.0) * NOISE / float(np.std(whole[0].record.spool))  # of both channels
    synchronised = left(synchronised_simulation(fitting, whole, 0.3, 30_000), truth)
    free = left(fitting.simulation, truth)
    assert synchronised < 1.5 * noise
    assert free > 5.0 * synchronised
    assert left(following(fitting, whole, truth, 0.3), truth) < 0.9 * free


@pytest.mark.parametrize("share", [0.1, 0.4, 3.0])
def test_fits_end_in_one_minimum_wherever_they_begin(
    play: tuple[Fitting, list[Stretch], Point], share: float
) -> None:
    fitting, whole, truth = play
    start = truth.moved(("backlash", "spring_stiffness"), (share * TRUTH, 1.03 * VALVE.spring_stiffness))
    found = synchronised_start(fitting, whole, ("spring_backlash",), [start])
    assert found is not None
    assert found.get("backlash") == pytest.approx(TRUTH, rel=0.005)
    assert found.get("spring_stiffness") == pytest.approx(VALVE.spring_stiffness, rel=0.01)
    assert found.get("viscous_coefficient") == pytest.approx(VALVE.viscous_coefficient, rel=0.05)


def test_a_base_without_viscous_drag_holds_no_damper(play: tuple[Fitting, list[Stretch], Point]) -> None:
    fitting, whole, truth = play
    bare = replace(fitting, base=model_from_mapping({"name": "bare", "terms": ["inertia", "spring"]}, "own"))
    assert synchronised_start(bare, whole, ("spring_backlash",), [truth]) is None
