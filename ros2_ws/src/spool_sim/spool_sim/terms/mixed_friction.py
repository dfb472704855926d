"""Mixed friction law of contacts and film."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled
from spool_core.numbers import GRAVITY

from spool_sim.terms.base import Parameter, Term


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,
    direction: float,  # noqa: ARG001
    mixed_root_coefficient: float,
    mixed_inverse_coefficient: float,
    mixed_velocity: float,
    normal_load: float,
) -> float:
    """Return the friction while slipping, N."""
    contact = mixed_inverse_coefficient / (speed + mixed_velocity)
    return (mixed_root_coefficient * math.sqrt(speed) + contact) * normal_load


class MixedFrictionTerm(Term):
    """Molecular forces in micro-areas, falling with speed, and drag, rising with it."""

    name = "mixed_friction"
    parameters = (
        Parameter("mixed_root_coefficient", "sqrt(s/m)", 0.0, 100.0, 0.1, "C1: drag part"),
        Parameter("mixed_inverse_coefficient", "m/s", 0.0, 100.0, 0.003, "C2: contact part"),
        Parameter("mixed_velocity", "m/s", 1e-4, 1.0, 0.01, "gamma_m: keeps the force at rest finite"),
        Parameter(
            "normal_load",
            "N",
            0.0,
            1e5,
            1.687,
            "N: the spool's weight unless known better",
            "likely_spool_mass",
            GRAVITY,
        ),
    )
    law = "F = [C1 sqrt(abs(z')) + C2 / (abs(z') + gamma_m)] N Sgn(z')"
    source = (
        "equations (19) to (23), model 2. (23) is the one used; (20) and (22) are infinite at rest and "
        "cannot run. C2 is in m/s, not s/m: C2/v has no dimension. The values of Table 4 take up to 1687 "
        "N at rest: they lock the spool"
    )
    meaning = "boundary contacts of spool and bore with oil between them"
    check = "oil cleanliness and viscosity, scoring, side load"
    dissipates = True
