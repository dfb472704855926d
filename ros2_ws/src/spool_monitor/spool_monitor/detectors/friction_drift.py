"""Friction drift: viscous drag or dry friction differ from what they were on the healthy valve."""

from __future__ import annotations

import math
from typing import ClassVar

from spool_stream.text.sentence import Account, ShareOfCause

from spool_monitor.alarms.event import Severity
from spool_monitor.diagnosis import Cause, rank_friction
from spool_monitor.drift import ParameterDrift

from .base import ESTIMATE, Detector, Finding, Moment, judgement


class FrictionDrift(Detector):
    """Raise what the sequential tests of the viscous coefficient and of the Coulomb force find."""

    name = "friction_drift"
    kind = "friction_drift"
    looks_at = (ESTIMATE,)
    on_delay: ClassVar[float] = 3.0
    off_delay: ClassVar[float] = 5.0

    def update(self, moment: Moment) -> Finding | None:
        """Judge the estimate of ``moment``, if there is a new one."""
        if moment.estimate is None:
            return None
        viscous, coulomb = moment.parameters["viscous_coefficient"], moment.parameters["coulomb_force"]
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
            return Account(leading.text(), began=began, causes=told)

        released = viscous.released and coulomb.released
        return Finding(moment.stamp, indicated, released, causes[0].name, leading.latest_change, account)


def _evidence(cause: Cause, leading: ParameterDrift, parameters: dict[str, ParameterDrift]) -> str:
    """Return what speaks for ``cause`` beyond the change of ``leading``, which is said first."""
    own = parameters[cause.parameter]
    parts = ["" if own is leading else own.text(), cause.condition]
    return " ".join(part for part in parts if part)
