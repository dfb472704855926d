"""Health of one valve: what the monitor makes of it at a time."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from spool_core.uncertainty import Quantity

from spool_monitor.detectors import Judgement
from spool_monitor.events.event_kind import Namur


class HealthLevel(enum.IntEnum):
    """Level of a valve's health; the numbers are those of ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    OK = 1
    WARNING = 2
    ALARM = 3
    STALE = 4


class BaselineState(enum.IntEnum):
    """State of the baseline; the numbers are those of ``spool_msgs/msg/ValveHealth``.

    FROZEN means that the start values are learned and fixed. Whether somebody confirmed them is the stage of
    the kept :class:`~.history.baseline_record.BaselineRecord`, and the text does not claim it.
    """

    UNKNOWN = 0
    LEARNING = 1
    FROZEN = 2

    @property
    def text(self) -> str:
        """What people read: unknown, learning or learned."""
        return "learned" if self is BaselineState.FROZEN else self.name.lower()


@dataclass(frozen=True, slots=True)
class Health:
    """Health of the valve at ``stamp`` (ns); fields as in ``ValveHealth``."""

    stamp: int
    level: HealthLevel
    baseline: BaselineState
    summary: str
    active: tuple[str, ...]
    dominant_frequency: Quantity
    amplification: Quantity
    natural_frequency: Quantity
    viscous_drift: Quantity
    coulomb_drift: Quantity
    judgements: tuple[tuple[str, Judgement], ...]
    namur: Namur = Namur.UNKNOWN
