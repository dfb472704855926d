"""Condition of a valve for whoever looks: what is known of it, never better than what was heard lately."""

from __future__ import annotations

from dataclasses import dataclass

from spool_msgs.msg import HealthEvent, ModelEstimate, ValveHealth

from .heard import HeardValve

#: s without a word of the monitor, which speaks once a second, after which nothing is known.
SILENT = 3.0


@dataclass(frozen=True, slots=True)
class Condition:
    """Condition: its word, a mark that tells it without colour, and its style; lower ``rank`` is worse."""

    word: str
    mark: str
    style: str
    rank: int


ALARM = Condition("ALARM", "\u25b2", "bold red", 0)
NO_WORD = Condition("NO WORD", "\u00d7", "bold magenta", 1)
STALE = Condition("STALE", "\u00d7", "bold magenta", 2)
WARNING = Condition("WARNING", "\u25c6", "bold yellow", 3)
UNKNOWN = Condition("UNKNOWN", "?", "bold", 4)
LEARNING = Condition("LEARNING", "\u2026", "cyan", 5)
NOT_EXCITED = Condition("AT REST", "\u2013", "cyan", 6)
GOOD = Condition("OK", "\u25cf", "bold green", 7)

_LEVELS = {
    ValveHealth.LEVEL_ALARM: ALARM,
    ValveHealth.LEVEL_WARNING: WARNING,
    ValveHealth.LEVEL_STALE: STALE,
    ValveHealth.LEVEL_UNKNOWN: UNKNOWN,
}
SEVERITIES = {HealthEvent.SEVERITY_WARNING: "warning", HealthEvent.SEVERITY_ALARM: "ALARM"}


def condition_of(valve: HeardValve, now: float) -> Condition:
    """Return the condition of ``valve`` at ``now`` (s, monotonic): good only where all is known."""
    health, estimate = valve.health, valve.estimate
    if health is None or now - valve.health_at > SILENT:
        return NO_WORD
    if health.level in _LEVELS:
        return _LEVELS[health.level]
    if estimate is None or estimate.state in (ModelEstimate.STATE_UNKNOWN, ModelEstimate.STATE_LEARNING):
        return LEARNING
    if estimate.state == ModelEstimate.STATE_STALE:
        return STALE
    if estimate.state == ModelEstimate.STATE_NOT_EXCITED:
        return NOT_EXCITED
    return LEARNING if health.baseline != ValveHealth.BASELINE_FROZEN else GOOD
