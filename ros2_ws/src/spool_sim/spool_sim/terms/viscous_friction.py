"""Viscous friction: Newton's drag in the gap."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    viscous_coefficient: float,
) -> float:
    """Return the force, N."""
    return viscous_coefficient * v


class ViscousFrictionTerm(Term):
    """Drag in proportion to the relative velocity."""

    name = "viscous_friction"
    parameters = (
        Parameter(
            "viscous_coefficient", "N s/m", 0.0, 1e5, 8.2, "pi d l mu / h", "likely_viscous_coefficient"
        ),
    )
    law = "F = c z', c = pi d l mu / h"
    source = "equations (4), (5), (7), (12) and (29), second term"
    meaning = "oil sheared in the annular gap; follows viscosity and temperature"
    check = "oil temperature and grade, then the radial clearance"
    dissipates = True
