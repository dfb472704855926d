"""Internal states of a plant: Maxwell's slip elements, an oil chamber that leaks, the coils of a spring.

Row of states: deflections of the slip elements (m), the chamber's force (N), displacement (m) and velocity
(m/s) of the coils relative to the body.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

from .laws import CHAMBER, CHAMBER_TIME, SLIP, SLIP_TRAVEL, STIFFNESS, SURGE, SURGE_DAMPING

Array = NDArray[np.float64]

#: Slip elements: four follow the curve of many to some per cent of the force.
ELEMENTS = 4
STATES = ELEMENTS + 3
_CHAMBER, _COILS, _COILS_SPEED = ELEMENTS, ELEMENTS + 1, ELEMENTS + 2


@compiled
def has_states(p: Array) -> bool:
    """Return whether the plant has any of these states."""
    return bool(p[SLIP] > 0.0 or p[CHAMBER] > 0.0 or p[SURGE] > 0.0)


@compiled
def slipped(x: float, way: float, limit: float) -> float:
    """Return the deflection of a slip element (m) after ``way`` m: it slides at its ``limit``."""
    return float(min(max(x + way, -limit), limit))


@compiled
def relaxed(force: float, v: float, duration: float, p: Array) -> float:
    """Return the chamber's force (N) after moving at ``v`` for ``duration``: exact for constant v."""
    aim = p[CHAMBER] * p[CHAMBER_TIME] * v
    return float(aim + (force - aim) * math.exp(-duration / p[CHAMBER_TIME]))


@compiled
def force_of_states(states: Array, z: float, v: float, h: float, p: Array) -> float:
    """Return the force against the motion (N) in the middle of a step of ``h`` s, at ``z`` m and ``v`` m/s.

    The spring's own force, which the coils pass on, counts with ``laws.restoring``: here is what differs.
    """
    force = 0.0
    if p[SLIP] > 0.0:
        for j in range(ELEMENTS):
            limit = p[SLIP_TRAVEL] * (j + 1) / ELEMENTS
            force += p[SLIP] / ELEMENTS / limit * slipped(states[j], 0.5 * h * v, limit)
    if p[CHAMBER] > 0.0:
        force += relaxed(states[_CHAMBER], v, 0.5 * h, p)
    if p[SURGE] > 0.0:
        middle = states[_COILS] + 0.5 * h * states[_COILS_SPEED]
        force += 2.0 * p[STIFFNESS] * (z - middle) - p[STIFFNESS] * z
    return float(force)


@compiled
def advance_states(states: Array, z: float, v: float, body: float, h: float, p: Array) -> None:
    """Advance ``states`` in place by a step of ``h`` s, in whose middle the spool is at ``z`` with ``v``.

    ``body`` is the acceleration of the body, m/s^2, which the coils feel as the spool does.
    """
    if p[SLIP] > 0.0:
        for j in range(ELEMENTS):
            states[j] = slipped(states[j], h * v, p[SLIP_TRAVEL] * (j + 1) / ELEMENTS)
    if p[CHAMBER] > 0.0:
        states[_CHAMBER] = relaxed(states[_CHAMBER], v, h, p)
    if p[SURGE] > 0.0:
        middle = states[_COILS] + 0.5 * h * states[_COILS_SPEED]
        pull = 2.0 * p[STIFFNESS] * (z - 2.0 * middle) - p[SURGE_DAMPING] * states[_COILS_SPEED]
        states[_COILS_SPEED] += h * (pull / p[SURGE] - body)
        states[_COILS] = middle + 0.5 * h * states[_COILS_SPEED]
