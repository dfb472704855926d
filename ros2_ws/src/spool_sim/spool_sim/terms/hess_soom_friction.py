"""Hess-Soom friction law."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    hess_soom_drag: float,
    hess_soom_minimum: float,  # noqa: ARG001
    hess_soom_static: float,  # noqa: ARG001
    hess_soom_velocity: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    return hess_soom_drag * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,
    direction: float,  # noqa: ARG001
    hess_soom_drag: float,  # noqa: ARG001
    hess_soom_minimum: float,
    hess_soom_static: float,
    hess_soom_velocity: float,
) -> float:
    """Return the friction while slipping, N."""
    ratio = speed / hess_soom_velocity
    return hess_soom_minimum + (hess_soom_static - hess_soom_minimum) / (1.0 + ratio * ratio)


class HessSoomFrictionTerm(Term):
    """Drag, kinetic friction and a static excess falling with the squared speed."""

    name = "hess_soom_friction"
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
    law = "F = b z' + [F_min,k + (F_s - F_min,k) / (1 + (z'/v_s)^2)] Sgn(z')"
    source = (
        "equation (1); the print leaves sgn(v) off the third term, which then pushes: see "
        "hess_soom_friction_printed"
    )
    meaning = "mixed lubrication of a hydraulic drive"
    check = "surface finish, viscosity, time at rest"
    dissipates = True
