"""Drag that grows or drifts, and pushes from outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown
from spool_sim.terms.drag_and_pushes import LINE

from spool_gap.effect import Effect

#: Time constants of oil that warms, over the record's length: longer ones are a line, shorter ones soon over.
COURSES = (0.15, 0.5)
#: Changes of the drag, relative, that are tried.
CHANGES = (0.2, -0.2, 1.0, -0.6)
#: Change of the drag along a bent course, relative, that no oil makes within a record: 60 K do that.
IMPOSSIBLE = 10.0
#: Hz, lowest frequency that is fitted: slower ones are drift.
LOWEST = 0.1


def quadratic(velocity: Array) -> Array:
    return np.asarray(velocity * np.abs(velocity))


QUADRATIC_DAMPING = Effect(
    id="quadratic_damping",
    group="drag and oil",
    positive=True,
    confusable_with=("coulomb_friction", "damping_drift"),
    distinguished_by="several amplitudes, in a wide band",
    acts=quadratic,
    size=lambda force, speed: force / speed**2,
)


def drift(time: Array, velocity: Array, damping_drift_time: float) -> Array:
    return -damping_drift_time * np.expm1(-time / damping_drift_time) * velocity


def _courses(seconds: float) -> list[float]:
    """Return the time constants (s) of a line, and of courses that bend within a record of ``seconds``."""
    return [LINE, *(max(1.0, share * seconds) for share in COURSES)]


def drift_unknowns(
    unknowns: list[Unknown], seconds: float, damping_drift_time: float = LINE
) -> list[Unknown]:
    rate, constant = unknowns
    if damping_drift_time >= LINE:
        return [rate]
    return [rate, replace(constant, low=1.0, high=3.0 * seconds, scale=0.3 * seconds)]


def impossible(damping_drift_rate: float, damping_drift_time: float = LINE) -> str:
    if damping_drift_time < LINE and abs(damping_drift_rate) * damping_drift_time > IMPOSSIBLE:
        return f"the drag changes by a factor of more than {IMPOSSIBLE:g}"
    return ""


DAMPING_DRIFT = Effect(
    id="damping_drift",
    group="drag and oil",
    sized=("damping_drift_rate",),
    picture="time",
    confusable_with=("quadratic_damping",),
    distinguished_by="the same excitation at the beginning and at the end of the record",
    acts=drift,
    solved=lambda coefficients, damping: (
        {"damping_drift_rate": coefficients[0] / damping} if damping != 0.0 else None
    ),
    tried=lambda time: [{"damping_drift_time": one} for one in _courses(float(time.max() - time.min()))],
    begun=lambda seconds: [
        {"damping_drift_rate": change / (seconds if one == LINE else one), "damping_drift_time": one}
        for one in _courses(seconds)
        for change in CHANGES
    ],
    freed=drift_unknowns,
    refused=impossible,
)


def line(time: Array, force_frequency: float) -> list[Array]:
    angle = 2.0 * np.pi * force_frequency * time
    return [-np.sin(angle), -np.cos(angle)]


def peak(coefficients: list[float]) -> dict[str, float]:
    sine, cosine = coefficients
    return {"force_amplitude": float(np.hypot(sine, cosine)), "force_phase": float(np.arctan2(cosine, sine))}


def line_unknowns(unknowns: list[Unknown], seconds: float) -> list[Unknown]:
    # A line of a record is as wide as steps of its frequency.
    frequency, amplitude, phase = unknowns
    return [
        replace(frequency, low=LOWEST, scale=0.05 / seconds, absolute=True),
        amplitude,
        replace(phase, scale=0.5, absolute=True),
    ]


PERIODIC_FORCE = Effect(
    id="periodic_force",
    group="excitation",
    sized=("force_amplitude",),
    scanned=("force_frequency",),
    picture="time",
    confusable_with=(),
    distinguished_by="a record long enough to distinguish its frequency from the excitation's",
    acts=line,
    solved=peak,
    tried=lambda peaks: [{"force_frequency": frequency} for frequency in peaks],
    begun=lambda peaks: [
        {"force_frequency": frequency, "force_amplitude": amplitude, "force_phase": phase}
        for frequency, amplitude, phase in peaks
    ],
    freed=line_unknowns,
)


def push(time: Array) -> Array:
    return -np.ones(time.size)


#: Always there, so two accelerometers cannot see it.
CONSTANT_FORCE = Effect(
    id="constant_force",
    group="spring and play",
    kinds=("driven", "imposed"),
    load_cell_zero=True,
    picture="time",
    confusable_with=(),
    distinguished_by="a force record",
    acts=push,
)
