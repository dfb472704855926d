"""Pavelescu friction law."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    pavelescu_drag: float,
    pavelescu_minimum: float,  # noqa: ARG001
    pavelescu_static: float,  # noqa: ARG001
    pavelescu_velocity: float,  # noqa: ARG001
    pavelescu_exponent: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    return pavelescu_drag * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,
    direction: float,  # noqa: ARG001
    pavelescu_drag: float,  # noqa: ARG001
    pavelescu_minimum: float,
    pavelescu_static: float,
    pavelescu_velocity: float,
    pavelescu_exponent: float,
) -> float:
    """Return the friction while slipping, N."""
    excess = pavelescu_static - pavelescu_minimum
    return pavelescu_minimum + excess * math.exp(-((speed / pavelescu_velocity) ** pavelescu_exponent))


class PavelescuFrictionTerm(Term):
    """Viscous drag, kinetic friction and a static excess that falls exponentially."""

    name = "pavelescu_friction"
    parameters = (
        Parameter("pavelescu_drag", "N s/m", 0.0, 1e5, 2.0, "viscous part b"),
        Parameter(
            "pavelescu_minimum", "N", 0.0, 1e4, 0.4, "F_min,k: friction at the minimum of the Stribeck curve"
        ),
        Parameter("pavelescu_static", "N", 0.0, 1e4, 0.6, "F_sp: static friction"),
        Parameter(
            "pavelescu_velocity", "m/s", 1e-5, 10.0, 0.02, "v_s: speed at which 1/e of the excess is left"
        ),
        Parameter("pavelescu_exponent", "1", 1.0, 10.0, 2.0, "p (beta in the text), from experiment"),
    )
    law = "F = b z' + [F_min,k + (F_sp - F_min,k) exp(-(abs(z')/v_s)^p)] Sgn(z')"
    source = (
        "equation (2); the print leaves sgn(v) off the third term, which then pushes: see "
        "pavelescu_friction_printed. The text calls the exponent beta"
    )
    meaning = "mixed lubrication, with its own steepness of the fall"
    check = "surface finish, viscosity, time at rest"
    dissipates = True
