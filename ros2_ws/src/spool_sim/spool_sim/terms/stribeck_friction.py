"""Stribeck friction law."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,
    direction: float,  # noqa: ARG001
    coulomb_force: float,
    static_force: float,
    stribeck_velocity: float,
    stribeck_exponent: float,
) -> float:
    """Return the friction while slipping, N."""
    ratio = speed / stribeck_velocity
    # The default exponent costs a tenth of a power.
    power = ratio * ratio if stribeck_exponent == 2.0 else ratio**stribeck_exponent
    return coulomb_force + (static_force - coulomb_force) * math.exp(-power)


class StribeckFrictionTerm(Term):
    """Static friction that falls to Coulomb friction as the film builds up."""

    name = "stribeck_friction"
    parameters = (
        Parameter("coulomb_force", "N", 0.0, 1e4, 0.4, "friction force at high speed"),
        Parameter("static_force", "N", 0.0, 1e4, 0.6, "largest friction force at rest"),
        Parameter("stribeck_velocity", "m/s", 1e-5, 10.0, 0.02, "speed at which 1/e of the excess is left"),
        Parameter("stribeck_exponent", "1", 0.5, 4.0, 2.0, "p: steepness of the fall", held=True),
    )
    law = "F = [F_c + (F_s - F_c) exp(-(abs(z')/v_s)^p)] Sgn(z')"
    source = (
        "equation (2) without its viscous part: p = 2 is Gauss's form, p = 1 Tustin's; records seldom tell "
        "p, so a fit holds it unless it is set free"
    )
    meaning = "mixed lubrication: the film carries more of the load the faster the spool moves"
    check = "surface finish, oil viscosity at running temperature, time at rest under pressure"
    dissipates = True
