"""Pavelescu friction law, as printed."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Term
from spool_sim.terms.pavelescu_friction import PavelescuFrictionTerm


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    pavelescu_drag: float,
    pavelescu_minimum: float,
    pavelescu_static: float,
    pavelescu_velocity: float,
    pavelescu_exponent: float,
) -> float:
    """Return the force, N."""
    excess = pavelescu_static - pavelescu_minimum
    return pavelescu_drag * v + excess * math.exp(-((abs(v) / pavelescu_velocity) ** pavelescu_exponent))


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    pavelescu_drag: float,  # noqa: ARG001
    pavelescu_minimum: float,
    pavelescu_static: float,  # noqa: ARG001
    pavelescu_velocity: float,  # noqa: ARG001
    pavelescu_exponent: float,  # noqa: ARG001
) -> float:
    """Return the friction while slipping, N."""
    return pavelescu_minimum


class PavelescuFrictionPrintedTerm(Term):
    """Pavelescu friction by equation (2) to the letter, but for abs(v) in the power, undefined otherwise."""

    name = "pavelescu_friction_printed"
    parameters = PavelescuFrictionTerm.parameters
    law = "F = b z' + F_min,k Sgn(z') + (F_sp - F_min,k) exp(-(abs(z')/v_s)^p)"
    source = "equation (2) as printed, for comparison only"
    meaning = "none: friction that does not know the direction of motion"
    check = "use pavelescu_friction"
    odd = False
