"""Lubrication of a spool: its characteristic quantities."""

from __future__ import annotations

import math
from enum import Enum


class LubricationRegime(Enum):
    """Lubrication regime: what carries the load between two surfaces."""

    BOUNDARY = "boundary"
    MIXED = "mixed"
    FLUID = "fluid"


def fluid_friction_coefficient(
    *, dynamic_viscosity: float, speed: float, area: float, normal_load: float, film_thickness: float
) -> float:
    """Return the fluid friction coefficient eta = mu v A / (F_N h), equation (6); no unit.

    It is what Coulomb's coefficient would have to be for Newton's drag.

    Args:
        dynamic_viscosity: mu, Pa s.
        speed: v, m/s.
        area: A, m^2.
        normal_load: F_N, N, > 0.
        film_thickness: h, m, > 0.

    Raises:
        ValueError: load or film thickness not > 0.
    """
    if not (normal_load > 0.0 and film_thickness > 0.0):
        raise ValueError(f"normal_load {normal_load:g} N and film_thickness {film_thickness:g} m must be > 0")
    return dynamic_viscosity * speed * area / (normal_load * film_thickness)


def film_parameter(film_thickness: float, roughness_spool: float, roughness_bore: float = 0.0) -> float:
    """Return lambda: gap height over the combined rms roughness of both surfaces; no unit.

    The paper names gap height and rms roughness (reference 20); the combination sqrt(R1^2 + R2^2) is the
    common one in tribology.

    Args:
        film_thickness: m.
        roughness_spool, roughness_bore: rms roughness, m.

    Raises:
        ValueError: both surfaces without roughness.
    """
    combined = math.hypot(roughness_spool, roughness_bore)
    if combined <= 0.0:
        raise ValueError("at least one surface needs a roughness > 0")
    return film_thickness / combined


def lubrication_regime(film: float) -> LubricationRegime:
    """Return the regime at lambda = ``film``: mixed between 1 and 3, fluid from 3, boundary up to 1."""
    if film >= 3.0:
        return LubricationRegime.FLUID
    return LubricationRegime.MIXED if film > 1.0 else LubricationRegime.BOUNDARY
