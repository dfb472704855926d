"""Friction drift: viscous drag or dry friction differ from what they were on the healthy valve."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.detectors.base import Detector, DriftTest, Moment, MonitorLimit, judgement, on_delay
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
        EventCause("oil_or_wear", 205, open=True),
        EventCause("sensor_or_friction", 206, open=True),
    ),
)

VISCOUS_CHANGE = MonitorLimit("viscous_change", 0.2, "Relative change to act on.", "1", 0.01, 10.0)
COULOMB_CHANGE = MonitorLimit("coulomb_change", 0.1, "Change of the Coulomb force to act on.", "N", 1e-4, 1e4)

#: Relative change of a viscosity per K of an ISO VG oil, lowest and highest (ASTM D341 over 20 to 80 deg C).
VISCOSITY_SLOPE = (0.02, 0.09)

#: A sensor that changes looks like a drift at first.
ON_DELAY = on_delay("friction_drift", 2.0)


class FrictionDrift(Detector):
    """What the sequential tests of the viscous coefficient and of the Coulomb force find."""

    name = "friction_drift"
    kind = KIND
    looks_at = ("estimate",)
    drifts = (
        DriftTest("viscous_coefficient", "N s/m", VISCOUS_CHANGE),
        DriftTest("coulomb_force", "N", COULOMB_CHANGE),
    )
    on_delay = ON_DELAY
    off_delay: ClassVar[float] = 5.0
    parts = tuple(one.parameter for one in drifts)

    def update(self, moment: Moment) -> tuple[Finding, ...]:
        """Judge the estimate of ``moment``, if there is a new one: each parameter by itself."""
        if moment.estimate is None:
            return ()
        tests = [moment.parameters[name] for name in self.parts]
        self.judgement = judgement(moment.distrust, tests)
        celsius = moment.estimate.oil_temperature.value
        return tuple(self._finding(moment, one, celsius - one.temperature) for one in tests)

    def _finding(self, moment: Moment, drift: ParameterDrift, warmer: float) -> Finding:
        causes = rank_friction(drift, warmer)
        cause, level = next(iter(causes)), drift.level
        if drift.doubtful and drift.parameter == VISCOUS:
            cause = "oil_or_wear"
        cause = "sensor_or_friction" if moment.gain.bends else cause
        if KIND.cause(cause).open:
            level = level and Severity.WARNING

        def facts() -> Facts:
            note = ""
            evidence: tuple[Quantity, ...] = ()
            if math.isfinite(warmer):
                evidence = (Quantity("oil_temperature_change", "K", warmer, validity=Validity.VALID),)
            if drift.parameter == VISCOUS:
                unknown = "" if evidence else "oil_temperature_unknown"
                note = "oil_referred" if drift.referred and not drift.assumed else unknown
                note = "oil_may_follow" if drift.doubtful and not drift.assumed else note
                note = "oil_temperature_frozen" if drift.frozen else note
            names, shares = tuple(causes), tuple(causes.values())
            return replace(drift.facts(), causes=names, probabilities=shares, note=note, evidence=evidence)

        side = int(math.copysign(1.0, drift.share))
        released = drift.released or moment.gain.breaks
        return Finding(
            moment.stamp, level, released, cause, drift.latest_change, facts,
            drift.hurries, drift.eased, drift.parameter, side,
        )  # fmt: skip


def rank_friction(drift: ParameterDrift, warmer: float = math.nan) -> dict[str, float]:
    """Return the causes of a change of drag or dry friction and their probabilities, the likeliest first.

    Thinner oil and a wider gap change the same coefficient: at the same temperature the gap is more likely,
    where the oil became warmer by ``warmer`` K and nothing was referred to it, the oil is.
    """
    rises = drift.share > 0.0
    if drift.parameter != VISCOUS:
        return {"oil_contamination" if rises else "unknown": 1.0}
    if rises:
        return {"oil_viscosity": 1.0}
    if drift.frozen or drift.doubtful:  # a thermometer that stands still says nothing of the oil
        return {"wear": 0.5, "oil_viscosity": 0.5}
    if not drift.referred and _explains(warmer, drift.share * drift.matters):
        return {"oil_viscosity": 0.7, "wear": 0.3}
    return {"wear": 0.75, "oil_viscosity": 0.25}


def _explains(warmer: float, change: float) -> bool:
    """Return whether an oil that became ``warmer`` K warmer may change its viscosity by ``change``, 1."""
    if math.isnan(warmer) or warmer == 0.0 or change <= -1.0:
        return False
    slope = -math.log1p(change) / warmer
    return VISCOSITY_SLOPE[0] <= slope <= VISCOSITY_SLOPE[1]
