"""Hess-Soom friction law, as printed."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Term
from spool_sim.terms.hess_soom_friction import HessSoomFrictionTerm


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    hess_soom_drag: float,
    hess_soom_minimum: float,
    hess_soom_static: float,
    hess_soom_velocity: float,
) -> float:
    """Return the force, N."""
    ratio = v / hess_soom_velocity
    return hess_soom_drag * v + (hess_soom_static - hess_soom_minimum) / (1.0 + ratio * ratio)


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    hess_soom_drag: float,  # noqa: ARG001
    hess_soom_minimum: float,
    hess_soom_static: float,  # noqa: ARG001
    hess_soom_velocity: float,  # noqa: ARG001
) -> float:
    """Return the friction while slipping, N."""
    return hess_soom_minimum


class HessSoomFrictionPrintedTerm(Term):
    """Hess-Soom friction by equation (1) to the letter: the third term pushes one way whatever the motion."""

    name = "hess_soom_friction_printed"
    parameters = HessSoomFrictionTerm.parameters
    law = "F = b z' + F_min,k Sgn(z') + (F_s - F_min,k) / (1 + (z'/v_s)^2)"
    source = "equation (1) as printed, for comparison only"
    meaning = "none: friction that does not know the direction of motion"
    check = "use hess_soom_friction"
    odd = False
