"""Motion with dry friction: sticking and slipping, step by step.

m z'' = -m w'' - k z - c v - F_c Sgn(v)

Between reversals the motion is linear: one Taylor step of order five. Reversal, sticking and release are
located within the step. There the derivatives of v jump by the ratio of the accelerations after and before
(saltation: Leine and Nijmeijer, Bifurcations of Non-Smooth Systems, 2004, ch. 7); they are zero in sticking.

The acceleration jumps at a reversal. A sensor whose output is band-limited before it is sampled shows that
jump at the sub-sample instant; ``spread`` holds what such samples differ by from the point values, on the
four samples around: a sequence with the same moments up to the third as the jump itself.
"""

from __future__ import annotations

import math

import numpy as np
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_sim.integration.release import release

#: Places in the state: z (m), v (m/s), direction of slip (0 while sticking), then dz and dv by k, c, F_c.
MOTION_STATES = 9
#: Events within a sample that are followed; later ones wait for the next sample.
MOST_EVENTS = 12

# Coefficients of t^0 to t^3 of the Lagrange polynomials on the nodes -1, 0, 1, 2.
_LAGRANGE = (
    (0.0, -1.0 / 3.0, 0.5, -1.0 / 6.0),
    (1.0, -0.5, -1.0, 0.5),
    (0.0, 1.0, 0.5, -0.5),
    (0.0, -1.0 / 6.0, 0.0, 1.0 / 6.0),
)


@compiled
def velocity(v: float, d1: float, d2: float, d3: float, d4: float, d5: float, t: float) -> float:
    """Return v after ``t`` s by its derivatives ``d1`` to ``d5``."""
    return v + t * (d1 + t * 0.5 * (d2 + t * (1.0 / 3.0) * (d3 + t * 0.25 * (d4 + t * 0.2 * d5))))


@compiled
def displacement(z: float, v: float, d1: float, d2: float, d3: float, d4: float, t: float) -> float:
    """Return z after ``t`` s by v and its derivatives."""
    return z + t * (v + t * 0.5 * (d1 + t * (1.0 / 3.0) * (d2 + t * 0.25 * (d3 + t * 0.2 * d4))))


@compiled
def rates(
    z: float, v: float, force: float, excitation: tuple[float, float, float], k: float, c: float,
    per_mass: float
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Return the derivatives of v by time, first to fifth.

    ``force`` is the dry friction, N; ``excitation`` what the body's motion gives, m/s^2, and its first two
    derivatives by time.
    """
    d1 = excitation[0] - (k * z + c * v + force) * per_mass
    d2 = excitation[1] - (k * v + c * d1) * per_mass
    d3 = excitation[2] - (k * d1 + c * d2) * per_mass
    d4 = -(k * d2 + c * d3) * per_mass
    d5 = -(k * d3 + c * d4) * per_mass
    return d1, d2, d3, d4, d5


@compiled
def derived(
    p: float, q: float, by: tuple[float, float, float, float], k: float, c: float, per_mass: float, t: float
) -> tuple[float, float]:
    """Return ``p`` and ``q``, derivatives of z and v by a parameter, after ``t`` s.

    ``by`` is the derivative of the force by that parameter, and its first three derivatives by time.
    """
    e1 = -(k * p + c * q + by[0]) * per_mass
    e2 = -(k * q + c * e1 + by[1]) * per_mass
    e3 = -(k * e1 + c * e2 + by[2]) * per_mass
    e4 = -(k * e2 + c * e3 + by[3]) * per_mass
    return (
        p + t * (q + t * 0.5 * (e1 + t * (1.0 / 3.0) * (e2 + t * 0.25 * e3))),
        q + t * (e1 + t * 0.5 * (e2 + t * (1.0 / 3.0) * (e3 + t * 0.25 * e4))),
    )


@compiled
def spread_jump(spread: Array, u: float, jump: float, by_k: float, by_c: float, by_f: float) -> None:
    """Add a jump (m/s^2) of the acceleration at share ``u`` after a sample to the four samples around.

    ``spread`` has the shape (4, 4): acceleration and its derivatives by k, c, F_c against the samples -1, 0,
    1 and 2. ``by_k``, ``by_c``, ``by_f``: areas of the derivatives' pulses, in sample periods.
    """
    moment0 = 0.5 - u
    moment1 = 1.0 / 12.0 - u * u / 2.0
    moment2 = -u * u * u / 3.0
    moment3 = -1.0 / 120.0 - u * u * u * u / 4.0
    for node in range(4):
        l0, l1, l2, l3 = _LAGRANGE[node]
        spread[0, node] += jump * (l0 * moment0 + l1 * moment1 + l2 * moment2 + l3 * moment3)
        pulse = l0 + u * (l1 + u * (l2 + u * l3))
        spread[1, node] += pulse * by_k
        spread[2, node] += pulse * by_c
        spread[3, node] += pulse * by_f


@compiled
def advance_sample(
    state: Array, a0: float, am: float, a1: float, period: float, pieces: int, mass: float, parameters: Array,
    spread: Array
) -> tuple[float, float]:  # fmt: skip
    """Move ``state`` (shape (9,)) on by one sample, in place.

    Args:
        state: see MOTION_STATES.
        a0, am, a1: acceleration of the body at the sample, halfway and at the next one, m/s^2.
        period: s between samples.
        pieces: Taylor steps that the sample is divided into.
        mass: kg.
        parameters: k (N/m), c (N s/m), F_c (N), shape (3,).
        spread: see ``spread_jump``, added to.

    Returns:
        Shares of the sample at which the acceleration jumped first and last; 2 and -2 where it did not.

    """
    k, c, f = parameters[0], parameters[1], parameters[2]
    per_mass = 1.0 / mass
    b = -3.0 * a0 + 4.0 * am - a1
    d = 2.0 * a0 - 4.0 * am + 2.0 * a1
    z, v, s = state[0], state[1], state[2]
    first, last = 2.0, -2.0
    u = 0.0
    for _ in range(pieces + MOST_EVENTS):
        if u >= 1.0:
            break
        if s == 0.0:
            need = -mass * (a0 + u * (b + u * d)) - k * z
            if abs(need) <= f:
                left = 1.0 - u
                y, s = release(need, -mass * (b + 2.0 * u * d) * left, -mass * d * left * left, -f, f)
                if y > 1.0:
                    s = 0.0
                    break
                u += y * left
            else:
                s = math.copysign(1.0, need)
            if u >= 1.0:
                break
        rest = (1.0 - u) * period
        t = min(rest, period / pieces)
        excitation = -(a0 + u * (b + u * d)), -(b + 2.0 * u * d) / period, -2.0 * d / (period * period)
        d1, d2, d3, d4, d5 = rates(z, v, s * f, excitation, k, c, per_mass)
        end = velocity(v, d1, d2, d3, d4, d5, t)
        stops = s * end <= 0.0
        if stops:
            before = 0.0 if s * v > 0.0 else _instant_of_slip(v, d1, d2, d3, d4, d5, s, t)
            if before < 0.0:
                state[4] = state[6] = state[8] = 0.0
                v = s = 0.0  # too short to move: the next sample settles it
                break
            t = _stopping_time(v, d1, d2, d3, d4, d5, s, before, t)
            end = 0.0
        force_by = (z, v, d1, d2), (v, d1, d2, d3), (s, 0.0, 0.0, 0.0)
        for j in range(3):
            state[3 + 2 * j], state[4 + 2 * j] = derived(
                state[3 + 2 * j], state[4 + 2 * j], force_by[j], k, c, per_mass, t
            )
        z = displacement(z, v, d1, d2, d3, d4, t)
        v = end
        u = 1.0 if t >= rest else u + t / period
        if stops:
            need = -mass * (a0 + u * (b + u * d)) - k * z
            s = _stop(state, spread, u, need, s, f, per_mass, period)
            first, last = min(first, u), u
    state[0], state[1], state[2] = z, v, s
    return first, last


@compiled
def slip_matrix(period: float, mass: float, parameters: Array, matrix: Array) -> None:
    """Fill ``matrix`` (shape (8, 8)) with what ``slip`` moves the state by.

    While the spool slips on in one direction the step is linear: a column is what it makes of a unit of z, v,
    direction, a0, am, a1, and, of the derivatives by any parameter, with their z and v.
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
    """Move ``state`` on by one sample as ``advance_sample`` does, if the slip lasts that long.

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
def _stop(
    state: Array, spread: Array, u: float, need: float, s: float, f: float, per_mass: float, period: float
) -> float:
    """End a slip in direction ``s`` at share ``u``: its acceleration jumps; return the direction after it."""
    slowing = (need - s * f) * per_mass
    following = 0.0
    s = 0.0
    if abs(need) > f:
        s = math.copysign(1.0, need)
        following = (need - s * f) * per_mass
    kept = following / slowing if slowing != 0.0 else 0.0
    lost = (kept - 1.0) / period
    spread_jump(spread, u, following - slowing, lost * state[4], lost * state[6], lost * state[8])
    state[4] *= kept
    state[6] *= kept
    state[8] *= kept
    return s


@compiled
def _instant_of_slip(
    v: float, d1: float, d2: float, d3: float, d4: float, d5: float, s: float, rest: float
) -> float:
    """Return a time of slip, s, before the spool is at ``rest`` again, -1 where it does not move."""
    for halving in range(1, 21):
        t: float = rest * 0.5**halving
        if s * velocity(v, d1, d2, d3, d4, d5, t) > 0.0:
            return t
    return -1.0


@compiled
def _stopping_time(
    v: float, d1: float, d2: float, d3: float, d4: float, d5: float, s: float, low: float, high: float
) -> float:
    """Return when the slip in direction ``s`` ends: it goes on at ``low`` and has ended at ``high``, s."""
    t = high
    for _ in range(50):
        value = s * velocity(v, d1, d2, d3, d4, d5, t)
        slope = s * (d1 + t * (d2 + t * 0.5 * (d3 + t * (1.0 / 3.0) * (d4 + t * 0.25 * d5))))
        if value > 0.0:
            low = t
        else:
            high = t
        newer = t - value / slope if slope < 0.0 else low
        if not low < newer < high:
            newer = 0.5 * (low + high)
        if abs(newer - t) <= 1e-9 * high:
            return newer
        t = newer
    return t


@compiled
def _row(matrix: Array, i: int, z: float, v: float, s: float, a0: float, am: float, a1: float) -> float:
    moved: float = matrix[i, 0] * z + matrix[i, 1] * v + matrix[i, 2] * s
    driven: float = matrix[i, 3] * a0 + matrix[i, 4] * am + matrix[i, 5] * a1
    return moved + driven
