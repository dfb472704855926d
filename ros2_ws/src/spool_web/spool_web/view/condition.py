"""Condition of a valve for whoever looks: what is known of it, never better than what was heard lately."""

from __future__ import annotations

from collections.abc import Sequence

from spool_msgs.msg import ValveHealth

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
#: Detectors that compare the valve with its baseline: it is good only where all of them judge.
DRIFT = ("friction_drift", "spring_change")
#: What the monitor says of a detector (`ValveHealth.msg`, judgements), and what that makes of the valve.
_JUDGEMENTS = {"judged": GOOD, "learning": LEARNING, "not enough excitation": AT_REST}


def condition_of(valve: HeardValve, now: float) -> str:
    """Return the condition of ``valve`` at ``now`` (s, monotonic), one of ``CONDITIONS``.

    It is good only where the monitor spoke lately, has a baseline and judges drift against it; a level or a
    judgement that nobody knows is unknown.
    """
    health = valve.health
    if health is None or now - valve.health_at > SILENT:
        return NO_WORD
    if health.level != ValveHealth.LEVEL_OK:
        return _LEVELS.get(health.level, UNKNOWN)
    if health.baseline != ValveHealth.BASELINE_FROZEN:
        return LEARNING
    return _judged(health.judgements)


def _judged(judgements: Sequence[str]) -> str:
    """Return the worst condition that the judgements of ``DRIFT`` allow."""
    said = dict(judgement.partition(": ")[::2] for judgement in judgements)
    found = [_JUDGEMENTS.get(said.get(name, ""), UNKNOWN) for name in DRIFT]
    return min(found, key=CONDITIONS.index)
