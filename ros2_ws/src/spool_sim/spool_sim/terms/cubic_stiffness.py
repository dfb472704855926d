"""Cubic stiffness of the springs."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,
    v: float,  # noqa: ARG001
    t: float,  # noqa: ARG001
    cubic_coefficient: float,
) -> float:
    """Return the force, N."""
    return cubic_coefficient * z * z * z


class CubicStiffnessTerm(Term):
    """Hardening or softening of the springs."""

    name = "cubic_stiffness"
    parameters = (
        Parameter(
            "cubic_coefficient", "N/m^3", -1e12, 1e12, 1e7, "force over the third power of the displacement"
        ),
    )
    law = "F = k3 z^3"
    source = "Duffing's spring"
    meaning = "coils that touch, conical springs, springs at an angle"
    check = "coil clearance and seating of the springs"
    conserves = True
