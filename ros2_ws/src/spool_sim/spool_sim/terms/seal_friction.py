"""Seal friction law."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    seal_diameter: float,
    seal_width: float,
    seal_correction: float,
    seal_viscosity: float,
    seal_film: float,
    retainer_width: float,  # noqa: ARG001
    retainer_friction: float,  # noqa: ARG001
    seal_pressure: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    area = math.pi * seal_diameter * seal_width
    return area * seal_correction * seal_viscosity / seal_film * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    seal_diameter: float,
    seal_width: float,  # noqa: ARG001
    seal_correction: float,  # noqa: ARG001
    seal_viscosity: float,  # noqa: ARG001
    seal_film: float,  # noqa: ARG001
    retainer_width: float,
    retainer_friction: float,
    seal_pressure: float,
) -> float:
    """Return the friction while slipping, N."""
    return math.pi * seal_diameter * retainer_width * retainer_friction * seal_pressure


class SealFrictionTerm(Term):
    """A rubber ring on its oil film, and a retaining ring pressed on by the pressure."""

    name = "seal_friction"
    parameters = (
        Parameter("seal_diameter", "m", 1e-4, 1.0, 0.02, "D_p: inner diameter of the ring", "land_diameter"),
        Parameter("seal_width", "m", 0.0, 0.1, 0.002, "l_u: sealing width of the rubber ring"),
        Parameter("seal_correction", "1", 0.0, 100.0, 1.0, "c_p: correction factor"),
        Parameter("seal_viscosity", "Pa s", 0.0, 100.0, 0.0612, "mu of the oil", "dynamic_viscosity"),
        Parameter("seal_film", "m", 1e-8, 1e-3, 1e-6, "h_0: film under the seal"),
        Parameter("retainer_width", "m", 0.0, 0.1, 0.001, "l_u1: width of the retaining ring, 0 for none"),
        Parameter(
            "retainer_friction", "1", 0.0, 2.0, 0.05, "f_t1: friction coefficient of the retaining ring"
        ),
        Parameter("seal_pressure", "Pa", 0.0, 1e8, 1e5, "p: pressure at the seal"),
    )
    law = "F = pi D l_u c_p mu z' / h_0 + pi D l_u1 f_t1 p Sgn(z')"
    source = (
        "equation (17) with (18) put in, where the contact pressure N_k drops out; sgn(v) on the second "
        "part, which the print leaves to the reader"
    )
    meaning = "O-rings and their retaining rings, where the spool has any"
    check = "seal swelling, wear and fit"
    dissipates = True
