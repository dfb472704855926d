"""Microwedge friction law."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    contact_proportionality: float,  # noqa: ARG001
    microwedge_length: float,  # noqa: ARG001
    microwedge_overlap: float,  # noqa: ARG001
) -> float:
    """Return the friction while slipping, N."""
    return 0.0


@compiled
def rest_law(
    z: float,  # noqa: ARG001
    contact_proportionality: float,
    microwedge_length: float,
    microwedge_overlap: float,
) -> tuple[float, float]:
    """Return what friction can take up at rest, N."""
    bound = contact_proportionality * max(0.0, microwedge_length - microwedge_overlap)
    return -bound, bound


class MicrowedgeFrictionTerm(Term):
    """Any force up to k_t (d_k0 - a_k0) at rest, none while slipping."""

    name = "microwedge_friction"
    parameters = (
        Parameter(
            "contact_proportionality",
            "N/m",
            0.0,
            1e6,
            100.0,
            "k_t = C_k mu_s: static friction over contact strain",
        ),
        Parameter("microwedge_length", "m", 0.0, 1.0, 0.0057, "d_k0, a dimension of the microwedge"),
        Parameter("microwedge_overlap", "m", 0.0, 1.0, 0.0036, "a_k0, a dimension of the microwedge"),
    )
    law = "abs(F) <= k_t (d_k0 - a_k0) at rest, 0 while slipping"
    source = (
        "equations (13) to (16), model 1. Printed without a sign: a constant push at rest, see "
        "microwedge_friction_printed; here what a static friction does"
    )
    meaning = "roughness peaks of spool and bore that interlock at rest"
    check = "surface finish and scoring"
    dissipates = True
