"""Dependence of a residual's level on the motion's: noise of a measuring chain has none.

What no smooth function of the motion predicts is noise, or motion that parts from the model's at chance. The
latter comes and goes with the motion, as what friction and hits leave does; the former does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from spool_gap.simulation.simulate import Simulation

Array = NDArray[np.float64]

#: s of a block: some periods of the slowest valve, so that one block says little about the next.
BLOCK = 0.3
#: Probability by chance of the rank correlation up to which levels depend on each other (Spearman).
BY_CHANCE = 1e-3
#: Ratio of the motion's level between its lively and its calm blocks (the outer fifths) below which nothing
#: can be said: levels of a steady excitation scatter by chance as much.
LIVELY = 1.3
#: Fewest blocks: with ten the smallest probability of a correlation is below that by chance.
FEWEST = 10


@dataclass(frozen=True, slots=True)
class LevelDependence:
    """Dependence of the residual's level on the motion's.

    Attributes:
        share: of the residual's power that comes and goes with the motion: what its calm third lacks to the
            mean; 0 where that may be chance, or where the level does not vary enough to tell.
        known: the motion's level varies enough to tell.
    """

    share: float
    known: bool


def level_dependence(
    simulation: Simulation, errors: Sequence[Array], chosen: Sequence[int]
) -> LevelDependence:
    """Return whether ``errors`` (1, n) of the windows ``chosen``, m/s^2, grow with the motion."""
    left, level = [], []
    for error, place in zip(errors, chosen, strict=True):
        stretch, window, _ = simulation.places[place]
        count = max(1, round((window.stop - window.start) * stretch.record.sample_period / BLOCK))
        motion = stretch.motion.velocity[window.start : window.stop]
        for own, driven in zip(np.array_split(error[0], count), np.array_split(motion, count), strict=True):
            left.append(float(np.mean(own**2)))
            level.append(float(np.mean(driven**2)))
    calm, lively = np.sqrt(np.quantile(level, [0.1, 0.9]))
    if len(left) < FEWEST or lively < LIVELY * calm:
        return LevelDependence(0.0, known=False)
    if float(stats.spearmanr(level, left, alternative="greater").pvalue) > BY_CHANCE:
        return LevelDependence(0.0, known=True)
    calmest = np.argsort(level)[: len(level) // 3]
    share = 1.0 - float(np.mean(np.array(left)[calmest])) / float(np.mean(left))
    return LevelDependence(min(1.0, max(0.0, share)), known=True)
