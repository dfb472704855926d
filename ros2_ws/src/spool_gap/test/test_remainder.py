"""What is left of a model: noise is not predictable, a missing force is, by what it is a function of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from spool_estimator.identification.record import records_from_blocks
from spool_gap.screening.remainder import PredictableShares, remainder
from spool_gap.simulation.point import Point
from spool_gap.simulation.response import responses
from spool_gap.simulation.segments import stretches_of
from spool_gap.simulation.simulate import Simulation
from spool_gap.workflow.preparation import motions_for
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

Array = NDArray[np.float64]

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
FLUID = MODELS["fluid"]
NOISE = 0.02


@pytest.fixture(scope="module", name="simulation")
def _simulation() -> Simulation:
    """A healthy valve under a sweep, in windows."""
    sweep = SweptSine(start_frequency=6.0, stop_frequency=60.0, duration=8.0, amplitude=8.0)
    sensor = Sensor(noise=NOISE)
    simulator = Simulator(
        VALVE,
        sweep,
        model="fluid",
        sample_rate=1000.0,
        block_size=50,
        body_sensor=sensor,
        spool_sensor=sensor,
    )
    (record,) = records_from_blocks(simulator.records(16.0), "healthy")
    return Simulation(stretches_of([record], [], FLUID, VALVE, damping=2.0), motions_for(FLUID))


@pytest.fixture(scope="module", name="point")
def _point() -> Point:
    return Point(tuple(entry.name for entry in FLUID.terms), FLUID.values_for(VALVE))


def errors(simulation: Simulation, added: Callable[[int], Array] | None, point: Point) -> list[Array]:
    """Return noise in every window, with the answer to a force that is ``added``."""
    generator = np.random.default_rng(5)
    rows = [generator.normal(0.0, NOISE, (1, w.stop - w.start)) for _, w, _ in simulation.places]
    if added is not None:
        rows = [row + more for row, more in zip(rows, responses(simulation, point, added), strict=True)]
    return rows


def looked_at(
    simulation: Simulation, point: Point, added: Callable[[int], Array] | None
) -> PredictableShares:
    rows = errors(simulation, added, point)
    return remainder(
        simulation, point, [rows[n] for n in simulation.training], [rows[n] for n in simulation.held_out]
    )


def test_noise_is_not_predictable(simulation: Simulation, point: Point) -> None:
    left = looked_at(simulation, point, None)
    assert left.share < 0.01
    assert not left.counts(1.0, 1.0)


@pytest.mark.parametrize(
    ("follows", "force"),
    [
        ("position", lambda z, _v, _t: np.where(z > 0.3, 1.0, 0.0)),
        ("speed", lambda _z, v, _t: np.sign(v)),
        ("position and speed", lambda z, v, _t: v * np.abs(z)),
        ("time", lambda _z, v, t: t * v),
    ],
)
def test_a_force_that_is_missing_is_named_by_what_it_follows(
    simulation: Simulation, point: Point, follows: str, force: Callable[[Array, Array, Array], Array]
) -> None:
    motion = simulation.stretches[0].motion
    time = np.linspace(-1.0, 1.0, motion.velocity.size)
    row = force(
        motion.displacement / np.std(motion.displacement), motion.velocity / np.std(motion.velocity), time
    )
    left = looked_at(simulation, point, lambda _number: 0.02 * row[np.newaxis])
    assert left.follows == follows, left.shares
    assert left.counts(0.05, 0.05)
    assert not left.counts(1e-3, 1e-3), "less than two simulations differ by"
    assert not left.counts(0.05, 50.0), "next to nothing of the gap"


def test_the_answer_to_a_force_is_that_of_the_simulation(simulation: Simulation, point: Point) -> None:
    """A little more drag, simulated, and as a force on the linear base."""
    more = point.moved(["viscous_coefficient"], [1.001 * point.values["viscous_coefficient"]])
    chosen = list(range(len(simulation.places)))
    both = simulation.run([point, more], chosen)
    extra = 0.001 * point.values["viscous_coefficient"]
    velocity = simulation.stretches[0].motion.velocity
    # The force that the model lacks is that which the simulation has too much, with the other sign.
    answers = responses(simulation, point, lambda _number: -extra * velocity[np.newaxis])
    simulated = np.concatenate([run.means[1] - run.means[0] for run in both])
    assert np.std(np.concatenate([row[0] for row in answers]) - simulated) < 0.03 * np.std(simulated)
