"""Time stepping of Moreau and Jean with the midpoint rule: no Runge-Kutta, no root finding.

Steps are short and of equal length: half a step of drift, all impulses together, half a step of drift.
Within a step the forces are held; dry friction is set-valued, so that a step which would reverse the motion
is split where the velocity vanishes and goes on, or rests, from there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

from .internal_states import STATES, advance_states, force_of_states, has_states
from .laws import (
    BRISTLE,
    BRISTLE_DAMPING,
    HYSTERESIS,
    HYSTERESIS_TRAVEL,
    LOOSE_FRICTION,
    LOOSE_MASS,
    MASS,
    bristle_after,
    drag,
    dry,
    hysteresis_after,
    restoring,
)

Array = NDArray[np.float64]


@compiled
def remembered(v: float, x: float, duration: float, p: Array) -> float:
    """Return the force of what has a memory, N, in the middle of a step of ``duration`` at velocity ``v``."""
    if p[BRISTLE] > 0.0:
        after = bristle_after(x, v, 0.5 * duration, p)
        rate = (bristle_after(x, v, duration, p) - x) / duration
        return float(p[BRISTLE] * after + p[BRISTLE_DAMPING] * rate)
    if p[HYSTERESIS] > 0.0:
        return float(p[HYSTERESIS] / p[HYSTERESIS_TRAVEL] * hysteresis_after(x, v, 0.5 * duration, p))
    return 0.0


@compiled
def kick(v: float, speed: float, pull: float, h: float, p: Array) -> float:
    """Return the velocity after ``h`` s under ``pull`` (m/s^2) and dry friction at ``speed``."""
    mass = p[MASS]
    if v == 0.0:
        direction = 1.0 if pull > 0.0 else -1.0
        free = abs(pull) - dry(0.0, direction, p) / mass
        return float(direction * max(free, 0.0) * h)
    direction = 1.0 if v > 0.0 else -1.0
    against = dry(abs(speed), direction, p) / mass
    after = v + h * (pull - direction * against)
    if after * direction > 0.0:
        return float(after)
    # Comes to rest inside the step: what is left of it starts from rest.
    left = h - v / (direction * against - pull)
    onward = 1.0 if pull > 0.0 else -1.0
    free = abs(pull) - dry(0.0, onward, p) / mass
    return float(onward * max(free, 0.0) * left)


@compiled
def step_through(excitation: Array, h: float, start: float, p: Array) -> tuple[Array, Array]:
    """Move a spool from rest and return (spool's acceleration m/s^2, displacement m), shapes (n,).

    Both belong to the middles of the steps, as ``excitation`` does.

    Args:
        excitation: acceleration of the body in the middle of each step, m/s^2, shape (n,).
        h: length of a step, s.
        start: time at the begin of the first step, s.
        p: numbers of the plant in the order of ``laws.NAMES``.
    """
    count = excitation.size
    acceleration, displacement = np.empty(count), np.empty(count)
    mass = p[MASS]
    z, v, x, loose = 0.0, 0.0, 0.0, 0.0
    states, more = np.zeros(STATES), has_states(p)
    for n in range(count):
        t = start + (n + 0.5) * h
        body = excitation[n]
        middle = z + 0.5 * h * v
        speed, after = v, v
        for _ in range(2):  # the second time with the velocity in the middle: second order
            force = restoring(middle, speed, t, p) + drag(middle, speed, t, p) + remembered(speed, x, h, p)
            if more:
                force += force_of_states(states, middle, speed, h, p)
            after = kick(v, speed, -body - force / mass, h, p)
            speed = 0.5 * (v + after)
        if p[LOOSE_MASS] > 0.0:
            loose -= h * body
            reduced = mass * p[LOOSE_MASS] / (mass + p[LOOSE_MASS])
            impulse = min(max(reduced * (after - loose), -h * p[LOOSE_FRICTION]), h * p[LOOSE_FRICTION])
            after -= impulse / mass
            loose += impulse / p[LOOSE_MASS]
            speed = 0.5 * (v + after)
        if p[BRISTLE] > 0.0:
            x = bristle_after(x, speed, h, p)
        elif p[HYSTERESIS] > 0.0:
            x = hysteresis_after(x, speed, h, p)
        if more:
            advance_states(states, middle, speed, body, h, p)
        acceleration[n] = (after - v) / h + body
        displacement[n] = middle
        z = middle + 0.5 * h * after
        v = after
    return acceleration, displacement
