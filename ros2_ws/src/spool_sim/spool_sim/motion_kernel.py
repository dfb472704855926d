"""The compiled step of :mod:`spool_sim.motion`: smooth Runge-Kutta pieces between located events."""

# A kernel takes numbers and arrays, in one piece:
# ruff: noqa: PLR0912

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_stream.compiled import compiled

Array = NDArray[np.float64]


@compiled
def runge_kutta(
    z: float, v: float, h: float, a0: float, am: float, a1: float, g: float, w2: float, f: float
) -> tuple[float, float]:
    """Return (z, v) after one step of order 4 of z'' = -a - g z' - w2 z - f (all per unit mass)."""
    k1 = -a0 - g * v - w2 * z - f
    v2 = v + 0.5 * h * k1
    k2 = -am - g * v2 - w2 * (z + 0.5 * h * v) - f
    v3 = v + 0.5 * h * k2
    k3 = -am - g * v3 - w2 * (z + 0.5 * h * v2) - f
    v4 = v + h * k3
    k4 = -a1 - g * v4 - w2 * (z + h * v3) - f
    return z + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4), v + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@compiled
def break_away(u: float, q0: float, q1: float, q2: float, bound: float) -> float:
    """Return the first x in (u, 1] at which abs(q0 + q1 x + q2 x^2) reaches ``bound``, or 2.0."""
    first = 2.0
    for side in (-bound, bound):
        # Citardauq form beside the usual one: no cancellation when the parabola is nearly a line.
        discriminant = q1 * q1 - 4.0 * q2 * (q0 - side)
        if discriminant < 0.0:
            continue
        half = -0.5 * (q1 + math.copysign(math.sqrt(discriminant), q1))
        if half != 0.0:
            root = (q0 - side) / half
            if u < root <= 1.0 and root < first:
                first = root
        if q2 != 0.0:
            root = half / q2
            if u < root <= 1.0 and root < first:
                first = root
    return first


@compiled
def slip_piece(
    z: float,
    v: float,
    t: float,
    x: float,
    h: float,
    a0: float,
    b: float,
    d: float,
    g: float,
    w2: float,
    f: float,
) -> tuple[float, float]:
    """Return (z, v) after slipping for ``t`` s from share ``x`` of a step of ``h`` s.

    The forcing is the parabola a0 + b x + d x^2.
    """
    y = x + 0.5 * t / h
    e = x + t / h
    return runge_kutta(z, v, t, a0 + x * (b + x * d), a0 + y * (b + y * d), a0 + e * (b + e * d), g, w2, f)


@compiled
def time_of_rest(
    z: float,
    v: float,
    s: float,
    low: float,
    high: float,
    x: float,
    h: float,
    a0: float,
    b: float,
    d: float,
    g: float,
    w2: float,
    f: float,
) -> tuple[float, float]:
    """Return (t, z) at which the slip comes to rest: velocity along ``s`` > 0 at low, <= 0 at high.

    Regula falsi (Illinois) on the velocity at the end of a shortened step.
    """
    _, value_low = slip_piece(z, v, low, x, h, a0, b, d, g, w2, f)
    rest, value_high = slip_piece(z, v, high, x, h, a0, b, d, g, w2, f)
    t = high
    side = 0
    for _ in range(60):
        if high - low <= 1e-13 * h or value_high == 0.0:
            break
        t = low + (high - low) * value_low / (value_low - value_high)
        rest, value = slip_piece(z, v, t, x, h, a0, b, d, g, w2, f)
        if abs(value) < 1e-16:
            break
        if s * value > 0.0:
            low, value_low = t, value
            if side == 1:
                value_high *= 0.5
            side = 1
        else:
            high, value_high = t, value
            if side == -1:
                value_low *= 0.5
            side = -1
    return t, rest


@compiled
def stick_slip_step(
    z: float,
    v: float,
    s: float,
    h: float,
    a0: float,
    am: float,
    a1: float,
    g: float,
    w2: float,
    bound: float,
) -> tuple[float, float, float]:
    """Return (z, v, direction) after one step with friction ``bound`` = F_c / m > 0.

    The forcing is the parabola through a0, am, a1; x is the share of the step that is done.
    """
    b = -3.0 * a0 + 4.0 * am - a1
    d = 2.0 * a0 - 4.0 * am + 2.0 * a1
    x = 0.0
    if v != 0.0:
        s = math.copysign(1.0, v)
    for _ in range(16):
        if s == 0.0:
            push = a0 + x * (b + x * d) + w2 * z
            if abs(push) <= bound:
                x = break_away(x, a0 + w2 * z, b, d, bound)
                if x > 1.0:
                    return z, 0.0, 0.0
                push = a0 + x * (b + x * d) + w2 * z
            s = -math.copysign(1.0, push)
        rest = (1.0 - x) * h
        if rest <= 0.0:
            return z, v, s
        f = s * bound
        z1, v1 = slip_piece(z, v, rest, x, h, a0, b, d, g, w2, f)
        low, high = 0.0, rest
        if s * v1 > 0.0:
            rate0 = s * (-(a0 + x * (b + x * d)) - g * v - w2 * z - f)
            rate1 = s * (-a1 - g * v1 - w2 * z1 - f)
            if v == 0.0 or rate0 >= 0.0 or rate1 <= 0.0:
                return z1, v1, s
            # Both ends slip the same way, but the velocity may have dipped through zero between.
            high = rest * rate0 / (rate0 - rate1)
            _, dip = slip_piece(z, v, high, x, h, a0, b, d, g, w2, f)
            if s * dip > 0.0:
                return z1, v1, s
        elif v == 0.0:
            # Broke away and came to rest again within the step: find an instant of slip before that.
            low = rest
            value = v1
            for _ in range(12):
                high = low
                low *= 0.5
                _, value = slip_piece(z, v, low, x, h, a0, b, d, g, w2, f)
                if s * value > 0.0:
                    break
            if s * value <= 0.0:
                return z, 0.0, 0.0  # too late in the step to move: the next step settles it
        t, z = time_of_rest(z, v, s, low, high, x, h, a0, b, d, g, w2, f)
        v = 0.0
        x = min(1.0, x + t / h)
        push = a0 + x * (b + x * d) + w2 * z
        s = 0.0 if abs(push) <= bound else -math.copysign(1.0, push)
    return z, 0.0, 0.0


@compiled
def advance_kernel(
    z: float,
    v: float,
    s: float,
    body: Array,
    h: float,
    substeps: int,
    mass: float,
    viscous: Array,
    stiffness: Array,
    coulomb: Array,
    out_z: Array,
    out_v: Array,
    out_a: Array,
    out_stuck: NDArray[np.bool_],
) -> tuple[float, float, float]:
    """Fill the outputs at each sample and return the state (z, v, direction) after the last."""
    for n in range(out_z.size):
        g = viscous[n] / mass
        w2 = stiffness[n] / mass
        bound = coulomb[n] / mass
        if v != 0.0:
            s = math.copysign(1.0, v)
        i = 2 * substeps * n
        stuck = bound > 0.0 and s == 0.0
        out_z[n] = z
        out_v[n] = v
        out_stuck[n] = stuck
        out_a[n] = body[i] if stuck else -(g * v + w2 * z + s * bound)
        for _ in range(substeps):
            if bound > 0.0:
                z, v, s = stick_slip_step(z, v, s, h, body[i], body[i + 1], body[i + 2], g, w2, bound)
            else:
                z, v = runge_kutta(z, v, h, body[i], body[i + 1], body[i + 2], g, w2, 0.0)
                s = 0.0
            i += 2
    return z, v, s
