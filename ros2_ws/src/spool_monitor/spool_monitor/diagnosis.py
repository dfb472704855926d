"""From what moved together to the cause: ranked, each with its evidence and its remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import yaml

from .drift import ParameterDrift


@dataclass(frozen=True, slots=True)
class Cause:
    """One explanation: its ``share`` (0 to 1) among all, and what speaks for it."""

    name: str
    share: float
    evidence: str


@dataclass(frozen=True, slots=True)
class Remedy:
    """What a cause means on the machine and what to do about it."""

    meaning: str
    remedy: str


#: Relative change of a viscosity per K of an ISO VG oil, lowest and highest (ASTM D341 over 20 to 80 deg C).
VISCOSITY_SLOPE = (0.02, 0.09)


def rank_friction(
    viscous: ParameterDrift, coulomb: ParameterDrift, velocity: float, warmer: float = math.nan
) -> tuple[Cause, ...]:
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
    scores: dict[str, tuple[float, str]] = {}
    if dry > 0.0:
        scores["oil_contamination"] = (
            dry * dry_weight,
            f"dry friction rose by {dry * coulomb.matters:.2f} N",
        )
    if dry < 0.0:
        scores["unknown"] = (-dry * dry_weight, f"dry friction fell by {-dry * coulomb.matters:.2f} N")
    change = 100.0 * drag * viscous.matters
    at = "at the same oil temperature" if viscous.referred else "at an oil temperature that is not known"
    if drag > 0.0:
        scores["oil_viscosity"] = (drag * drag_weight, f"drag rose by {change:.0f} % {at}")
    if drag < 0.0:
        explained = not viscous.referred and _explains(warmer, drag * viscous.matters)
        if not viscous.referred and not math.isnan(warmer):
            at = f"while the oil became {warmer:.0f} K warmer"
        text = f"drag fell by {-change:.0f} % {at}"
        shares = (0.3, 0.7) if explained else (0.75, 0.25)
        scores["wear"] = (-shares[0] * drag * drag_weight, text)
        scores["oil_viscosity"] = (-shares[1] * drag * drag_weight, text)
    total = sum(score for score, _ in scores.values())
    causes = [Cause(name, score / total, text) for name, (score, text) in scores.items() if total > 0.0]
    return tuple(sorted(causes, key=lambda cause: -cause.share)) or (Cause("unknown", 1.0, "nothing moved"),)


def _explains(warmer: float, change: float) -> bool:
    """Return whether an oil that became ``warmer`` K warmer may change its viscosity by ``change``, 1."""
    if math.isnan(warmer) or warmer == 0.0 or change <= -1.0:
        return False
    slope = -math.log1p(change) / warmer
    return VISCOSITY_SLOPE[0] <= slope <= VISCOSITY_SLOPE[1]


@lru_cache(maxsize=1)
def remedies() -> Mapping[str, Remedy]:
    """Return the shipped table of causes (``causes.yaml``), by ``kind/cause`` or ``kind``."""
    table = yaml.safe_load((files(__package__) / "causes.yaml").read_text(encoding="utf-8"))
    return {name: Remedy(**entry) for name, entry in table.items()}


def remedy(kind: str, cause: str = "") -> Remedy | None:
    """Return what to do about ``cause`` of an event ``kind``, the kind's own where the cause has none."""
    table = remedies()
    return table.get(f"{kind}/{cause}") or table.get(kind)


def advice(kind: str, cause: str = "") -> str:
    """Return the remedy as the end of a message, empty where there is none."""
    found = remedy(kind, cause)
    return f"; {found.remedy}" if found else ""
