"""Friction drift: viscous drag or dry friction differ from what they were on the healthy valve."""

from __future__ import annotations

import math
from typing import ClassVar

from spool_core.text import Account, ShareOfCause

from spool_monitor.detectors.base import MonitorLimit
from spool_monitor.event import EventCause, EventKind, Finding, Namur, Severity
from spool_monitor.parameter_drift import ParameterDrift, RankedCause, rank_friction

from .base import ESTIMATE, Detector, DriftTest, Moment, judgement

KIND = EventKind(
    "friction_drift",
    200,
    Namur.MAINTENANCE_REQUIRED,
    causes=(
        EventCause(
            "wear",
            201,
            "The gap between spool and bore has grown, so the oil film drags less at the same temperature.",
            "measure the internal leakage, check the oil's cleanliness class, plan to replace the spool",
        ),
        EventCause(
            "oil_contamination",
            202,
            "Particles or varnish rub in the gap; dry friction rises and the spool begins to stick.",
            "take an oil sample (ISO 4406), change the filter, flush, clean the spool",
        ),
        EventCause(
            "oil_viscosity",
            203,
            "The drag of the oil film changed by more than its temperature explains.",
            "check the oil's grade and age, water and fuel in it, and the thermometer",
            Namur.OUT_OF_SPECIFICATION,
        ),
        EventCause(
            "unknown",
            204,
            "Friction changed in a way that no known cause explains.",
            "compare with the last maintenance, and learn a new baseline if the change was intended",
        ),
    ),
)

VISCOUS_CHANGE = MonitorLimit("viscous_change", 0.2, "Relative change that warns.", "1", 0.01, 10.0)
COULOMB_CHANGE = MonitorLimit(
    "coulomb_change", 0.1, "Change of the Coulomb force that warns.", "N", 1e-4, 1e4
)


class FrictionDrift(Detector):
    """Friction drift: what the sequential tests of the viscous coefficient and of the Coulomb force find."""

    name = "friction_drift"
    kind = KIND
    looks_at = (ESTIMATE,)
    drifts = (
        DriftTest("viscous_coefficient", "N s/m", VISCOUS_CHANGE),
        DriftTest("coulomb_force", "N", COULOMB_CHANGE),
    )
    on_delay: ClassVar[float] = 3.0
    off_delay: ClassVar[float] = 5.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the estimate of ``moment``, if there is a new one."""
        if moment.estimate is None:
            return None
        viscous, coulomb = (moment.parameters["viscous_coefficient"], moment.parameters["coulomb_force"])
        self.judgement = judgement(moment, (viscous, coulomb))
        levels = [one.level for one in (viscous, coulomb) if one.level is not None]
        indicated: Severity | None = max(levels, default=None)
        celsius = moment.estimate.oil_temperature.value
        causes = rank_friction(viscous, coulomb, moment.velocity, celsius - viscous.temperature)
        leading = moment.parameters[causes[0].parameter]

        def account() -> Account:
            began = 1e-9 * (moment.stamp - leading.since) if leading.since else math.nan
            told = tuple(
                ShareOfCause(one.name, one.share, _evidence(one, leading, moment.parameters))
                for one in causes
            )
            return Account(
                leading.text(),
                began=began,
                causes=told,
                sure=leading.sure,
                outlook=leading.outlook,
                hurries=leading.hurries,
            )

        released = viscous.released and coulomb.released
        return Finding(moment.stamp, indicated, released, causes[0].name, leading.latest_change, account)


def _evidence(cause: RankedCause, leading: ParameterDrift, parameters: dict[str, ParameterDrift]) -> str:
    """Return what speaks for ``cause`` beyond the change of ``leading``, which is said first."""
    own = parameters[cause.parameter]
    parts = ["" if own is leading else own.text(), cause.condition]
    return " ".join(part for part in parts if part)
