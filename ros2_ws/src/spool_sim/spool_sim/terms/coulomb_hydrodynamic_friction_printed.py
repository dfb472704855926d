"""Mixed friction law from Coulomb's law and the hydrodynamic film, as in (28b)."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term
from spool_sim.terms.coulomb_hydrodynamic_friction import CoulombHydrodynamicFrictionTerm


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,
    t: float,  # noqa: ARG001
    dry_coefficient: float,  # noqa: ARG001
    film_coefficient: float,
    film_drag_per_area: float,
    normal_load: float,
) -> float:
    """Return the force, N."""
    return -film_coefficient * film_drag_per_area * normal_load * v


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,  # noqa: ARG001
    dry_coefficient: float,
    film_coefficient: float,  # noqa: ARG001
    film_drag_per_area: float,  # noqa: ARG001
    normal_load: float,
) -> float:
    """Return the friction while slipping, N."""
    return dry_coefficient * normal_load


class CoulombHydrodynamicFrictionPrintedTerm(Term):
    """Mixed friction by equation (28b) to the letter, whose units do not match."""

    name = "coulomb_hydrodynamic_friction_printed"
    parameters = (
        *CoulombHydrodynamicFrictionTerm.parameters[:2],
        Parameter(
            "film_drag_per_area", "N s/m^3", 0.0, 1e9, 4080.0, "mu / h: drag of the film over its area"
        ),
        CoulombHydrodynamicFrictionTerm.parameters[-1],
    )
    law = "F = mu_0 N Sgn(z') - K_V (mu / h) N z'"
    source = "equation (28b) as printed, for comparison only: K_V would have to be an area over a force"
    meaning = "load shared between solid contact and oil film"
    check = "use coulomb_hydrodynamic_friction"
