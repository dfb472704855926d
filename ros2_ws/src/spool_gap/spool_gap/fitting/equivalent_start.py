"""Equivalent numbers, with which one law of dry friction acts like another: where its fit starts best.

Laws of friction act alike over the speeds of a record, so their fits end in long flat minima. Matched
force by force, over speed, they start at the bottom.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from spool_sim.terms import term

from spool_gap.simulation.point import Point

Array = NDArray[np.float64]

VISCOUS = "viscous_coefficient"
#: Quantiles of the speed at which forces are compared.
SPEEDS = np.linspace(0.02, 0.98, 49)


def slides(name: str) -> bool:
    """Whether the term ``name`` is dry friction that depends on speed alone."""
    laws = term(name).laws
    return "sliding_law" in laws and "memory_law" not in laws


def friction(name: str, point: Point, speeds: Array) -> Array:
    """Return the force of the sliding law ``name`` and of the viscous drag at ``speeds`` (n,), N."""
    still = np.zeros_like(speeds)
    return np.asarray(point.values[VISCOUS] * speeds + term(name).force(still, speeds, still, point.values))


def acting_alike(like: Point, law: str, start: Point, other: str, own: Sequence[str], speed: Array) -> Point:
    """Return ``start`` with the numbers with which ``other`` acts most like ``law`` in ``like``.

    Args:
        own: numbers of ``other`` that are fitted; the viscous coefficient is, too.
        speed: abs(z') while moving, m/s, shape (n,).

    """
    speeds: Array = np.asarray(np.quantile(speed, SPEEDS), dtype=np.float64)
    wanted = friction(law, like, speeds)
    bounds = {p.name: (p.low, p.high) for p in term(other).parameters}
    names = [VISCOUS, *own]
    first = np.array([max(start.values[name], 1e-9) for name in names])
    low, high = np.array([bounds.get(name, (0.0, np.inf)) for name in names]).T

    def moved(x: Array) -> Point:
        return start.moved(names, np.clip(first * np.exp(x), low, high).tolist())

    found = least_squares(lambda x: friction(other, moved(x), speeds) - wanted, np.zeros(len(names)))
    return moved(found.x)
