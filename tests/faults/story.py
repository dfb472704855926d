"""Stories of a valve for faults of what watches it: blocks, and the estimates that follow each."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from spool_core.block import Block
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator, settings_for
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
#: s between two blocks, and between two estimates.
STEP, PERIOD = 0.1, 0.5


@dataclass(frozen=True)
class Plot:
    """Parameters that change at a block, and blocks in which the body's accelerometer stands still."""

    blocks: int
    changes: Mapping[int, tuple[str, float]] = field(default_factory=dict)
    dead: tuple[int, ...] = ()


@dataclass(frozen=True)
class Story:
    """Each block with the estimates that fall due then; the stamps begin now."""

    blocks: list[Block]
    estimates: list[tuple[Estimate, ...]]


#: What may happen to the valve.
PLOTS = {
    "healthy": Plot(190),
    "a softer spring": Plot(240, {80: ("spring_stiffness", 0.75 * VALVE.spring_stiffness)}),
    "worn": Plot(280, {80: ("viscous_coefficient", 0.65 * VALVE.viscous_coefficient)}),
    "a dead accelerometer": Plot(260, dead=tuple(range(90, 160))),
    "dead twice": Plot(260, dead=(*range(100, 160), *range(210, 235))),
}


@functools.cache
def told(name: str) -> Story:
    """Return the story of the plot ``name``, simulated once a process."""
    plot, noisy = PLOTS[name], Sensor(noise=0.03)
    simulator = Simulator(
        VALVE, PRESETS["multisine"], coulomb_force=0.1, seed=5, sample_rate=500.0, block_size=50,
        body_sensor=noisy, spool_sensor=noisy,
    )  # fmt: skip
    estimator = Estimator(settings_for(VALVE, period=PERIOD, memory=2.0))
    begin, story = time.time_ns(), Story([], [])
    ahead = 0
    for number in range(plot.blocks):
        if number in plot.changes:
            simulator.set_drift(*plot.changes[number], 0.5)
        block = simulator.next_block()
        ahead = ahead or begin - block.stamp
        block = replace(block, stamp=block.stamp + ahead)
        if number in plot.dead:
            block = replace(block, body=np.full_like(block.body, story.blocks[plot.dead[0] - 1].body[-1]))
        if number % 10 == 0:
            estimator.update_temperature(block.stamp, VALVE.oil_temperature)
        story.blocks.append(block)
        story.estimates.append(tuple(estimator.update(block)))
    return story
