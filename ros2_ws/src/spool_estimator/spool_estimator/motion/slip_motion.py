"""Motion of the spool over a sample in which it slips on in one direction: linear, so a matrix moves it.

The same Taylor step as :mod:`.friction_motion` takes there, three times as fast; most samples are such.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

from .friction_motion import derived, displacement, rates, velocity

Array = NDArray[np.float64]


@compiled
def slip_matrix(period: float, mass: float, parameters: Array, matrix: Array) -> None:
    """Fill ``matrix`` (shape (8, 8)) with what ``slip`` moves the state by.

    While the spool slips on in one direction the step is linear: a column is what it makes of a unit of z, v,
    direction, a0, am, a1, and, of the derivatives by any parameter, of their own z and v.
    """
    k, c, f = parameters[0], parameters[1], parameters[2]
    per_mass = 1.0 / mass
    unit = np.zeros(6)
    for column in range(6):
        unit[:] = 0.0
        unit[column] = 1.0
        z, v, s, a0, am, a1 = unit
        b = -3.0 * a0 + 4.0 * am - a1
        d = 2.0 * a0 - 4.0 * am + 2.0 * a1
        excitation = -a0, -b / period, -2.0 * d / (period * period)
        d1, d2, d3, d4, d5 = rates(z, v, s * f, excitation, k, c, per_mass)
        matrix[0, column] = displacement(z, v, d1, d2, d3, d4, period)
        matrix[1, column] = velocity(v, d1, d2, d3, d4, d5, period)
        force_by = (z, v, d1, d2), (v, d1, d2, d3), (s, 0.0, 0.0, 0.0)
        for j in range(3):
            matrix[2 + 2 * j, column], matrix[3 + 2 * j, column] = derived(
                0.0, 0.0, force_by[j], k, c, per_mass, period
            )
    for j in range(4):
        nothing = (0.0, 0.0, 0.0, 0.0)
        matrix[2 * j, 6], matrix[2 * j + 1, 6] = derived(1.0, 0.0, nothing, k, c, per_mass, period)
        matrix[2 * j, 7], matrix[2 * j + 1, 7] = derived(0.0, 1.0, nothing, k, c, per_mass, period)


@compiled
def slip(state: Array, a0: float, am: float, a1: float, matrix: Array) -> bool:
    """Move ``state`` on by one sample as ``advance_sample`` does, if the slip goes on for so long.

    Where it ends within the sample, or the spool sticks, leave ``state`` as it is and return False.
    """
    z, v, s = state[0], state[1], state[2]
    end = _row(matrix, 1, z, v, s, a0, am, a1)
    if s * end <= 0.0:
        return False
    for j in range(3):
        p, q = state[3 + 2 * j], state[4 + 2 * j]
        i = 2 + 2 * j
        state[3 + 2 * j] = matrix[i, 6] * p + matrix[i, 7] * q + _row(matrix, i, z, v, s, a0, am, a1)
        i += 1
        state[4 + 2 * j] = matrix[i, 6] * p + matrix[i, 7] * q + _row(matrix, i, z, v, s, a0, am, a1)
    state[0] = _row(matrix, 0, z, v, s, a0, am, a1)
    state[1] = end
    return True


@compiled
def _row(matrix: Array, i: int, z: float, v: float, s: float, a0: float, am: float, a1: float) -> float:
    moved: float = matrix[i, 0] * z + matrix[i, 1] * v + matrix[i, 2] * s
    driven: float = matrix[i, 3] * a0 + matrix[i, 4] * am + matrix[i, 5] * a1
    return moved + driven
