"""SciPy's solvers on the problem of :mod:`.sim`, with or without events."""

from __future__ import annotations

import math
import os
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from spool_core.numbers import Array

SECONDS, RATE = 10.0, 2000.0
MASS, DRAG, STIFFNESS, FRICTION = 0.18, 2.65, 1632.0, 0.5
AMPLITUDE, LOW, HIGH = 10.0, 8.0, 110.0

#: Dry friction as a set: rest and break-away are events, between which the motion is smooth.
EVENTS = "events"
#: How a solver without events is given dry friction.
SIGNS: dict[str, Callable[[float], float]] = {
    "sgn": lambda v: math.copysign(1.0, v) if v else 0.0,
    "tanh(v/1e-4)": lambda v: math.tanh(v / 1e-4),
}


@dataclass(frozen=True, slots=True)
class Solved:
    """Solution: what a solver needed and found.

    Attributes:
        seconds: s of computing.
        evaluations: of the equation of motion.
        displacement: at the samples, m, shape (n,); ``None`` without a result.
    """

    seconds: float
    evaluations: int
    displacement: Array | None


class _GaveUpError(Exception):
    """Time out: the time allowed is over."""


class _Balance:
    """Force balance, with a count of its evaluations and an end of the time allowed."""

    def __init__(self, cap: float) -> None:
        self.begin, self.cap, self.evaluations = time.process_time(), cap, 0
        self.rate = (HIGH - LOW) / SECONDS

    @property
    def seconds(self) -> float:
        """s of computing since it was made."""
        return time.process_time() - self.begin

    def body(self, t: float) -> float:
        """Return the body's acceleration, m/s^2."""
        self.evaluations += 1
        if self.seconds > self.cap:
            raise _GaveUpError
        return AMPLITUDE * math.sin(2.0 * math.pi * (LOW + 0.5 * self.rate * t) * t)

    def relative(self, t: float, z: float, v: float, friction: float) -> float:
        """Return z'' under ``friction`` (N), m/s^2."""
        return -self.body(t) - (DRAG * v + STIFFNESS * z + friction) / MASS

    def push(self, t: float, z: float) -> float:
        """Return the force on a spool at rest, N."""
        return -MASS * self.body(t) - STIFFNESS * z


def solve(method: str, friction: str, tolerance: float, cap: float) -> Solved:
    """Solve the problem with one of SciPy's methods.

    A solver that stops with a failure is set going again from its last sample with half the largest step,
    until ``cap`` s are over.

    Args:
        method: of ``solve_ivp``.
        friction: one of ``SIGNS``, or ``EVENTS``.
        tolerance: relative; the absolute one is a millionth of it, in m and m/s.
        cap: s of computing.
    """
    balance = _Balance(cap)
    try:
        if friction == EVENTS:
            found = _from_event_to_event(balance, method, tolerance)
        else:
            found = _without_events(balance, method, SIGNS[friction], tolerance)
    except _GaveUpError:
        return Solved(balance.seconds, balance.evaluations, None)
    return Solved(balance.seconds, balance.evaluations, found)


def _without_events(
    balance: _Balance, method: str, sign: Callable[[float], float], tolerance: float
) -> Array:
    def slope(t: float, y: Array) -> tuple[float, float]:
        z, v = float(y[0]), float(y[1])
        return v, balance.relative(t, z, v, FRICTION * sign(v))

    times = np.arange(round(SECONDS * RATE)) / RATE
    found = np.zeros((times.size, 2))
    first, largest_step = 0, 0.25 / HIGH
    while True:
        part = solve_ivp(
            slope,
            (times[first], SECONDS),
            found[first],
            method=method,
            t_eval=times[first:],
            rtol=tolerance,
            atol=1e-6 * tolerance,
            max_step=largest_step,
        )
        reached = len(part.t)
        if reached:
            found[first : first + reached] = np.asarray(part.y).T
        if part.success:
            return found[:, 0]
        first += max(0, reached - 1)
        largest_step = max(1e-6, 0.5 * largest_step)


def _from_event_to_event(balance: _Balance, method: str, tolerance: float) -> Array:
    times = np.arange(round(SECONDS * RATE)) / RATE
    found = np.zeros(times.size)
    t, z, sense = 0.0, 0.0, 0.0
    while t < times[-1]:
        if sense == 0.0:
            begin, t, sense = t, *_break_away(balance, t, z)
            found[(times >= begin) & (times <= t)] = z
            continue

        def slope(at: float, y: Array, dry: float = sense * FRICTION) -> tuple[float, float]:
            return float(y[1]), balance.relative(at, float(y[0]), float(y[1]), dry)

        def rest(_: float, y: Array) -> float:
            return float(y[1])

        # Attributes of the function are by which solve_ivp knows that it ends there, and from which side.
        vars(rest).update(terminal=True, direction=-sense)
        part = solve_ivp(
            slope,
            (t, SECONDS),
            (z, 0.0),
            method=method,
            dense_output=True,
            events=rest,
            rtol=tolerance,
            atol=1e-6 * tolerance,
            max_step=0.25 / HIGH,
        )
        inside = (times >= t) & (times <= part.t[-1])
        if inside.any():
            found[inside] = part.sol(times[inside])[0]
        t, z = float(part.t[-1]), float(part.y[0, -1])
        push = balance.push(t, z)
        sense = 0.0 if abs(push) <= FRICTION else math.copysign(1.0, push)
    return found


def _break_away(balance: _Balance, t: float, z: float) -> tuple[float, float]:
    """Return when a spool at rest at ``z`` begins to move, s, and to which side; the end where it stays."""
    step = 0.02 / HIGH
    while t < SECONDS:
        if abs(balance.push(t + step, z)) > FRICTION:
            at = brentq(lambda x: abs(balance.push(x, z)) - FRICTION, t, t + step, xtol=1e-14)
            return float(at) + 1e-13, math.copysign(1.0, balance.push(t + step, z))
        t += step
    return SECONDS, 0.0


def silence() -> None:
    """Leave out what solvers write in this process, warnings as well as lines from Fortran."""
    warnings.simplefilter("ignore")
    with open(os.devnull, "w", encoding="ascii") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())
