"""Friction drift: viscous drag or dry friction differ from what they were on the healthy valve."""

from __future__ import annotations

from typing import ClassVar

from ..diagnosis import advice, rank_friction
from ..event import Severity
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
        leading = coulomb if causes[0].name in ("oil_contamination", "unknown") else viscous

        def text() -> str:
            others = ", or ".join(
                f"{cause.name.replace('_', ' ')} ({100.0 * cause.share:.0f} %): {cause.evidence}"
                for cause in causes[1:]
                if cause.share >= 0.1
            )
            since = f" for {1e-9 * (moment.stamp - leading.since):.0f} s" if leading.since else ""
            first = f"{leading.text()}{since}: {causes[0].evidence} ({100.0 * causes[0].share:.0f} %)"
            return first + (f", or {others}" if others else "") + advice(self.kind, causes[0].name)

        released = viscous.released and coulomb.released
        return Finding(moment.stamp, indicated, released, causes[0].name, leading.change, text)
