"""Stale: nothing arrives, neither from the source nor from the estimator."""

from __future__ import annotations

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.detectors.base import MonitorLimit
from spool_monitor.event import Condition, Event, EventCause, EventKind, Facts, Finding, Namur, Severity

#: Cause where no block has ever come.
NEVER_SEEN = "never_seen"

KIND = EventKind(
    "stale",
    800,
    Namur.FAILURE,
    causes=(EventCause("acceleration", 801), EventCause("estimate", 802), EventCause(NEVER_SEEN, 803)),
)

STALE_AFTER = MonitorLimit("stale_after", 1.5, "Silence that is reported.", "s", 0.2, 60.0)


class StaleWatch:
    """Stale data of one valve: a condition for each of ``acceleration`` and ``estimate``.

    Attributes:
        told: until when (ns) blocks were last said to be missing.

    """

    def __init__(self) -> None:
        self.told = -1
        self.conditions = {
            source: Condition(KIND, 0.0, 0.0, source) for source in ("acceleration", "estimate")
        }

    @property
    def active(self) -> list[str]:
        """Names of what does not arrive now."""
        return [name for name, condition in self.conditions.items() if condition.active is not None]

    @property
    def never_seen(self) -> bool:
        """Whether it was told that no block has ever come."""
        return self.conditions["acceleration"].cause == NEVER_SEEN

    def silent(self, source: str, stamp: int, seconds: float, limit: float) -> list[Event]:
        """Say that ``source`` is silent for ``seconds`` at ``stamp`` (ns), longer than ``limit`` s."""
        return self._raise(source, source, stamp, seconds, limit)

    def nothing_ever(self, stamp: int, seconds: float, limit: float, *, refused: bool) -> list[Event]:
        """Say that no usable block came in ``seconds``; ``refused``: some came that were not."""
        cause = "acceleration" if refused else NEVER_SEEN
        return self._raise("acceleration", cause, stamp, seconds, limit)

    def arrived(self, source: str, stamp: int) -> list[Event]:
        """Say that ``source`` is heard at ``stamp`` (ns)."""
        return self.conditions[source].clear(stamp, Quantity("silence", "s"), Facts(note="arrives_again"))

    def _raise(self, source: str, cause: str, stamp: int, seconds: float, limit: float) -> list[Event]:
        silence = Quantity("silence", "s", seconds, validity=Validity.VALID)
        self.told = stamp if source == "acceleration" else self.told
        finding = Finding(stamp, Severity.ALARM, False, cause, silence, Facts.of(silence, limit))
        return self.conditions[source].judge(finding)
