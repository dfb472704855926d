"""Friction law with adhesion."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    adhesion_drag: float,
    adhesion_dry_force: float,  # noqa: ARG001
    adhesion_force: float,  # noqa: ARG001
    adhesion_decay: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    return adhesion_drag * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,
    direction: float,  # noqa: ARG001
    adhesion_drag: float,  # noqa: ARG001
    adhesion_dry_force: float,
    adhesion_force: float,
    adhesion_decay: float,
) -> float:
    """Return the friction while slipping, N."""
    return adhesion_dry_force + adhesion_force * math.exp(-adhesion_decay * speed)


class AdhesionFrictionTerm(Term):
    """Viscous drag, dry friction and an adhesion force that decays with speed."""

    name = "adhesion_friction"
    parameters = (
        Parameter("adhesion_drag", "N s/m", 0.0, 1e5, 2.0, "b: fluid friction F_Tp over velocity"),
        Parameter("adhesion_dry_force", "N", 0.0, 1e4, 0.4, "F_Ts: dry friction"),
        Parameter("adhesion_force", "N", 0.0, 1e4, 0.2, "F_pmax: largest adhesion force"),
        Parameter("adhesion_decay", "s/m", 0.0, 1e5, 50.0, "sigma: decay of the adhesion"),
    )
    law = "F = b z' + [F_Ts + F_pmax exp(-sigma abs(z'))] Sgn(z')"
    source = "equation (8)"
    meaning = "spool that sticks to the bore through varnish or after a rest"
    check = "varnish and ageing products on the lands, oil age"
    dissipates = True
