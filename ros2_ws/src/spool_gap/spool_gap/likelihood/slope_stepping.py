"""Prediction with its slopes: errors and their changes with every number in one pass, at a fifth of the cost.

Between events the linear valve (mass, spring, drag) is propagated exactly, for a parabolic input; what is not
linear in the motion acts as a parabola through its values at the beginning, the middle and the end of the
step. Changes of the motion travel along: through the linear step by the same matrix, and by half kicks of
what the laws change before and after it. A step in which something happens (reversal, rest, release,
contact) is that of :mod:`spool_sim.integration.stepping`; at a reversal a change of velocity jumps by the
ratio of the accelerations after and before it, and a release is taken from a second such step.

:mod:`spool_gap.likelihood.kernel` joins this with the stepping of its laws into one module.

Sources: Cox and Matthews, 2002 (exponential time differencing of third order); Strang, 1968; Galan, Feehery
and Barton, 1999 (sensitivities of systems with events).
"""

# A kernel takes numbers and arrays, in one piece:
# ruff: noqa: PLR0912, PLR0915

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled, inlined, inner
from spool_core.numbers import Array
from spool_sim.integration.fluid_laws import EVENTS, MASS, given, next_level, rest, start_memory
from spool_sim.integration.stepping import FARTHEST, FASTEST, Numbers, step_with_events

#: Numbers of the terms that act besides the linear valve, of those among them whose force depends on
#: displacement and on velocity, and of those that each number of a fit belongs to, shape (u, most), -1: none.
Terms = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


@inner
def term_force(number: int, z: float, v: float, t: float, s: float, q: Numbers) -> float:  # noqa: ARG001
    """Return the force of one term at a motion in direction ``s``, N; a kernel's laws bring their own."""
    return 0.0


#: Square of the angle (rad, or share of a time constant) that the forces besides the linear valve's may turn
#: the motion by in a step: what is stiffer, such as a contact, is stepped by the Runge-Kutta pieces.
STIFF = 1e-3


@inlined
def acting_force(acting: NDArray[np.int64], z: float, v: float, t: float, s: float, q: Numbers) -> float:
    """Return the force of the terms ``acting``, N."""
    total = 0.0
    for number in acting:
        total += term_force(number, z, v, t, s, q)
    return total


@inlined
def smooth_step(
    z: float, v: float, s: float, here: float, t: float, h: float, a0: float, am: float, a1: float,
    acting: NDArray[np.int64], linear: Array, q: Numbers,
) -> tuple[float, float, bool]:  # fmt: skip
    """Return (z, v) after a step in direction ``s``, and whether nothing happened in it.

    ``here`` is the force of the terms ``acting`` at its beginning. ``linear``: the transition of a whole and
    of half a step, five numbers for each of (z, v): by z, v, and the three coefficients of the input.
    """
    b, d = -3.0 * a0 + 4.0 * am - a1, 2.0 * a0 - 4.0 * am + 2.0 * a1
    vm = v
    if acting.size:
        first = here / q[MASS]
        a = a0 + first
        zm = linear[10] * z + linear[11] * v + linear[12] * a + 0.5 * linear[13] * b + 0.25 * linear[14] * d
        vm = linear[15] * z + linear[16] * v + linear[17] * a + 0.5 * linear[18] * b + 0.25 * linear[19] * d
        middle = acting_force(acting, zm, vm, t + 0.5 * h, s, q) / q[MASS]
        a = a0 + 2.0 * middle - first
        ze = linear[0] * z + linear[1] * v + linear[2] * a + linear[3] * b + linear[4] * d
        ve = linear[5] * z + linear[6] * v + linear[7] * a + linear[8] * b + linear[9] * d
        last = acting_force(acting, ze, ve, t + h, s, q) / q[MASS]
        a0 += first
        b += -3.0 * first + 4.0 * middle - last
        d += 2.0 * first - 4.0 * middle + 2.0 * last
    z1 = linear[0] * z + linear[1] * v + linear[2] * a0 + linear[3] * b + linear[4] * d
    v1 = linear[5] * z + linear[6] * v + linear[7] * a0 + linear[8] * b + linear[9] * d
    if not EVENTS:
        return z1, v1, True
    calm = s * v > 0.0 and s * vm > 0.0 and s * v1 > 0.0
    return z1, v1, calm and math.isnan(next_level(z, z1, q))


@inner
def velocity_jump(
    z: float, v: float, z1: float, v1: float, t: float, h: float, s: float, a0: float, am: float, a1: float,
    acting: NDArray[np.int64], valve: Array, q: Numbers,
) -> float:  # fmt: skip
    """Return what a reversal makes of a change of velocity: acceleration after it over that before it.

    ``v1``: velocity that the step would end with if the friction did not turn.
    """
    u = min(1.0, max(0.0, v / (v - v1)))
    place, at = z + u * (z1 - z), t + u * h
    pulled = a0 + u * (-3.0 * a0 + 4.0 * am - a1 + u * (2.0 * a0 - 4.0 * am + 2.0 * a1))
    pulled += valve[0, 0] * place / q[MASS]
    before = -pulled - acting_force(acting, place, 0.0, at, s, q) / q[MASS]
    after = -pulled - acting_force(acting, place, 0.0, at, -s, q) / q[MASS]
    return min(1.0, max(0.0, after / before)) if s * before < 0.0 else 0.0


@inner
def released(
    z: float, z1: float, v1: float, x: Numbers, t: float, h: float, a0: float, am: float, a1: float,
    q: Numbers, small_z: float, sz: Array, sv: Array,
) -> None:  # fmt: skip
    """Move the changes ``sz``, ``sv`` of a spool that was held on to (z1, v1), in place.

    The instant of release depends on its place; what a number itself changes of it is left out.
    """
    zz, vz, _, _ = step_with_events(z + small_z, 0.0, 0.0, x, t, h, a0, am, a1, q)
    for j in range(sz.size):
        sv[j] += (vz - v1) / small_z * sz[j]
        sz[j] *= (zz - z1) / small_z


@inlined
def at_node(
    z: float, v: float, t: float, s: float, parameters: Array, terms: Terms, small_z: float, small_v: float,
    pushed: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the force of the terms that act (N), and how it changes with displacement and velocity.

    ``pushed`` becomes the change of the acceleration at this motion with each number of theirs, m/s^2.
    """
    acting, by_place, by_speed, owners = terms
    q = given(parameters, 0)
    here, by_z, by_v = acting_force(acting, z, v, t, s, q), 0.0, 0.0
    side = -small_v if s < 0.0 else small_v
    for number in by_place:
        change = term_force(number, z + small_z, v, t, s, q) - term_force(number, z, v, t, s, q)
        by_z += change / small_z
    for number in by_speed:
        by_v += (term_force(number, z, v + side, t, s, q) - term_force(number, z, v, t, s, q)) / side
    for j in range(pushed.size):
        pushed[j] = 0.0
        for place in range(owners.shape[1]):
            number = owners[j, place]
            if number < 0:
                break
            changed = given(parameters, j + 1)
            change = term_force(number, z, v, t, s, changed) - term_force(number, z, v, t, s, q)
            pushed[j] -= change / q[MASS]
    return here, by_z, by_v


@inner
def held_at_rest(z: float, s: float, q: Numbers) -> bool:
    """Return whether dry friction holds a spool that has no direction."""
    if not EVENTS or s != 0.0:
        return False
    low, high = rest(z, q)
    return low < high


@inlined
def forced_change(row: Array, i: int, linear: Array, place: int) -> float:
    """Return what the change ``row`` of the body's acceleration in the step at ``i`` adds to z or v."""
    b, d = -3.0 * row[i] + 4.0 * row[i + 1] - row[i + 2], 2.0 * row[i] - 4.0 * row[i + 1] + 2.0 * row[i + 2]
    return float(linear[place] * row[i] + linear[place + 1] * b + linear[place + 2] * d)


@compiled
def predict_slopes_kernel(
    body: Array,
    measured: Array,
    heard: Array,
    h: float,
    substeps: int,
    parameters: Array,
    terms: Terms,
    valve: Array,
    linear: Array,
    forced: Array,
    forced_rows: NDArray[np.int64],
    shifted: Array,
    shifted_rows: NDArray[np.int64],
    small_z: float,
    small_v: float,
    correction_z: float,
    correction_v: float,
    largest: float,
    means: bool,
    begin: float,
    out_error: Array,
    out_z: Array,
    out_v: Array,
    out_slopes: Array,
) -> None:
    """Fill what ``predict_kernel`` does, and the change of each error with each of u numbers, (n, u).

    Row 0 of ``parameters`` holds; row j + 1 is changed in number j. ``valve``: stiffness and
    drag of the linear valve, and their changes with each number over minus the mass, shape (1 + u, 2). A
    number of the measuring chain changes the body's acceleration by a row of ``forced``, or what was measured
    by one of ``shifted`` (-1: by none).
    """
    count = forced_rows.size
    acting = terms[0]
    q = given(parameters, 0)
    x = start_memory(np.zeros(64))  # no term that remembers acts here
    per_mass, whole, stiffness, drag = 1.0 / q[MASS], h * substeps, valve[0, 0], valve[0, 1]
    by_stiffness, by_drag = valve[1:, 0].copy(), valve[1:, 1].copy()
    chained = (forced_rows >= 0).any() or (shifted_rows >= 0).any()
    z = v = s = here = by_z = by_v = 0.0
    sz, sv, sv_before, pushed = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    change = np.zeros(count)
    stuck = held_at_rest(z, s, q)
    if not stuck:
        here, by_z, by_v = at_node(z, v, begin, s, parameters, terms, small_z, small_v, pushed)
    for n in range(out_error.size):
        first = 2 * substeps * n
        out_z[n] = z
        out_v[n] = v
        before, mean = v, 0.0
        if means:
            sv_before[:] = sv
        for j in range(substeps + 1):
            t = begin + (n * substeps + j) * h
            at_end = j == substeps
            if at_end and not (abs(z) < FARTHEST and abs(v) < FASTEST):
                # Nothing follows from a motion that diverges.
                out_error[n:] = math.inf
                out_z[n:] = 0.0
                out_v[n:] = 0.0
                out_slopes[n:] = 0.0
                return
            if (at_end and means) or (j == 0 and not means):
                # What is predicted: the acceleration at the sample, or its mean from here to the next.
                if means:
                    error = measured[n] - (v - before) / whole - mean / substeps
                    holds = v == 0.0 and EVENTS
                    for k in range(count):
                        change[k] = (sv_before[k] - sv[k]) / whole
                elif stuck:
                    error, holds = measured[n] - body[first], True
                    change[:] = 0.0
                else:
                    error, holds = measured[n] + per_mass * (stiffness * z + drag * v + here), False
                    along_z, along_v = per_mass * (by_z + stiffness), per_mass * (by_v + drag)
                    for k in range(count):
                        change[k] = (
                            along_z * sz[k]
                            + along_v * sv[k]
                            - pushed[k]
                            - by_stiffness[k] * z
                            - by_drag[k] * v
                        )
                out_error[n] = error
                error *= heard[n]
                clipped = abs(error) > largest
                error = min(max(error, -largest), largest)
                if chained:
                    for k in range(count):
                        row = forced_rows[k]
                        if row >= 0 and means:
                            for at in range(first, first + 2 * substeps, 2):
                                part = forced[row, at] + 4.0 * forced[row, at + 1] + forced[row, at + 2]
                                change[k] -= part / (6.0 * substeps)
                        elif row >= 0 and stuck:
                            change[k] -= forced[row, first]
                        if shifted_rows[k] >= 0:
                            change[k] += shifted[shifted_rows[k], n]
                out_slopes[n] = change
                if not holds and not clipped:
                    gain_z, gain_v = correction_z * heard[n], correction_v * heard[n]
                    for k in range(count):
                        sz[k] += gain_z * change[k]
                        sv[k] += gain_v * change[k]
                if not holds or clipped:
                    placed = z
                    z += correction_z * error
                    v += correction_v * error
                    turns = EVENTS and v != 0.0 and s * v <= 0.0
                    if turns:
                        s, stuck = math.copysign(1.0, v), False
                    if turns or not math.isnan(next_level(placed, z, q)):
                        here, by_z, by_v = at_node(z, v, t, s, parameters, terms, small_z, small_v, pushed)
                    elif acting.size:
                        here = acting_force(acting, z, v, t, s, q)
            if at_end:
                break
            i = first + 2 * j
            a0, am, a1 = body[i], body[i + 1], body[i + 2]
            mean += (a0 + 4.0 * am + a1) / 6.0
            calm, z1, v1 = False, z, v
            stiff = max(per_mass * abs(by_z) * h**2, (per_mass * by_v * h) ** 2) > STIFF
            if not EVENTS or v != 0.0:
                z1, v1, calm = smooth_step(z, v, s, here, t, h, a0, am, a1, acting, linear, q)
            jump, s1, calm, told = 1.0, s, calm and not (EVENTS and stiff), False
            z_by_z, z_by_v, v_by_z, v_by_v = linear[0], linear[1], linear[5], linear[6]
            if not calm:
                unturned = v1
                z1, v1, s1, _ = step_with_events(z, v, s, x, t, h, a0, am, a1, q)
                if v1 == 0.0 and s1 == 0.0:
                    jump = 0.0
                elif s * v > 0.0 and s * v1 <= 0.0 and not stiff and math.isnan(next_level(z, z1, q)):
                    jump = velocity_jump(z, v, z1, unturned, t, h, s, a0, am, a1, acting, valve, q)
                elif v != 0.0:
                    told = True
                    # A contact, or a stiff force: the step itself tells what becomes of a change.
                    z2, v2, _, _ = step_with_events(z + small_z, v, s, x, t, h, a0, am, a1, q)
                    z_by_z, v_by_z = (z2 - z1) / small_z, (v2 - v1) / small_z
                    z2, v2, _, _ = step_with_events(z, v + s * small_v, s, x, t, h, a0, am, a1, q)
                    z_by_v, v_by_v = s * (z2 - z1) / small_v, s * (v2 - v1) / small_v
                    by_z = by_v = 0.0
            if v != 0.0 or calm:
                kick, along_z, along_v = 0.5 * h, per_mass * by_z, per_mass * by_v
                for k in range(count):
                    rate = pushed[k] + by_stiffness[k] * z + by_drag[k] * v
                    w = sv[k] + kick * (rate - along_z * sz[k] - along_v * sv[k])
                    sv[k] = jump * (v_by_z * sz[k] + v_by_v * w)
                    sz[k] = z_by_z * sz[k] + z_by_v * w
                if chained:
                    for k in range(count):
                        if forced_rows[k] >= 0:
                            sz[k] += forced_change(forced[forced_rows[k]], i, linear, 2)
                            sv[k] += jump * forced_change(forced[forced_rows[k]], i, linear, 7)
            elif v1 != 0.0:
                released(z, z1, v1, x, t, h, a0, am, a1, q, small_z, sz, sv)
            z, v, s = z1, v1, s1
            if EVENTS and not calm:
                if v != 0.0:
                    s = math.copysign(1.0, v)
                stuck = held_at_rest(z, s, q)
            if not stuck:
                here, by_z, by_v = at_node(z, v, t + h, s, parameters, terms, small_z, small_v, pushed)
                if v != 0.0 or not EVENTS:
                    kick, along_z, along_v = 0.5 * h, per_mass * by_z, per_mass * by_v
                    if told:
                        along_z = along_v = 0.0
                    for k in range(count):
                        rate = pushed[k] + by_stiffness[k] * z + by_drag[k] * v
                        sv[k] += kick * (rate - along_z * sz[k] - along_v * sv[k])
