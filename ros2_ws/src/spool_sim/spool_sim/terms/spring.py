"""Centring springs."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,
    v: float,  # noqa: ARG001
    t: float,  # noqa: ARG001
    spring_stiffness: float,
) -> float:
    """Return the force, N."""
    return spring_stiffness * z


class SpringTerm(Term):
    """Linear spring between spool and body."""

    name = "spring"
    parameters = (
        Parameter(
            "spring_stiffness",
            "N/m",
            1.0,
            1e8,
            1632.0,
            "equivalent of both centring springs",
            "spring_stiffness",
        ),
    )
    law = "F = k z"
    source = "equations (11) and (29), third term: c_sz (x_su - w)"
    meaning = "both centring springs; a lower value is a tired or broken spring"
    check = "free length and rate of both springs, and that the right ones are fitted"
    conserves = True
