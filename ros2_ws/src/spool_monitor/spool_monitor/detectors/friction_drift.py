"""Friction drift: viscous drag or dry friction differ from what they were on the healthy valve."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.detectors.base import (
    ESTIMATE,
    Detector,
    DriftTest,
    Moment,
    MonitorLimit,
    judgement,
    on_delay,
)
from spool_monitor.event import EventCause, EventKind, Facts, Finding, Namur, Severity
from spool_monitor.parameter_drift import VISCOUS, ParameterDrift

KIND = EventKind(
    "friction_drift",
    200,
    Namur.MAINTENANCE_REQUIRED,
    causes=(
        EventCause("wear", 201),
        EventCause("oil_contamination", 202),
        EventCause("oil_viscosity", 203, Namur.OUT_OF_SPECIFICATION),
        EventCause("unknown", 204),
    ),
)

VISCOUS_CHANGE = MonitorLimit("viscous_change", 0.2, "Relative change to act on.", "1", 0.01, 10.0)
COULOMB_CHANGE = MonitorLimit("coulomb_change", 0.1, "Change of the Coulomb force to act on.", "N", 1e-4, 1e4)


COULOMB = "coulomb_force"

#: Relative change of a viscosity per K of an ISO VG oil, lowest and highest (ASTM D341 over 20 to 80 deg C).
VISCOSITY_SLOPE = (0.02, 0.09)

#: A sensor that changes looks like a drift at first.
ON_DELAY = on_delay("friction_drift", 2.0)


class FrictionDrift(Detector):
    """What the sequential tests of the viscous coefficient and of the Coulomb force find."""

    name = "friction_drift"
    kind = KIND
    looks_at = (ESTIMATE,)
    drifts = (
        DriftTest("viscous_coefficient", "N s/m", VISCOUS_CHANGE),
        DriftTest("coulomb_force", "N", COULOMB_CHANGE),
    )
    on_delay = ON_DELAY
    off_delay: ClassVar[float] = 5.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the estimate of ``moment``, if there is a new one."""
        if moment.estimate is None:
            return None
        viscous, coulomb = (moment.parameters["viscous_coefficient"], moment.parameters["coulomb_force"])
        self.judgement = judgement(moment.distrust, (viscous, coulomb))
        levels = [one.level for one in (viscous, coulomb) if one.level is not None]
        indicated: Severity | None = max(levels, default=None)
        warmer = moment.estimate.oil_temperature.value - viscous.temperature
        causes = rank_friction(viscous, coulomb, moment.velocity, warmer)
        leading = moment.parameters[causes[0].parameter]

        def facts() -> Facts:
            others = {one.parameter for one in causes} - {leading.parameter}
            further = [moment.parameters[name].latest_change for name in sorted(others)]
            if math.isfinite(warmer):
                further.append(Quantity("oil_temperature_change", "K", warmer, validity=Validity.VALID))
            note = ""
            if any(one.parameter == VISCOUS for one in causes):
                unknown = "" if math.isfinite(warmer) else "oil_temperature_unknown"
                note = "oil_referred" if viscous.referred and not viscous.assumed else unknown
                note = "oil_temperature_frozen" if viscous.frozen else note
            return replace(
                leading.facts(),
                causes=tuple(one.name for one in causes),
                probabilities=tuple(one.share for one in causes),
                note=note,
                evidence=tuple(further),
            )

        released = viscous.released and coulomb.released
        return Finding(
            moment.stamp,
            indicated,
            released,
            causes[0].name,
            leading.latest_change,
            facts,
            leading.hurries,
            viscous.eased and coulomb.eased,
        )


@dataclass(frozen=True, slots=True)
class RankedCause:
    """Cause of a change, one of several.

    Attributes:
        name: as the event kind declares it.
        share: among all explanations, 0 to 1.
        parameter: whose change it explains.

    """

    name: str
    share: float
    parameter: str


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
    # What is no more than chance explains nothing that is certain.
    if coulomb.level is not None and viscous.level is None:
        drag = 0.0
    elif viscous.level is not None and coulomb.level is None:
        dry = 0.0
    # Mean of abs(v) over rms for a sine: 0.90.
    moved = abs(drag) * viscous.matters * viscous.baseline.value * velocity
    rubs = 0.9 * abs(dry) * coulomb.matters
    heavy = moved / (moved + rubs) if moved + rubs > 0.0 else 0.5
    drag_weight, dry_weight = (heavy, 1.0 - heavy) if math.isfinite(heavy) else (0.5, 0.5)
    scores: dict[str, tuple[float, str]] = {}
    if dry > 0.0:
        scores["oil_contamination"] = (dry * dry_weight, COULOMB)
    if dry < 0.0:
        scores["unknown"] = (-dry * dry_weight, COULOMB)
    if drag > 0.0:
        scores["oil_viscosity"] = (drag * drag_weight, VISCOUS)
    if drag < 0.0:
        explained = not viscous.referred and _explains(warmer, drag * viscous.matters)
        shares = (0.3, 0.7) if explained else (0.75, 0.25)
        if viscous.frozen:  # a thermometer that stands still says nothing of the oil
            shares = (0.5, 0.5)
        scores["wear"] = (-shares[0] * drag * drag_weight, VISCOUS)
        scores["oil_viscosity"] = (-shares[1] * drag * drag_weight, VISCOUS)
    total = sum(score for score, _ in scores.values())
    causes = [
        RankedCause(name, score / total, parameter)
        for name, (score, parameter) in scores.items()
        if total > 0.0
    ]
    return tuple(sorted(causes, key=lambda cause: -cause.share)) or (RankedCause("unknown", 1.0, COULOMB),)


def _explains(warmer: float, change: float) -> bool:
    """Return whether an oil that became ``warmer`` K warmer may change its viscosity by ``change``, 1."""
    if math.isnan(warmer) or warmer == 0.0 or change <= -1.0:
        return False
    slope = -math.log1p(change) / warmer
    return VISCOSITY_SLOPE[0] <= slope <= VISCOSITY_SLOPE[1]
