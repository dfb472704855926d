"""Screening by the residual of the free run: what is worth adding to accepted effects.

The balance of forces at the measured motion, see :mod:`.balance`, is blunt once dry friction is in it: the
instants of its jumps are not known to a part of a sample. A free run has them right, and what it leaves is,
to first order, the answer of the linear base to the forces that are still missing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spool_gap.effect import Effect, Motion
from spool_gap.fitting.hypothesis import BASE_NUMBERS, Hypothesis
from spool_gap.simulation.response import responses
from spool_gap.simulation.simulate import Simulation

from .regression import Screened

Array = NDArray[np.float64]

#: Forces that are simulated, and effects of the measuring chain besides: these take no force's place.
SIMULATED, OF_THE_CHAIN = 4, 2


def screened_by_residual(
    simulation: Simulation, step: Hypothesis, effects: Sequence[Effect], motion: Motion, least: float
) -> list[Screened]:
    """Return those of ``effects`` that explain most of what ``step`` leaves, best first.

    Args:
        simulation: the windows, weighed.
        step: the accepted hypothesis.
        effects: of the catalogue.
        motion: of all stretches with windows to fit, one after the other.
        least: fall of the weighed sum of squares from which an effect is worth simulating.
    """
    training = simulation.training
    point = step.point
    sizes = [s.record.body.size if any(s.training) else 0 for s in simulation.stretches]
    firsts = np.concatenate([[0], np.cumsum(sizes)])

    def weighed(columns: Array, slopes: Sequence[int] = ()) -> Array:
        def forces(number: int) -> Array:
            return np.asarray(columns[:, firsts[number] : firsts[number + 1]])

        return np.asarray(
            simulation.weigh(responses(simulation, point, forces, slopes, training), training).T
        )

    known = [motion.displacement, motion.velocity]
    known += [row for trial in step.trials.values() for row in trial.columns]
    base, _ = np.linalg.qr(weighed(np.array(known), (0, 1)))
    target = simulation.weigh(step.train, training)[0]
    target = target - base @ (base.T @ target)
    numbers = np.array([point.get(name) for name in BASE_NUMBERS])
    found = []
    for entry in effects:
        best: Screened | None = None
        for trial in entry.trials(motion):
            columns = weighed(trial.columns)
            scale = np.linalg.norm(columns, axis=0)
            if not np.all(scale > 0.0):
                continue
            columns = columns / scale
            columns -= base @ (base.T @ columns)
            solution, _, rank, _ = np.linalg.lstsq(columns, target, rcond=1e-6)
            gain = float(target @ (columns @ solution))
            if rank == 0 or gain < max(least, best.gain if best else 0.0):
                continue
            values = entry.values(solution / scale, trial.shape, motion)
            if values is not None:
                best = Screened(entry, gain, values, trial, numbers)
        if best is not None:
            found.append(best)
    return foremost(sorted(found, key=lambda one: -one.gain), SIMULATED, OF_THE_CHAIN)


def foremost(ordered: Sequence[Screened], forces: int, of_the_chain: int) -> list[Screened]:
    """Return the first ones of ``ordered``: so many ``forces``, and so many effects ``of_the_chain``."""
    left = {True: of_the_chain, False: forces}
    found = []
    for entry in ordered:
        kind = entry.effect.nuisance
        if left[kind] > 0:
            left[kind] -= 1
            found.append(entry)
    return found
