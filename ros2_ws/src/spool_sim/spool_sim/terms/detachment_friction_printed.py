"""Friction law with a detachment force, as printed."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Term
from spool_sim.terms.detachment_friction import DetachmentFrictionTerm


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    detachment_force: float,
    detachment_velocity: float,
    detachment_drag: float,
    detachment_dry_force: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    left = max(0.0, 1.0 - abs(v) / detachment_velocity)
    return detachment_force * left**4 + detachment_drag * abs(v)


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    detachment_force: float,  # noqa: ARG001
    detachment_velocity: float,  # noqa: ARG001
    detachment_drag: float,  # noqa: ARG001
    detachment_dry_force: float,
) -> float:
    """Return the friction while slipping, N."""
    return detachment_dry_force


class DetachmentFrictionPrintedTerm(Term):
    """Friction with detachment by equation (9) to the letter, below v_p; above it the bracket counts as 0."""

    name = "detachment_friction_printed"
    parameters = DetachmentFrictionTerm.parameters
    law = "F = F_od max(0, 1 - abs(z')/v_p)^4 + b abs(z') + F_Ts Sgn(z')"
    source = "equation (9) as printed, for comparison only"
    meaning = "none: drag that does not know the direction of motion"
    check = "use detachment_friction"
    odd = False
