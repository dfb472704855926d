"""All windows together: hypotheses fitted to all of the data, and judged by their BIC penalty."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.simulation.noise_floor import noise_floor
from spool_gap.simulation.simulate import Simulation
from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]

#: Draws of the noise.
DRAWS = 4


class AllWindows(Simulation):
    """Simulation all of whose windows are fitted, and judge."""

    @property
    def training(self) -> list[int]:
        """Numbers of all windows."""
        return list(range(len(self.places)))

    @property
    def held_out(self) -> list[int]:
        """Numbers of all windows."""
        return self.training

    @classmethod
    def of(cls, other: Simulation) -> Simulation:
        """Return that over the records of ``other`` that are fitted, weighed alike."""
        found = cls([stretch for stretch in other.stretches if any(stretch.training)], other.motions)
        return found.weighed_like(other)


def evidence_in_noise(simulation: Simulation, start: Hypothesis, found: Sequence[Hypothesis]) -> list[float]:
    """Evidence of each of ``found`` over ``start``, which holds where noise is not independent.

    The likelihood ratio takes lines of a spectrum for independent; near a weakly damped resonance they are
    not, so it is measured in what draws of the noise give in its direction.
    """
    if not found:
        return []
    chosen = simulation.held_out
    penalty = math.log(sum(window.stop - window.start for _, window, _ in simulation.places))
    noise = [
        simulation.weigh(noise_floor(simulation, start.point, start.held, seed=seed).errors, chosen)[0]
        for seed in range(DRAWS)
    ]
    edges, _ = simulation.parts(chosen)
    before = simulation.weigh(start.held, chosen)[0]
    rows = []
    for step in found:
        often = spread(simulation.weigh(step.held, chosen)[0] - before, noise, edges)
        numbers = len(step.fitted.free) - len(start.fitted.free)
        rows.append((start.cost - step.cost) / max(1.0, often) - penalty * numbers)
    return rows


def evidence_beyond_noise(name: str) -> float:
    """Evidence in noise that the effect ``name`` needs."""
    in_time = EFFECTS[name].follows_time
    return THRESHOLDS.small_evidence_in_time if in_time else THRESHOLDS.small_evidence


def spread(change: Array, noise: list[Array], edges: NDArray[np.int64]) -> float:
    """Variance of ``noise`` in the direction of ``change`` over that of independent numbers.

    Both are weighed, shape (m,); ``edges`` are where their windows begin, which are independent.
    """
    along = [np.add.reduceat(change * row, edges[:-1]) for row in noise]
    return float(np.mean([np.sum(row**2) for row in along])) / max(1e-30, float(change @ change))
