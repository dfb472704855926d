"""Causes of a friction drift, from what moved together: ranked, each with its share."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .parameter_drift import VISCOUS, ParameterDrift

COULOMB = "coulomb_force"


@dataclass(frozen=True, slots=True)
class RankedCause:
    """Cause of a change, one of several.

    Attributes:
        name: as the event kind declares it.
        share: among all explanations, 0 to 1.
        parameter: whose change it explains.
        condition: under what that changed, where it matters; empty otherwise.

    """

    name: str
    share: float
    parameter: str
    condition: str = ""


#: Relative change of a viscosity per K of an ISO VG oil, lowest and highest (ASTM D341 over 20 to 80 deg C).
VISCOSITY_SLOPE = (0.02, 0.09)


def rank_friction(
    viscous: ParameterDrift, coulomb: ParameterDrift, velocity: float, warmer: float = math.nan
) -> tuple[RankedCause, ...]:
    """Return the causes of a change of friction, the most likely one first.

    Each change counts by its size in units of the one that must be found, and by the force that it makes at
    the present ``velocity`` (m/s rms; NaN: forces do not count): a spool that hardly moves tells little of
    its drag. Thinner oil and a wider gap change the same coefficient: at the same temperature the gap is more
    likely, where the oil became warmer by ``warmer`` K and nothing was referred to it, the oil is.
    """
    drag, dry = viscous.share, coulomb.share
    # Mean of abs(v) over rms for a sine: 0.90.
    moved = abs(drag) * viscous.matters * viscous.baseline.value * velocity
    rubs = 0.9 * abs(dry) * coulomb.matters
    heavy = moved / (moved + rubs) if moved + rubs > 0.0 else 0.5
    drag_weight, dry_weight = (heavy, 1.0 - heavy) if math.isfinite(heavy) else (0.5, 0.5)
    scores: dict[str, tuple[float, str, str]] = {}
    if dry > 0.0:
        scores["oil_contamination"] = (dry * dry_weight, COULOMB, "")
    if dry < 0.0:
        scores["unknown"] = (-dry * dry_weight, COULOMB, "")
    at = "at the same oil temperature" if viscous.referred else "at an oil temperature that is not known"
    if drag > 0.0:
        scores["oil_viscosity"] = (drag * drag_weight, VISCOUS, at)
    if drag < 0.0:
        explained = not viscous.referred and _explains(warmer, drag * viscous.matters)
        if not viscous.referred and not math.isnan(warmer):
            at = f"while the oil became {abs(warmer):.0f} K {'warmer' if warmer >= 0.0 else 'colder'}"
        shares = (0.3, 0.7) if explained else (0.75, 0.25)
        scores["wear"] = (-shares[0] * drag * drag_weight, VISCOUS, at)
        scores["oil_viscosity"] = (-shares[1] * drag * drag_weight, VISCOUS, at)
    total = sum(score for score, _, _ in scores.values())
    causes = [
        RankedCause(name, score / total, parameter, condition)
        for name, (score, parameter, condition) in scores.items()
        if total > 0.0
    ]
    return tuple(sorted(causes, key=lambda cause: -cause.share)) or (RankedCause("unknown", 1.0, COULOMB),)


def _explains(warmer: float, change: float) -> bool:
    """Return whether an oil that became ``warmer`` K warmer may change its viscosity by ``change``, 1."""
    if math.isnan(warmer) or warmer == 0.0 or change <= -1.0:
        return False
    slope = -math.log1p(change) / warmer
    return VISCOSITY_SLOPE[0] <= slope <= VISCOSITY_SLOPE[1]
