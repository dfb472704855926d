"""The Hess-Soom law as printed."""

from __future__ import annotations

from spool_stream.kernels.compiled import compiled

from .base import Parameter, Term


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


class HessSoomFrictionPrinted(Term):
    """Equation (1) to the letter: the third term pushes one way whatever the motion."""

    name = "hess_soom_friction_printed"
    parameters = (
        Parameter("hess_soom_drag", "N s/m", 0.0, 1e5, 2.0, "viscous part b"),
        Parameter(
            "hess_soom_minimum", "N", 0.0, 1e4, 0.4, "F_min,k: friction at the minimum of the Stribeck curve"
        ),
        Parameter("hess_soom_static", "N", 0.0, 1e4, 0.6, "F_s: static friction"),
        Parameter(
            "hess_soom_velocity", "m/s", 1e-5, 10.0, 0.02, "v_s: speed at which half of the excess is left"
        ),
    )
    law = "F = b z' + F_min,k Sgn(z') + (F_s - F_min,k) / (1 + (z'/v_s)^2)"
    source = "equation (1) as printed, for comparison only"
    meaning = "none: friction that does not know the direction of motion"
    check = "use hess_soom_friction"
    odd = False
