"""Machine's view: a row for each valve."""

from __future__ import annotations

from typing import Any

from spool_monitor.node.valve_condition import NO_WORD, condition_of

from .board import HeardValve
from .values import hertz, known

#: States of an alarm, by number, as `Alarm.msg` names them.
WAITING = ("unacknowledged", "returned_unacknowledged", "latched_unacknowledged")


#: What the monitor says where the strongest line is too weak to be one of the machine's.
AT_REST = "resonance: not enough excitation"


def margin_of(health: Any) -> float | None:
    """Return how far the strongest line lies from the natural frequency (1, negative: below it)."""
    line, natural = health.dominant_frequency, health.natural_frequency
    if AT_REST in health.judgements or not known(line) or not known(natural) or natural.value <= 0.0:
        return None
    return float(line.value / natural.value - 1.0)


def row_of(valve: HeardValve, now: float) -> dict[str, Any]:
    """Return what the machine's page shows of ``valve`` at ``now`` (s, monotonic)."""
    condition, health = condition_of(valve.health, now - valve.health_at), valve.health
    waiting = sum(alarm["state"] in WAITING for alarm in valve.alarms)
    row: dict[str, Any] = {
        "name": valve.name,
        "condition": condition,
        "waiting": waiting,
        "margin": None,
        "shakes": None,
        "natural": None,
        "summary": None,
    }
    if health is None or condition == NO_WORD:
        return row
    margin = margin_of(health)
    row["margin"] = None if margin is None else round(100.0 * margin)
    row["shakes"] = None if margin is None else hertz(health.dominant_frequency)
    row["natural"] = hertz(health.natural_frequency)
    row["summary"] = health.summary
    return row
