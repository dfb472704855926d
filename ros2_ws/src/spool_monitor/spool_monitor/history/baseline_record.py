"""What a healthy valve looked like: the values to compare with, and what they are bound to."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from spool_stream.errors import InputError


class BaselineStage(enum.Enum):
    """How far a baseline has come."""

    LEARNED = "learned"  # complete and used, but nobody has confirmed it
    FROZEN = "frozen"  # confirmed: replaced by a newer version only


@dataclass(frozen=True, slots=True)
class HealthyValue:
    """One parameter of the healthy valve, in ``unit``.

    ``value`` is what is compared with (the median), ``spread`` the robust standard deviation around it;
    ``mean`` and ``standard_deviation`` are those of the ``count`` valid estimates. ``correlation`` is that of
    neighbouring ones (NaN: not determined), without which no false-alarm rate can be stated. ``referred``
    says that it holds at one oil temperature; at ``temperature`` (deg C, NaN: not measured) it was learned.
    """

    name: str
    unit: str
    value: float
    spread: float
    mean: float
    standard_deviation: float
    count: int
    correlation: float = math.nan
    referred: bool = False
    temperature: float = math.nan


@dataclass(frozen=True, slots=True)
class BaselineRecord:
    """A complete baseline.

    ``valve_id`` and ``oil`` (empty: not known) name what it was learned on, ``temperature`` the lowest and
    highest oil temperature met meanwhile (deg C, NaN: not measured), ``learned_at`` when (ns).
    ``who`` and ``comment`` are of whoever froze it.
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
