"""Drift of the damping: a line, or the course of oil that warms towards a temperature."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term

#: s, time constant beyond which the course of any record is a straight line.
LINE = 1e7


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,
    viscous_coefficient: float,
    damping_drift_rate: float,
    damping_drift_time: float,
) -> float:
    """Return the force, N."""
    course = -damping_drift_time * math.expm1(-t / damping_drift_time)
    return viscous_coefficient * max(-1.0, damping_drift_rate * course) * v


class DampingDriftTerm(Term):
    """The viscous coefficient changes by a line over time, or by an exponential course."""

    name = "damping_drift"
    parameters = (
        Parameter(
            "viscous_coefficient", "N s/m", 0.0, 1e5, 8.2, "pi d l mu / h", "likely_viscous_coefficient"
        ),
        Parameter("damping_drift_rate", "1/s", -100.0, 100.0, -0.01, "relative change per second at t = 0"),
        Parameter(
            "damping_drift_time", "s", 1.0, LINE, LINE, "time constant; the largest is a line", held=True
        ),
    )
    law = "F = c max(-1, r T (1 - exp(-t/T))) z': with the viscous term never below 0; r t for large T"
    source = "(12) with a viscosity that runs away from its value at t = 0"
    meaning = "oil that warms up or cools down, or thins"
    check = "oil temperature over the record"
    dissipates = True
    dissipates_with = "viscous_friction"
