"""Microwedge friction law, as printed."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term
from spool_sim.terms.microwedge_friction import MicrowedgeFrictionTerm


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    contact_proportionality: float,
    microwedge_length: float,
    microwedge_overlap: float,
    delta_exponent: float,
    delta_power: float,
) -> float:
    """Return the force, N."""
    delta = 1.0 / (1.0 + math.pow(10.0, delta_exponent) * math.pow(abs(v), delta_power))
    return contact_proportionality * (microwedge_length - microwedge_overlap) * delta


class MicrowedgeFrictionPrintedTerm(Term):
    """Microwedge friction by equations (13) and (16) to the letter: a push of one sign near rest."""

    name = "microwedge_friction_printed"
    parameters = (
        *MicrowedgeFrictionTerm.parameters,
        Parameter("delta_exponent", "1", 0.0, 12.0, 6.0, "theta: 10^theta in (16)"),
        Parameter("delta_power", "1", 2.0, 20.0, 2.0, "t: even power of the velocity in (16)"),
    )
    law = "F = k_t (d_k0 - a_k0) / (1 + 10^theta abs(z')^t)"
    source = "equations (13) and (16) as printed, for comparison only"
    meaning = "none: a constant push while at rest"
    check = "use microwedge_friction"
    odd = False
