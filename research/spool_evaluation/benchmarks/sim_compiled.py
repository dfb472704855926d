"""Compiled textbook schemes on the problem of :mod:`.sim`: peers that are compiled as ours are.

Each computes the sweep itself, at the instants that it needs, and returns the displacement at the samples, m,
shape (n,), with the number of evaluations of the excitation.

Sources: Moreau, Numerical aspects of the sweeping process, 1999 (time stepping, here with the midpoint rule);
Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 1993, II.1 (Runge-Kutta of order 4) and
II.6 (location of events).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled, inlined

Array = NDArray[np.float64]

#: Evaluations of the equation of motion in a step of order 4.
STAGES = 4
#: Halvings that locate an event; the step is exhausted to 1e-12 of itself.
HALVINGS = 40


@inlined
def _body(t: float, amplitude: float, low: float, rate: float) -> float:
    return amplitude * math.sin(2.0 * math.pi * (low + 0.5 * rate * t) * t)


@compiled
def moreau(
    samples: int,
    period: float,
    steps: int,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[Array, int]:
    """Step with the midpoint rule; friction is an impulse, projected on what friction can give.

    Args:
        samples: n.
        period: s between samples.
        steps: per sample.
        plant: mass (kg), drag (N s/m), stiffness (N/m), Coulomb force (N).
        sweep: amplitude (m/s^2), first frequency (Hz), its rate (Hz/s).
    """
    mass, drag, stiffness, friction = plant
    amplitude, low, rate = sweep
    h = period / steps
    found = np.zeros(samples)
    z, v = 0.0, 0.0
    # (m + h c / 2 + h^2 k / 4) v1 = (m - h c / 2 - h^2 k / 4) v0 - h k z - h m w'' - impulse of friction
    whole = mass + 0.5 * h * drag + 0.25 * h * h * stiffness
    kept = mass - 0.5 * h * drag - 0.25 * h * h * stiffness
    count = 0
    for n in range(samples - 1):
        for step in range(steps):
            t = n * period + (step + 0.5) * h
            count += 1
            free = kept * v - h * stiffness * z - h * mass * _body(t, amplitude, low, rate)
            # Sticking: the impulse that makes v1 = 0, where friction can give it.
            impulse = min(h * friction, max(-h * friction, free))
            after = (free - impulse) / whole
            z += 0.5 * h * (v + after)
            v = after
        found[n + 1] = z
    return found, count


@compiled
def smoothed(
    samples: int,
    period: float,
    steps: int,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
    width: float,
) -> tuple[Array, int]:
    """Step with Runge-Kutta's scheme of order 4, friction as tanh(v / ``width``), m/s; else as `moreau`."""
    mass, drag, stiffness, friction = plant
    amplitude, low, rate = sweep
    h = period / steps
    found = np.zeros(samples)
    z, v = 0.0, 0.0
    count = 0
    for n in range(samples - 1):
        for step in range(steps):
            t = n * period + step * h
            b0 = _body(t, amplitude, low, rate)
            b1 = _body(t + 0.5 * h, amplitude, low, rate)
            b2 = _body(t + h, amplitude, low, rate)
            count += STAGES
            a0 = -b0 - (drag * v + stiffness * z + friction * math.tanh(v / width)) / mass
            z1, v1 = z + 0.5 * h * v, v + 0.5 * h * a0
            a1 = -b1 - (drag * v1 + stiffness * z1 + friction * math.tanh(v1 / width)) / mass
            z2, v2 = z + 0.5 * h * v1, v + 0.5 * h * a1
            a2 = -b1 - (drag * v2 + stiffness * z2 + friction * math.tanh(v2 / width)) / mass
            z3, v3 = z + h * v2, v + h * a2
            a3 = -b2 - (drag * v3 + stiffness * z3 + friction * math.tanh(v3 / width)) / mass
            z += h / 6.0 * (v + 2.0 * v1 + 2.0 * v2 + v3)
            v += h / 6.0 * (a0 + 2.0 * a1 + 2.0 * a2 + a3)
        found[n + 1] = z
    return found, count


@inlined
def _slide(
    t: float,
    h: float,
    z: float,
    v: float,
    dry: float,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[float, float]:
    """Return z and v after a step of order 4 under the constant friction ``dry``, N."""
    mass, drag, stiffness, _ = plant
    amplitude, low, rate = sweep
    b0 = _body(t, amplitude, low, rate)
    b1 = _body(t + 0.5 * h, amplitude, low, rate)
    b2 = _body(t + h, amplitude, low, rate)
    a0 = -b0 - (drag * v + stiffness * z + dry) / mass
    z1, v1 = z + 0.5 * h * v, v + 0.5 * h * a0
    a1 = -b1 - (drag * v1 + stiffness * z1 + dry) / mass
    z2, v2 = z + 0.5 * h * v1, v + 0.5 * h * a1
    a2 = -b1 - (drag * v2 + stiffness * z2 + dry) / mass
    z3, v3 = z + h * v2, v + h * a2
    a3 = -b2 - (drag * v3 + stiffness * z3 + dry) / mass
    return z + h / 6.0 * (v + 2.0 * v1 + 2.0 * v2 + v3), v + h / 6.0 * (a0 + 2.0 * a1 + 2.0 * a2 + a3)


@inlined
def _break_away(
    t: float,
    left: float,
    z: float,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[float, float]:
    """Return how long after ``t`` a spool at rest at ``z`` begins to move, s, and the force on it, N."""
    mass, _, stiffness, friction = plant
    amplitude, low, rate = sweep
    early, late = 0.0, left
    for _ in range(HALVINGS):
        middle = 0.5 * (early + late)
        if abs(-mass * _body(t + middle, amplitude, low, rate) - stiffness * z) > friction:
            late = middle
        else:
            early = middle
    return late, -mass * _body(t + late, amplitude, low, rate) - stiffness * z


@compiled
def located(
    samples: int,
    period: float,
    steps: int,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[Array, int]:
    """Step with order 4 from event to event; rest and break-away are located by halving, else as `moreau`."""
    mass, _, stiffness, friction = plant
    amplitude, low, rate = sweep
    h = period / steps
    found = np.zeros(samples)
    z, v, sense = 0.0, 0.0, 0.0  # at rest where sense is 0
    count = 0
    for n in range(samples - 1):
        for step in range(steps):
            t = n * period + step * h
            left = h
            for _ in range(8):  # events in a step; more of them are left to the next one
                if left <= 1e-12 * h:
                    break
                if sense == 0.0:
                    push = -mass * _body(t + left, amplitude, low, rate) - stiffness * z
                    count += 1
                    if abs(push) <= friction:
                        t, left = t + left, 0.0
                        continue
                    late, push = _break_away(t, left, z, plant, sweep)
                    count += HALVINGS + 1
                    sense = 1.0 if push > 0.0 else -1.0
                    t, left = t + late, left - late
                    continue
                z1, v1 = _slide(t, left, z, v, sense * friction, plant, sweep)
                count += STAGES
                if v1 * sense >= 0.0:
                    z, v, t, left = z1, v1, t + left, 0.0
                    continue
                early, late = 0.0, left
                for _ in range(HALVINGS):
                    middle = 0.5 * (early + late)
                    z1, v1 = _slide(t, middle, z, v, sense * friction, plant, sweep)
                    count += STAGES
                    if v1 * sense < 0.0:
                        late = middle
                    else:
                        early = middle
                z, _ = _slide(t, early, z, v, sense * friction, plant, sweep)
                v, t, left = 0.0, t + early, left - early
                push = -mass * _body(t, amplitude, low, rate) - stiffness * z
                sense = 0.0 if abs(push) <= friction else (1.0 if push > 0.0 else -1.0)
        found[n + 1] = z
    return found, count
