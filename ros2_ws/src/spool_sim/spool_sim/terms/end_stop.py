"""End stops of the stroke."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,
    v: float,
    t: float,  # noqa: ARG001
    stop_gap: float,
    stop_stiffness: float,
    stop_dissipation: float,
    stop_damping: float,
) -> float:
    """Return the force, N."""
    depth = abs(z) - stop_gap
    if depth <= 0.0:
        return 0.0
    side = math.copysign(1.0, z)
    speed = side * v
    push = stop_stiffness * depth * (1.0 + stop_dissipation * speed) + stop_damping * speed
    return side * max(0.0, push)


@compiled
def levels_law(
    stop_gap: float,
    stop_stiffness: float,  # noqa: ARG001
    stop_dissipation: float,  # noqa: ARG001
    stop_damping: float,  # noqa: ARG001
) -> tuple[float, float]:
    """Return where the force has its kinks, m."""
    return -stop_gap, stop_gap


class EndStopTerm(Term):
    """Unilateral contact at both ends of the stroke."""

    name = "end_stop"
    parameters = (
        Parameter("stop_gap", "m", 0.0, 0.1, 0.004, "travel from the centre to either stop"),
        Parameter("stop_stiffness", "N/m", 0.0, 1e9, 1e6, "contact stiffness"),
        Parameter(
            "stop_dissipation",
            "s/m",
            0.0,
            100.0,
            0.5,
            "loss of the contact: share of the force per m/s of approach",
        ),
        Parameter("stop_damping", "N s/m", 0.0, 1e4, 0.0, "drag of the contact, whatever the depth"),
    )
    law = "F = sgn(z) max(0, K d (1 + chi d') + c d'), d = abs(z) - gap > 0"
    source = "Hunt and Crossley's contact law (c = 0) or Kelvin and Voigt's (chi = 0), neither of which pulls"
    meaning = "spool that reaches the end of its stroke"
    check = "stroke, spring seating, amplitude of the vibration"
