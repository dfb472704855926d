"""Quadratic damping."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    quadratic_coefficient: float,
) -> float:
    """Return the force, N."""
    return quadratic_coefficient * v * abs(v)


class QuadraticDampingTerm(Term):
    """Drag of oil forced through an orifice or an edge."""

    name = "quadratic_damping"
    parameters = (
        Parameter(
            "quadratic_coefficient", "N s^2/m^2", 0.0, 1e6, 5.0, "force over the square of the velocity"
        ),
    )
    law = "F = d z' abs(z')"
    source = "turbulent orifice flow"
    meaning = "oil displaced from the spring chambers through a narrow passage"
    check = "drain and damping orifices, oil level in the chambers"
    dissipates = True
