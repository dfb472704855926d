"""Friction drift: viscous drag or dry friction differ from what they were on the healthy valve."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.event import EventCause, EventKind, Facts, Finding, Namur, Severity
from spool_monitor.parameter_drift import VISCOUS, rank_friction

from .base import ESTIMATE, Detector, DriftTest, Moment, MonitorLimit, judgement

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


class FrictionDrift(Detector):
    """What the sequential tests of the viscous coefficient and of the Coulomb force find."""

    name = "friction_drift"
    kind = KIND
    looks_at = (ESTIMATE,)
    drifts = (
        DriftTest("viscous_coefficient", "N s/m", VISCOUS_CHANGE),
        DriftTest("coulomb_force", "N", COULOMB_CHANGE),
    )
    on_delay: ClassVar[float] = 0.0
    off_delay: ClassVar[float] = 5.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the estimate of ``moment``, if there is a new one."""
        if moment.estimate is None:
            return None
        viscous, coulomb = (moment.parameters["viscous_coefficient"], moment.parameters["coulomb_force"])
        self.judgement = judgement(moment, (viscous, coulomb))
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
                note = "oil_referred" if viscous.referred else unknown
            return replace(
                leading.facts(),
                causes=tuple(one.name for one in causes),
                probabilities=tuple(one.share for one in causes),
                note=note,
                evidence=tuple(further),
            )

        released = viscous.released and coulomb.released
        return Finding(
            moment.stamp, indicated, released, causes[0].name, leading.latest_change, facts, leading.hurries
        )
