"""Friction law with a detachment force."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    detachment_force: float,  # noqa: ARG001
    detachment_velocity: float,  # noqa: ARG001
    detachment_drag: float,
    detachment_dry_force: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    return detachment_drag * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,
    direction: float,  # noqa: ARG001
    detachment_force: float,
    detachment_velocity: float,
    detachment_drag: float,  # noqa: ARG001
    detachment_dry_force: float,
) -> float:
    """Return the friction while slipping, N."""
    left = max(0.0, 1.0 - speed / detachment_velocity)
    return detachment_force * left**4 + detachment_dry_force


class DetachmentFrictionTerm(Term):
    """Drag, dry friction and a detachment force gone at semi-fluid speed."""

    name = "detachment_friction"
    parameters = (
        Parameter("detachment_force", "N", 0.0, 1e4, 0.2, "F_od: force to detach, at speed 0"),
        Parameter("detachment_velocity", "m/s", 1e-5, 10.0, 0.05, "v_p: start of semi-fluid friction"),
        Parameter("detachment_drag", "N s/m", 0.0, 1e5, 2.0, "b: viscous part"),
        Parameter("detachment_dry_force", "N", 0.0, 1e4, 0.4, "F_Ts: dry friction"),
    )
    law = "F = b z' + [F_od max(0, 1 - abs(z')/v_p)^4 + F_Ts] Sgn(z')"
    source = (
        "equation (9); printed with b abs(v) and F_od without sign, which would push for v < 0, and "
        "without the limit at v_p: see detachment_friction_printed"
    )
    meaning = "a seat or a deposit that has to be torn off before the spool moves"
    check = "deposits, time at rest under pressure"
    dissipates = True
