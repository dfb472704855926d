"""Drift of the damping."""

from __future__ import annotations

from spool_stream.kernels.compiled import compiled

from .base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,
    viscous_coefficient: float,
    damping_drift_rate: float,
) -> float:
    """Return the force, N."""
    return viscous_coefficient * max(-1.0, damping_drift_rate * t) * v


class DampingDriftTerm(Term):
    """Damping drift: the viscous coefficient changes in proportion to time."""

    name = "damping_drift"
    parameters = (
        Parameter("viscous_coefficient", "N s/m", 0.0, 1e5, 8.2, "pi d l mu / h", "viscous_coefficient"),
        Parameter("damping_drift_rate", "1/s", -100.0, 100.0, -0.01, "relative change per second"),
    )
    law = "F = c max(-1, r t) z': with the viscous term c (1 + r t) z', never below 0"
    source = "(12) with a viscosity that runs away from its value at t = 0"
    meaning = "oil that warms up or cools down, or thins"
    check = "oil temperature over the record"
    dissipates = True
    dissipates_with = "viscous_friction"
