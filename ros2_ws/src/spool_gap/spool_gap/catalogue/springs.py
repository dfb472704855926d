"""Springs that harden, have play or preload, and stops at the ends of the stroke."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown

from spool_gap.effect import Effect, scan

#: Stiffness of a contact over that of the spring, at least.
STIFFER = 8.0
#: Dead zones and clearances over the largest travel that are tried.
PLAYS, GAPS = (0.01, 0.04, 0.12, 0.3, 0.6), (0.7, 0.8, 0.86, 0.9, 0.93, 0.95, 0.97, 0.985, 1.0, 1.03)
#: Clearances over the largest displacement of a force record that are tried.
REACHED = (0.55, 0.65, 0.75, 0.82, 0.88, 0.92, 0.95, 0.97, 0.985)


def cube(displacement: Array) -> Array:
    return displacement**3


CUBIC_STIFFNESS = Effect(
    id="cubic_stiffness",
    group="spring and play",
    picture="displacement",
    confusable_with=("end_stop", "spring_backlash", "spring_preload"),
    distinguished_by="amplitudes from small to the whole stroke",
    acts=cube,
    size=lambda force, travel: force / travel**3,
)


def missing_spring(displacement: Array, backlash: float) -> Array:
    return -np.clip(displacement, -backlash, backlash)


SPRING_BACKLASH = Effect(
    id="spring_backlash",
    changes="stiffness",
    group="spring and play",
    picture="displacement",
    local_minima=True,
    confusable_with=("cubic_stiffness", "spring_preload", "presliding_friction"),
    distinguished_by="amplitudes from below the dead zone to the stroke",
    acts=missing_spring,
    solved=lambda backlash, stiffness: {"backlash": backlash} if stiffness > 0.0 else None,
    tried=lambda largest_displacement: [
        {"backlash": play} for play in scan(3e-3 * largest_displacement, 0.7 * largest_displacement, 12)
    ],
    begun=lambda travel: [{"backlash": share * travel} for share in PLAYS],
)


def preload(displacement: Array, preload_travel: float) -> Array:
    return np.clip(displacement / preload_travel, -1.0, 1.0)


SPRING_PRELOAD = Effect(
    id="spring_preload",
    group="spring and play",
    sized=("preload_force",),
    positive=True,
    picture="displacement",
    local_minima=True,
    confusable_with=("cubic_stiffness", "spring_backlash"),
    distinguished_by="amplitudes from below the give of the seats to the stroke",
    acts=preload,
    tried=lambda largest_displacement: [
        {"preload_travel": travel}
        for travel in scan(1e-3 * largest_displacement, 0.3 * largest_displacement, 9)
    ],
    begun=lambda force, travel: [
        {"preload_force": share * force, "preload_travel": give * travel}
        for share in (0.05, 0.2, 0.6)
        for give in (0.01, 0.06, 0.2)
    ],
)


def depth(displacement: Array, stop_gap: float) -> Array:
    return np.asarray(np.sign(displacement) * np.maximum(np.abs(displacement) - stop_gap, 0.0))


def contact(coefficients: list[float]) -> dict[str, float] | None:
    if coefficients[0] <= 0.0:
        return None
    return {"stop_stiffness": coefficients[0], "stop_dissipation": 0.0, "stop_damping": 0.0}


def stop_unknowns(unknowns: list[Unknown], spring_stiffness: float = 0.0) -> list[Unknown]:
    return [
        replace(one, low=min(STIFFER * spring_stiffness, one.high)) if one.name == "stop_stiffness" else one
        for one in unknowns
    ]


def soft(stop_stiffness: float, spring_stiffness: float = 0.0) -> str:
    if stop_stiffness <= 1.001 * STIFFER * spring_stiffness:
        return f"stop_stiffness is not even {STIFFER:g} times the spring's"
    return ""


#: Stiff beyond a clearance, near the largest displacement only; a contact lasts few samples.
END_STOP = Effect(
    id="end_stop",
    group="stop",
    sized=("stop_stiffness",),
    localised=True,
    picture="displacement",
    confusable_with=("cubic_stiffness",),
    distinguished_by="an amplitude that reaches the stop, and one that does not",
    acts=depth,
    solved=contact,
    tried=lambda largest_displacement: [{"stop_gap": share * largest_displacement} for share in REACHED],
    begun=lambda travel: [
        {"stop_gap": share * travel, "stop_stiffness": stiff, "stop_dissipation": loss, "stop_damping": 1.0}
        for share in GAPS
        for stiff in (6e4, 3e5)
        for loss in (0.5, 4.0)
    ],
    freed=stop_unknowns,
    refused=soft,
)
