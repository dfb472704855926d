"""Time step for any composition of force terms: smooth Runge-Kutta pieces between located events.

Written for the model ``fluid``; :mod:`spool_sim.integration.composition` replaces ``fluid_laws`` by the laws
of another model and compiles the result as a separate module.

    m z'' + smooth(z, v, t) + friction Sgn(v) = -m a(t)

Events are reversals and coming to rest, release from rest, and kinks of the force in z. Within a step the
forcing is the parabola through its values a0, am, a1; u is the share of the step that is done. Functions that
an FMU has in C take tuples, not classes.
"""

# A kernel takes numbers and arrays, in one piece:
# ruff: noqa: PLR0912, PLR0915

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled, inlined, inner
from spool_core.numbers import Array

from spool_sim.integration.fluid_laws import (
    EVENTS,
    MASS,
    given,
    next_level,
    remembered,
    rest,
    sliding,
    smooth,
    start_memory,
)
from spool_sim.integration.release import release

Numbers = tuple[float, ...]
#: Step: its beginning t and length h (s), and the forcing a0 + u (b + u d), m/s^2: see ``step_of``.
Step = tuple[float, float, float, float, float]
#: Beginning of a slip: z (m), v (m/s), its direction, z'' (m/s^2), share of the step.
Start = tuple[float, float, float, float, float]
#: Slip around an event: ``before`` > 0 is the velocity or the way to the level in the direction of slip at
#: ``low`` s after the start; at ``high``, past the event, stand ``z1`` and ``v1``.
Bracket = tuple[float, float, float, float, float]
#: Arrays to fill: z, v, the spool's acceleration, whether it is stuck, memory; and points, z, v, events.
Motion = tuple[Array, Array, Array, NDArray[np.bool_], Array]
Readings = tuple[Array, Array, Array, Array]
LARGEST_EVENT_COUNT = 40
#: Displacement (m) and speed (m/s) beyond which a prediction has diverged and starts again from rest.
FARTHEST, FASTEST = 1.0, 100.0
#: Share of a step over which one-sided rates are taken.
NEAR = 1e-3


@inlined
def acceleration(
    z: float, v: float, t: float, s: float, a: float, z0: float, x: Numbers, q: Numbers
) -> float:
    """Return z'' while slipping in direction ``s``; the memory ``x`` belongs to ``z0``."""
    force = smooth(z, v, t, remembered(x, z - z0, s, q), q)
    if s != 0.0:
        force += s * sliding(z, max(s * v, 0.0), s, q)
    return -a - force / q[MASS]


@inner
def step_of(t: float, h: float, a0: float, am: float, a1: float) -> Step:
    """Return the step of ``h`` s from ``t`` on, with the forcing at its start, middle and end."""
    return t, h, a0, -3.0 * a0 + 4.0 * am - a1, 2.0 * a0 - 4.0 * am + 2.0 * a1


@inner
def slip(start: Start, x: Numbers, tau: float, step: Step, q: Numbers) -> tuple[float, float]:
    """Return (z, v) after slipping for ``tau`` s."""
    z, v, s, k1, u = start
    t, h, a0, b, d = step
    y = u + 0.5 * tau / h
    e = u + tau / h
    middle = a0 + y * (b + y * d)
    v2 = v + 0.5 * tau * k1
    k2 = acceleration(z + 0.5 * tau * v, v2, t + y * h, s, middle, z, x, q)
    v3 = v + 0.5 * tau * k2
    k3 = acceleration(z + 0.5 * tau * v2, v3, t + y * h, s, middle, z, x, q)
    v4 = v + tau * k3
    k4 = acceleration(z + tau * v3, v4, t + e * h, s, a0 + e * (b + e * d), z, x, q)
    sixth = tau / 6.0
    return z + sixth * (v + 2.0 * (v2 + v3) + v4), v + sixth * (k1 + 2.0 * (k2 + k3) + k4)


@inner
def needed_at_rest(z: float, u: float, x: Numbers, step: Step, q: Numbers) -> float:
    """Return the friction that would hold the spool at rest, N."""
    t, h, a0, b, d = step
    return -q[MASS] * (a0 + u * (b + u * d)) - smooth(z, 0.0, t + u * h, x, q)


@inner
def first_time(
    level: float, start: Start, x: Numbers, bracket: Bracket, step: Step, q: Numbers
) -> tuple[float, float, float]:
    """Return (tau, z, v) at which the slip reaches ``level`` m, or comes to rest where that is not a number.

    Regula falsi (Illinois) on the end of a shortened piece.
    """
    _, _, s, _, _ = start
    _, h, _, _, _ = step
    low, before, high, z1, v1 = bracket
    at_rest = math.isnan(level)
    past = s * v1 if at_rest else s * (level - z1)
    tau = high
    side = 0
    for _ in range(60):
        if high - low <= 1e-13 * h or past == 0.0:
            break
        tau = low + (high - low) * before / (before - past)
        z1, v1 = slip(start, x, tau, step, q)
        value = s * v1 if at_rest else s * (level - z1)
        if abs(value) < 1e-16:
            break
        if value > 0.0:
            low, before = tau, value
            if side == 1:
                past *= 0.5
            side = 1
        else:
            high, past = tau, value
            if side == -1:
                before *= 0.5
            side = -1
    return tau, z1, v1


@inner
def piece(
    z: float, v: float, s: float, x: Numbers, u: float, step: Step, q: Numbers
) -> tuple[float, float, float, Numbers, float, float]:
    """Return (z, v, direction, memory, share) at the next event of a step from share ``u`` on, or at its end.

    The last value is the share at which a spool that was held was released, -1 where none was.
    """
    t, h, a0, b, d = step
    left = (1.0 - u) * h
    released = -1.0
    if v == 0.0:
        low, high = rest(z, q)
        need = needed_at_rest(z, u, x, step, q)
        if low <= need <= high:
            middle = needed_at_rest(z, 0.5 * (u + 1.0), x, step, q)
            end = needed_at_rest(z, 1.0, x, step, q)
            y, s = release(
                need, -3.0 * need + 4.0 * middle - end, 2.0 * (need - 2.0 * middle + end), low, high
            )
            if y > 1.0:
                return z, 0.0, 0.0, x, 1.0, -1.0
            u += y * (1.0 - u)
            released = u
            left = (1.0 - u) * h
            if left <= 0.0:
                return z, 0.0, s, x, 1.0, released
        else:
            s = 1.0 if need > high else -1.0
    k1 = acceleration(z, v, t + u * h, s, a0 + u * (b + u * d), z, x, q)
    start = (z, v, s, k1, u)
    z1, v1 = slip(start, x, left, step, q)
    tau, stops = left, False
    if s * v1 > 0.0:
        rate0 = s * k1
        rate1 = s * acceleration(z1, v1, t + h, s, a0 + b + d, z, x, q) if v != 0.0 and rate0 < 0.0 else 0.0
        if rate1 > 0.0:
            # Both ends slip the same way, but the velocity may have dipped through zero between.
            dip = left * rate0 / (rate0 - rate1)
            z2, v2 = slip(start, x, dip, step, q)
            if s * v2 <= 0.0:
                tau, z1, v1 = first_time(math.nan, start, x, (0.0, s * v, dip, z2, v2), step, q)
                stops = True
    else:
        first, last, before = 0.0, left, s * v
        if v == 0.0:
            # Released and at rest again within the step: find an instant of slip before that.
            first = left
            z2, v2 = z1, v1
            for _ in range(30):
                last, z1, v1 = first, z2, v2
                first *= 0.5
                z2, v2 = slip(start, x, first, step, q)
                if s * v2 > 0.0:
                    break
            before = s * v2
            if before <= 0.0:
                return z, 0.0, 0.0, x, 1.0, -1.0  # too short to move: the next step settles it
        tau, z1, v1 = first_time(math.nan, start, x, (first, before, last, z1, v1), step, q)
        stops = True
    level = next_level(z, z1, q)
    if not math.isnan(level):
        before = s * (level - z)
        tau, _, v1 = first_time(level, start, x, (0.0, before, tau, z1, v1), step, q)
        z1, stops = level, s * v1 <= 0.0
    x = remembered(x, z1 - z, s, q)
    z = z1
    u = 1.0 if tau >= left else u + tau / h
    if not stops:
        return z, v1, s, x, u, released
    low, high = rest(z, q)
    need = needed_at_rest(z, u, x, step, q)
    s = 0.0 if low <= need <= high else math.copysign(1.0, need - 0.5 * (low + high))
    return z, 0.0, s, x, u, released


@inner
def step_with_events(
    z: float, v: float, s: float, x: Numbers, step: Step, q: Numbers
) -> tuple[float, float, float, Numbers]:
    """Return (z, v, direction, memory) after one step; direction 0 is rest."""
    t, h, a0, b, d = step
    u = 0.0
    for _ in range(LARGEST_EVENT_COUNT):
        if v != 0.0:
            s = math.copysign(1.0, v)
        if (1.0 - u) * h <= 0.0:
            break
        z, v, s, x, u, _ = piece(z, v, s, x, u, step, q)
    left = (1.0 - u) * h
    if left > 0.0 and s != 0.0:
        # Events crowd together (the spool comes to rest against a stop): the rest goes in one piece.
        k1 = acceleration(z, v, t + u * h, s, a0 + u * (b + u * d), z, x, q)
        z1, v = slip((z, v, s, k1, u), x, left, step, q)
        x = remembered(x, z1 - z, s, q)
        z = z1
    return z, v, s, x


@inner
def advance_kernel(
    state: Array, body: Array, first_sample: int, h: float, substeps: int, parameters: Array, out: Motion
) -> None:
    """Fill ``out`` at each sample and move ``state`` (z, v, direction, memory...) on, in place."""
    out_z, out_v, out_a, out_stuck, out_memory = out
    z, v, s = state[0], state[1], state[2]
    x = start_memory(state)
    held = parameters.shape[0] == 1
    q = given(parameters, 0)
    for n in range(out_z.size):
        if not held:
            q = given(parameters, n)
        i = 2 * substeps * n
        whole = (first_sample + n) * substeps
        if v != 0.0:
            s = math.copysign(1.0, v)
        stuck = False
        if EVENTS and s == 0.0:
            low, high = rest(z, q)
            stuck = low < high
        out_z[n] = z
        out_v[n] = v
        out_stuck[n] = stuck
        for place in range(out_memory.shape[1]):
            out_memory[n, place] = x[place]
        if stuck:
            out_a[n] = body[i]
        else:
            out_a[n] = acceleration(z, v, whole * h, s if EVENTS else 0.0, 0.0, z, x, q)
        for j in range(substeps):
            t = (whole + j) * h
            step = step_of(t, h, body[i], body[i + 1], body[i + 2])
            if EVENTS:
                z, v, s, x = step_with_events(z, v, s, x, step, q)
            else:
                k1 = acceleration(z, v, t, 0.0, body[i], z, x, q)
                z, v = slip((z, v, 0.0, k1, 0.0), x, h, step, q)
            i += 2
        if not (abs(z) < math.inf and abs(v) < math.inf):
            # Nothing follows from a motion that diverged, and a search for its events costs most of all.
            out_z[n + 1 :] = math.nan
            out_v[n + 1 :] = math.nan
            out_a[n + 1 :] = math.nan
            out_memory[n + 1 :] = math.nan
            out_stuck[n + 1 :] = False
            break
    if not EVENTS:
        s = 0.0
    state[0], state[1], state[2] = z, v, s
    for place in range(out_memory.shape[1]):
        state[3 + place] = x[place]


@compiled
def advance_batch_kernel(
    states: Array,
    body: Array,
    body_rows: NDArray[np.int64],
    first_samples: NDArray[np.int64],
    h: float,
    substeps: int,
    parameters: Array,
    out: Motion,
) -> None:
    """Do the same for valves that stand on one body or on several; the first axis counts them."""
    z, v, a, stuck, memory = out
    for valve in range(states.shape[0]):
        advance_kernel(
            states[valve],
            body[body_rows[valve]],
            first_samples[valve],
            h,
            substeps,
            parameters[valve if parameters.shape[0] > 1 else 0],
            (z[valve], v[valve], a[valve], stuck[valve], memory[valve]),
        )


@compiled
def force_kernel(
    z: Array, v: Array, start: Array, first_sample: int, period: float, parameters: Array, out: Array
) -> None:
    """Fill ``out`` (sets, samples) with the force at given motion from the memory in the state ``start``."""
    for number in range(out.shape[0]):
        q = given(parameters, number)
        x = start_memory(start)
        for n in range(z.size):
            s = 0.0
            if v[n] != 0.0:
                s = math.copysign(1.0, v[n])
            if n > 0:
                moved = z[n] - z[n - 1]
                x = remembered(x, moved, math.copysign(1.0, moved), q)
            force = smooth(z[n], v[n], (first_sample + n) * period, x, q)
            if s != 0.0:
                force += s * sliding(z[n], s * v[n], s, q)
            out[number, n] = force


@inner
def one_side(
    side: float, z: float, v: float, s: float, x: Numbers, u: float, step: Step, q: Numbers
) -> tuple[float, float]:
    """Return the spool's acceleration, m/s^2, just after (``side`` 1) or before (-1) an event, and its rate.

    The rate is over ``h``. At the event, share ``u`` of a step, the spool is at (z, v) and slips in direction
    ``s``, or is held (0).
    """
    t, h, a0, b, d = step
    if s == 0.0:
        return a0 + u * (b + u * d), b + 2.0 * u * d
    tau = side * NEAR * h
    rate = acceleration(z, v, t + u * h, s, a0 + u * (b + u * d), z, x, q)
    first = acceleration(z + tau * (v + 0.5 * tau * rate), v + tau * rate, t + u * h + tau, s, 0.0, z, x, q)
    tau *= 2.0
    second = acceleration(z + tau * (v + 0.5 * tau * rate), v + tau * rate, t + u * h + tau, s, 0.0, z, x, q)
    return 2.0 * first - second, side * (second - first) / NEAR


@inner
def note(
    row: Array, z: float, v: float, s0: float, s1: float, x: Numbers, u: float, step: Step, q: Numbers
) -> None:
    """Fill ``row`` for an event at share ``u`` of a step: slip in direction ``s0`` before, ``s1`` after."""
    before, rate0 = one_side(-1.0, z, v, s0, x, u, step, q)
    after, rate1 = one_side(1.0, z, v, s1, x, u, step, q)
    row[0], row[1], row[2] = u, after - before, rate1 - rate0


@inner
def read_kernel(
    state: Array, body: Array, first_sample: int, h: float, substeps: int, parameters: Array, out: Readings
) -> int:
    """Fill the acceleration at the start of each step, and displacement and velocity at each sample.

    Rows of events become place (steps), jump of the acceleration (m/s^2) and change of its rate
    (m/s^2 over a step) of each event; return how many there are.
    """
    out_points, out_z, out_v, out_events = out
    z, v, s = state[0], state[1], state[2]
    x = start_memory(state)
    count = 0
    for n in range(out_z.size):
        q = given(parameters, min(n, parameters.shape[0] - 1))
        out_z[n] = z
        out_v[n] = v
        for j in range(substeps):
            i = n * substeps + j
            t = (first_sample * substeps + i) * h
            step = step_of(t, h, body[2 * i], body[2 * i + 1], body[2 * i + 2])
            _, _, a0, b, d = step
            if not EVENTS:
                k1 = acceleration(z, v, t, 0.0, a0, z, x, q)
                out_points[i] = k1 + a0
                z, v = slip((z, v, 0.0, k1, 0.0), x, h, step, q)
                continue
            if v != 0.0:
                s = math.copysign(1.0, v)
            stuck = False
            if s == 0.0:
                low, high = rest(z, q)
                stuck = low < high
            out_points[i] = a0 if stuck else acceleration(z, v, t, s, 0.0, z, x, q)
            u = 0.0
            for _ in range(LARGEST_EVENT_COUNT):
                if (1.0 - u) * h <= 0.0:
                    break
                if v != 0.0:
                    s = math.copysign(1.0, v)
                held = z
                z, v1, s1, x, u, released = piece(z, v, s, x, u, step, q)
                if released >= 0.0 and count < out_events.shape[0]:
                    side = s1 if v1 == 0.0 and s1 != 0.0 and u >= 1.0 else math.copysign(1.0, z - held)
                    note(out_events[count], held, 0.0, 0.0, side, x, released, step, q)
                    out_events[count, 0] += i
                    count += 1
                if u < 1.0 and count < out_events.shape[0]:
                    side = math.copysign(1.0, v if v != 0.0 else z - held)
                    note(out_events[count], z, v1, side, s1, x, u, step, q)
                    out_events[count, 0] += i
                    count += 1
                v, s = v1, s1
            left = (1.0 - u) * h
            if left > 0.0 and s != 0.0:
                k1 = acceleration(z, v, t + u * h, s, a0 + u * (b + u * d), z, x, q)
                z1, v = slip((z, v, s, k1, u), x, left, step, q)
                x = remembered(x, z1 - z, s, q)
                z = z1
        if not (abs(z) < FARTHEST and abs(v) < FASTEST):
            out_points[(n + 1) * substeps :] = math.inf
            out_z[n + 1 :] = 0.0
            out_v[n + 1 :] = 0.0
            break
    if not EVENTS:
        s = 0.0
    state[0], state[1], state[2] = z, v, s
    for place in range(state.size - 3):
        state[3 + place] = x[place]
    return count


@compiled
def read_batch_kernel(
    states: Array,
    body: Array,
    body_rows: NDArray[np.int64],
    first_sample: int,
    h: float,
    substeps: int,
    parameters: Array,
    out: Readings,
    counts: NDArray[np.int64],
) -> None:
    """Do the same for several sets of parameters; the first axis of ``counts`` and ``out`` counts them."""
    points, z, v, events = out
    for number in range(states.shape[0]):
        counts[number] = read_kernel(
            states[number], body[body_rows[number]], first_sample, h, substeps, parameters[number],
            (points[number], z[number], v[number], events[number]),
        )  # fmt: skip
