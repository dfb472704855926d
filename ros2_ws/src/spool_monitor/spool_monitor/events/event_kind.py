"""Event kind: what plant systems and operators rely on: number, NAMUR status, latch, causes, remedies."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace


class Namur(enum.IntEnum):
    """Status signal after NAMUR NE 107, a worse one above; numbers as in ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    NORMAL = 1
    MAINTENANCE_REQUIRED = 2  # M: works, but its reserve is running out
    OUT_OF_SPECIFICATION = 3  # S: is operated outside of what it was made for
    FUNCTION_CHECK = 4  # C: for now not valid, somebody works on it or it learns
    FAILURE = 5  # F: the signal is not valid

    @property
    def letter(self) -> str:
        """The letter that people know the status by; empty where all is well or nothing is known."""
        return {5: "F", 4: "C", 3: "S", 2: "M"}.get(int(self), "")


@dataclass(frozen=True, slots=True)
class EventCause:
    """Cause of an event: its number, what it means on the machine, and what to do.

    What is left empty, and ``namur`` where it is unknown, is as for the kind as a whole.
    """

    name: str
    code: int
    meaning: str = ""
    remedy: str = ""
    namur: Namur = Namur.UNKNOWN


@dataclass(frozen=True, slots=True)
class EventKind:
    """Event kind: what its events mean to a plant and to an operator.

    A number (``code``) once given never changes its meaning. ``latching``: its alarms stay until somebody
    resets them, since the machine must not forget them by itself. ``task`` is the one of ``/diagnostics``
    that shows its detectors. Files that share a kind declare it with the causes that they find.
    """

    name: str
    code: int
    namur: Namur
    meaning: str = ""
    remedy: str = ""
    latching: bool = False
    task: str = "condition"
    causes: tuple[EventCause, ...] = ()

    def cause(self, name: str) -> EventCause:
        """Return the cause called ``name``; one that is not listed is the kind as a whole."""
        whole = EventCause(name, self.code, self.meaning, self.remedy, self.namur)
        listed = next((one for one in self.causes if one.name == name), whole)
        return replace(
            listed,
            meaning=listed.meaning or whole.meaning,
            remedy=listed.remedy or whole.remedy,
            namur=listed.namur or whole.namur,
        )
