"""Condition of a valve for whoever looks: what is known of it, never better than what was heard lately."""

from __future__ import annotations

from spool_msgs.msg import ModelEstimate, ValveHealth

from .board import HeardValve

#: s without a word of the monitor, which speaks once a second, after which nothing is known.
SILENT = 2.5

ALARM, NO_WORD, STALE, WARNING = "alarm", "no_word", "stale", "warning"
UNKNOWN, LEARNING, AT_REST, GOOD = "unknown", "learning", "at_rest", "good"
#: Worst first.
CONDITIONS = (ALARM, NO_WORD, STALE, WARNING, UNKNOWN, LEARNING, AT_REST, GOOD)

_LEVELS = {
    ValveHealth.LEVEL_ALARM: ALARM,
    ValveHealth.LEVEL_WARNING: WARNING,
    ValveHealth.LEVEL_STALE: STALE,
    ValveHealth.LEVEL_UNKNOWN: UNKNOWN,
}
_STATES = {
    ModelEstimate.STATE_UNKNOWN: LEARNING,
    ModelEstimate.STATE_LEARNING: LEARNING,
    ModelEstimate.STATE_STALE: STALE,
    ModelEstimate.STATE_NOT_EXCITED: AT_REST,
}


def condition_of(valve: HeardValve, now: float) -> str:
    """Return the condition of ``valve`` at ``now`` (s, monotonic), one of ``CONDITIONS``.

    It is good only where the monitor spoke lately, judges it good against a learned baseline, and the
    estimator follows the data; a level that nobody knows is unknown.
    """
    health = valve.health
    if health is None or now - valve.health_at > SILENT:
        return NO_WORD
    if health.level != ValveHealth.LEVEL_OK:
        return _LEVELS.get(health.level, UNKNOWN)
    if valve.estimate_state in _STATES:
        return _STATES[valve.estimate_state]
    if valve.estimate_state not in (ModelEstimate.STATE_TRACKING, ModelEstimate.STATE_SETTLING):
        return UNKNOWN
    return GOOD if health.baseline == ValveHealth.BASELINE_FROZEN else LEARNING
