"""Point in the space of hypotheses: what is on, and with which numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from spool_sim.terms import TERMS, term

from spool_gap.registry import EFFECTS
from spool_gap.sensor_effect import SensorEffect

GAIN, DELAY = "spool_gain_error", "spool_delay"


@dataclass(frozen=True, slots=True)
class Point:
    """A full hypothesis: force terms and sensor effects that are on, and their numbers.

    Gain and delay of the spool's channel are part of every hypothesis.
    """

    active: tuple[str, ...]
    values: Mapping[str, float]
    gain: float = 0.0
    delay: float = 0.0

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the force terms that are on."""
        return tuple(name for name in self.active if name in TERMS)

    @property
    def sensors(self) -> tuple[SensorEffect, ...]:
        """Sensor effects that are on, gain and delay apart."""
        found = (EFFECTS.get(name) for name in self.active if name not in TERMS)
        return tuple(entry for entry in found if isinstance(entry, SensorEffect) and entry.searched)

    def get(self, name: str) -> float:
        """Return a number by its name."""
        if name == GAIN:
            return self.gain
        return self.delay if name == DELAY else self.values[name]

    def unit(self, name: str) -> str:
        """Return the unit of a number."""
        own = {p.name: p.unit for entry in self.sensors for p in entry.numbers}
        own |= {p.name: p.unit for entry in self.terms for p in term(entry).parameters}
        return ({GAIN: "1", DELAY: "s"} | own)[name]

    def moved(self, names: Sequence[str], numbers: Sequence[float]) -> Point:
        """Return this with other ``numbers`` of ``names``."""
        given = dict(zip(names, numbers, strict=True))
        gain, delay = given.pop(GAIN, self.gain), given.pop(DELAY, self.delay)
        return replace(self, values={**self.values, **given}, gain=gain, delay=delay)

    def damped(self, damper: float) -> Point:
        """Return this with a damper (N s/m) next to its viscous drag, without a share in that one's drift."""
        values = dict(self.values)
        known = values["viscous_coefficient"]
        values["viscous_coefficient"] = known + damper
        if "damping_drift_rate" in values:
            values["damping_drift_rate"] *= known / (known + damper)
        return replace(self, values=values)
