"""Nonlinear least squares within bounds, for residuals that run in batches.

Levenberg and Marquardt's step, each solved as a bounded linear problem, so that a parameter may sit on its
bound (no friction at all) and leave it again. The slopes of all parameters are one batch, and so are the
trials of all dampings; that is what a simulation on several parameter sets at once is good at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from .residuals import Residuals

Array = NDArray[np.float64]

#: Dampings that are tried at once, relative to the squared slopes.
DAMPINGS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
#: The descent ends where a step promises less than this share of the cost.
SMALLEST_GAIN = 1e-6
#: Largest change of an unknown in one step, in its typical size.
LONGEST_STEP = 1.0


@dataclass(frozen=True, slots=True)
class Descent:
    """Where a descent ended.

    Attributes:
        point: shape (u,).
        cost: half the sum of squares there.
        converged: no step promised more.
    """

    point: Array
    cost: float
    converged: bool


def descend(residuals: Residuals, start: Array, scales: Array, most_steps: int) -> Descent:
    """Return the end of the descent from ``start``.

    Args:
        residuals: what is made small; gives the bounds.
        start: shape (u,), within the bounds.
        scales: typical size of each unknown, shape (u,).
        most_steps: after which the descent ends without having converged.
    """
    low = np.array([unknown.low for unknown in residuals.unknowns])
    high = np.array([unknown.high for unknown in residuals.unknowns])
    point, cost, converged = start, float("inf"), False
    if not point.size:
        return Descent(point, 0.5 * float(np.sum(residuals.at(point) ** 2)), True)
    for _ in range(most_steps):
        residual, slopes = residuals.at_with_slopes(point)
        cost = 0.5 * float(residual @ residual)
        triangle = np.asarray(np.linalg.qr(np.column_stack([slopes * scales, residual]), mode="r"))
        matrix, right = triangle[:, :-1], -triangle[:, -1]
        box = (
            np.maximum((low - point) / scales, -LONGEST_STEP),
            np.minimum((high - point) / scales, LONGEST_STEP),
        )
        steps = np.array([_step(matrix, right, damping, box) for damping in DAMPINGS])
        promised = cost - 0.5 * float(np.sum((matrix @ steps[0] - right) ** 2))
        if promised <= SMALLEST_GAIN * cost:
            converged = True
            break
        trials = np.clip(point + steps * scales, low, high)
        costs = residuals.costs(trials)
        best = int(np.argmin(costs))
        if not costs[best] < cost:
            # Slopes of a rough cost promise what no step keeps.
            converged = promised <= 1e-3 * cost
            break
        gained = cost - float(costs[best])
        point, cost = trials[best], float(costs[best])
        if gained <= SMALLEST_GAIN * cost:
            converged = True
            break
    return Descent(point, cost, converged)


def _step(matrix: Array, right: Array, damping: float, box: tuple[Array, Array]) -> Array:
    """Return the bounded step with ``damping``, in typical sizes."""
    count = matrix.shape[1]
    sizes = np.linalg.norm(matrix, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    rows = np.vstack([matrix, np.sqrt(damping + 1e-12) * np.diag(sizes)])
    # A box without width has no inside: such an unknown stays where it is.
    low, high = np.minimum(box[0], 0.0), np.maximum(box[1], 0.0)
    wide = high - low > 0.0
    step = np.zeros(count)
    if wide.any():
        target = np.concatenate([right, np.zeros(count)])
        step[wide] = lsq_linear(rows[:, wide], target, (low[wide], high[wide]), method="bvls").x
    return step
