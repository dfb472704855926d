"""Coulomb friction law."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    coulomb_force: float,
) -> float:
    """Return the friction while slipping, N."""
    return coulomb_force


class CoulombFrictionTerm(Term):
    """A constant force against the motion; any force up to it at rest."""

    name = "coulomb_friction"
    parameters = (
        Parameter(
            "coulomb_force", "N", 0.0, 1e4, 0.5, "friction force while slipping, largest force at rest"
        ),
    )
    law = "F = F_c Sgn(z'), Sgn(0) = [-1, 1]"
    source = "set-valued form of Coulomb's law; the constant part of equations (24) to (28)"
    meaning = "solid contact of spool and bore: wear, dirt, side load"
    check = "cleanliness of the oil, scoring of spool and bore, straightness and side load"
    dissipates = True
