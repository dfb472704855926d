"""Baseline record: the values of the healthy valve to compare with, and what they are bound to."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from spool_core.errors import InputError

from spool_monitor.drift.baseline import HealthyValue


class BaselineStage(enum.Enum):
    """Stage of a baseline: how far it has come."""

    LEARNED = "learned"  # complete and used, but nobody has confirmed it
    FROZEN = "frozen"  # confirmed: replaced by a newer version only


@dataclass(frozen=True, slots=True)
class BaselineRecord:
    """Baseline of a valve, complete.

    ``valve_id`` and ``oil`` (empty: not known) name what it was learned on, ``temperature`` the lowest and
    highest oil temperature met meanwhile (deg C, NaN: not measured), ``learned_at`` when (ns).
    ``who`` and ``comment`` are of the operator who froze it.
    """

    valve_id: str
    oil: str = ""
    temperature: tuple[float, float] = (math.nan, math.nan)
    version: int = 0
    stage: BaselineStage = BaselineStage.LEARNED
    learned_at: int = 0
    who: str = ""
    comment: str = ""
    values: tuple[HealthyValue, ...] = field(default=())

    def value(self, name: str) -> HealthyValue | None:
        """Return a parameter by its name, ``None`` where it was not learned."""
        return next((value for value in self.values if value.name == name), None)

    def check_valve(self, valve_id: str, oil: str) -> None:
        """Make sure that this is the baseline of that valve with that oil.

        Raises:
            InputError: it is another's; both are named. An unknown oil (empty) fits every one.

        """
        if valve_id != self.valve_id:
            raise InputError(
                f"baseline version {self.version} is of valve {self.valve_id}, not of {valve_id}: "
                "name that valve's state_folder, or learn anew"
            )
        if oil and self.oil and oil != self.oil:
            raise InputError(
                f"baseline version {self.version} of {valve_id} was learned with {self.oil}, "
                f"the valve runs on {oil}: learn anew"
            )

    def covers(self, celsius: float, margin: float = 5.0) -> bool:
        """Whether ``celsius`` lies in the temperature band, ``margin`` (deg C) wider; unknown ones do."""
        low, high = self.temperature
        return not (celsius < low - margin or celsius > high + margin)
