"""A full hypothesis as numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from spool_sim.terms import term


@dataclass(frozen=True, slots=True)
class Point:
    """A full hypothesis: terms that are switched on, their numbers, gain and delay of the spool's channel."""

    active: tuple[str, ...]
    values: Mapping[str, float]
    gain: float = 0.0
    delay: float = 0.0

    def get(self, name: str) -> float:
        """Return a number by its name."""
        if name == "spool_gain_error":
            return self.gain
        return self.delay if name == "spool_delay" else self.values[name]

    def unit(self, name: str) -> str:
        """Return the unit of a number."""
        own = {p.name: p.unit for entry in self.active for p in term(entry).parameters}
        return ({"spool_gain_error": "1", "spool_delay": "s"} | own)[name]

    def moved(self, names: Sequence[str], numbers: Sequence[float]) -> Point:
        """Return this with other ``numbers`` of ``names``."""
        given = dict(zip(names, numbers, strict=True))
        gain, delay = given.pop("spool_gain_error", self.gain), given.pop("spool_delay", self.delay)
        return replace(self, values={**self.values, **given}, gain=gain, delay=delay)

    def damped(self, damper: float) -> Point:
        """Return this with a damper (N s/m) beside its viscous drag, without a share in that one's drift."""
        values = dict(self.values)
        known = values["viscous_coefficient"]
        values["viscous_coefficient"] = known + damper
        if "damping_drift_rate" in values:
            values["damping_drift_rate"] *= known / (known + damper)
        return replace(self, values=values)
