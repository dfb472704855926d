"""Mixed friction law from Coulomb's law and the hydrodynamic film."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled
from spool_core.numbers import GRAVITY

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    dry_coefficient: float,  # noqa: ARG001
    film_coefficient: float,
    film_drag: float,
    normal_load: float,  # noqa: ARG001
) -> float:
    """Return the force, N."""
    return -film_coefficient * film_drag * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    dry_coefficient: float,
    film_coefficient: float,  # noqa: ARG001
    film_drag: float,  # noqa: ARG001
    normal_load: float,
) -> float:
    """Return the friction while slipping, N."""
    return dry_coefficient * normal_load


class CoulombHydrodynamicFrictionTerm(Term):
    """Coulomb friction less what the hydrodynamic film carries."""

    name = "coulomb_hydrodynamic_friction"
    parameters = (
        Parameter("dry_coefficient", "1", 0.0, 10.0, 0.1, "mu_0: dry friction coefficient"),
        Parameter(
            "film_coefficient",
            "1",
            -100.0,
            1.0,
            0.0,
            "K_V: geometry of the contact; > 0 lowers friction with speed",
        ),
        Parameter(
            "film_drag", "N s/m", 0.0, 1e5, 8.2, "mu A_t / h: drag of the film", "likely_viscous_coefficient"
        ),
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
    law = "F = mu_0 N Sgn(z') - K_V (mu A_t / h) z'"
    source = (
        "equations (24) to (28a), model 3, with p = N / A_t. (28b) lost the division by p: see "
        "coulomb_hydrodynamic_friction_printed. K_V > 0 is negative damping, so it dissipates only with "
        "the drag of (12) and K_V <= 1; both signs occur in Table 5"
    )
    meaning = "load shared between solid contact and oil film"
    check = "side load, oil viscosity, scoring"
    dissipates = True
    dissipates_with = "viscous_friction"
