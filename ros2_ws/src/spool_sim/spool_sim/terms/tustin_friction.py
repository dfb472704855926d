"""Tustin friction law."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    tustin_drag: float,
    tustin_kinetic: float,  # noqa: ARG001
    tustin_excess: float,  # noqa: ARG001
    tustin_velocity: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    return tustin_drag * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,
    direction: float,  # noqa: ARG001
    tustin_drag: float,  # noqa: ARG001
    tustin_kinetic: float,
    tustin_excess: float,
    tustin_velocity: float,
) -> float:
    """Return the friction while slipping, N."""
    return tustin_kinetic + tustin_excess * math.exp(-speed / tustin_velocity)


class TustinFrictionTerm(Term):
    """Viscous drag, kinetic friction and an excess that falls exponentially with speed."""

    name = "tustin_friction"
    parameters = (
        Parameter("tustin_drag", "N s/m", 0.0, 1e5, 2.0, "viscous part b"),
        Parameter("tustin_kinetic", "N", 0.0, 1e4, 0.4, "F_min,k: kinetic friction"),
        Parameter("tustin_excess", "N", 0.0, 1e4, 0.2, "F_sk: static minus kinetic friction"),
        Parameter("tustin_velocity", "m/s", 1e-5, 10.0, 0.02, "v_k: transition to kinetic friction"),
    )
    law = "F = b z' + [F_min,k + F_sk exp(-abs(z')/v_k)] Sgn(z')"
    source = (
        "equation (3); printed without sgn(v) on the third term and with v for abs(v): that pushes, and "
        "grows without limit for v < 0, so it is not offered"
    )
    meaning = "mixed lubrication"
    check = "surface finish, viscosity, time at rest"
    dissipates = True
