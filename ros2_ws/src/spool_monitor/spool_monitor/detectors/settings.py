"""Settings of one valve's monitor: declared limits with their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MonitorLimit:
    """Limit that something is judged by; each is a parameter of the node ``monitor``.

    The file that needs it declares it: the registry finds it there. ``default``, ``minimum`` and ``maximum``
    are in ``unit``. A ``structural`` one changes only while the node is unconfigured.
    """

    name: str
    default: float
    description: str
    unit: str
    minimum: float
    maximum: float
    structural: bool = False


class MonitorSettings:
    """Settings of one valve's monitor, e.g. ``MonitorSettings(coulomb_change=0.2)[COULOMB_CHANGE]``.

    Limits that are not given have their defaults. The detectors' registry checks names and contradictions.
    """

    def __init__(self, **values: float) -> None:
        self.given: Mapping[str, float] = values

    def __getitem__(self, limit: MonitorLimit) -> float:
        """Return the value of ``limit``, in its unit."""
        return self.given.get(limit.name, limit.default)

    def changed(self, limit: MonitorLimit, value: float) -> MonitorSettings:
        """Return the same settings but for ``limit``."""
        return MonitorSettings(**{**self.given, limit.name: value})


#: Needed by several detectors, or by what feeds them.
NATURAL_FREQUENCY = MonitorLimit(
    "natural_frequency", 0.0, "Start value until it is estimated; 0: from the valve's description.",
    "Hz", 0.0, 1e3, structural=True,
)  # fmt: skip
MINIMUM_BODY = MonitorLimit("minimum_body", 0.5, "Peak body acceleration that is judged.", "m/s^2", 0.0, 1e3)
FALSE_ALARM_HOURS = MonitorLimit(
    "false_alarm_hours", 1000.0, "Mean time between false alarms that noise alone may cause.", "h", 1.0, 1e6
)
BASELINE_TIME = MonitorLimit(
    "baseline_time", 15.0, "Time of valid estimates for the start values.", "s", 3.0, 1e5, structural=True
)
