"""Condition of a valve on the terminal: its word, a mark that tells it without colour, and its style."""

from __future__ import annotations

from dataclasses import dataclass

from spool_monitor.node import valve_condition as conditions
from spool_msgs.msg import HealthEvent

from .heard import HeardValve

SEVERITIES = {HealthEvent.SEVERITY_WARNING: "warning", HealthEvent.SEVERITY_ALARM: "ALARM"}


@dataclass(frozen=True, slots=True)
class Shown:
    """Condition as it is shown; lower ``rank`` is worse."""

    word: str
    mark: str
    style: str
    rank: int


_LOOKS = {
    conditions.ALARM: ("ALARM", "\u25b2", "bold red"),
    conditions.NO_WORD: ("NO WORD", "\u00d7", "bold magenta"),
    conditions.STALE: ("STALE", "\u00d7", "bold magenta"),
    conditions.WARNING: ("WARNING", "\u25c6", "bold yellow"),
    conditions.UNKNOWN: ("UNKNOWN", "?", "bold"),
    conditions.LEARNING: ("LEARNING", "\u2026", "cyan"),
    conditions.AT_REST: ("AT REST", "\u2013", "cyan"),
    conditions.GOOD: ("OK", "\u25cf", "bold green"),
}
SHOWN = {name: Shown(*_LOOKS[name], rank) for rank, name in enumerate(conditions.CONDITIONS)}


def shown_condition(valve: HeardValve, now: float) -> Shown:
    """Return the condition of ``valve`` at ``now`` (s, monotonic)."""
    return SHOWN[conditions.condition_of(valve.health, now - valve.health_at)]
