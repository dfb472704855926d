"""Condition of a valve for people: what is known of it, never better than what its monitor said lately."""

from __future__ import annotations

import re

from rclpy.node import Node
from spool_msgs.msg import ValveHealth

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
#: Ends of a parameter's name in ``/diagnostics``, as ``coulomb_force_low_N``: beyond these values it warns.
ENDS = ("low", "high")
#: What the monitor says of a detector (`ValveHealth.msg`, judgements), and what that makes of the valve.
_JUDGEMENTS = {"judged": GOOD, "learning": LEARNING, "not enough excitation": AT_REST}
_HEALTH = re.compile(r"/(?P<valve>[A-Za-z0-9_/]+)/health")


def condition_of(health: ValveHealth | None, age: float) -> str:
    """Return the condition, one of ``CONDITIONS``, by the monitor's last word, which came ``age`` s ago.

    It is good only where the monitor spoke lately, has a baseline and judges drift against it, of one
    parameter of each detector at least: the summary names those that it cannot judge. A level or a judgement
    that nobody knows is unknown.
    """
    if health is None or age > SILENT:
        return NO_WORD
    if health.level != ValveHealth.LEVEL_OK:
        return _LEVELS.get(health.level, UNKNOWN)
    if health.baseline != ValveHealth.BASELINE_FROZEN:
        return LEARNING
    said = dict(judgement.partition(": ")[::2] for judgement in health.judgements)
    return min((_drift(name, said) for name in DRIFT), key=CONDITIONS.index)


def _drift(name: str, said: dict[str, str]) -> str:
    """Return the condition by what was ``said`` of the detector ``name`` and its parameters."""
    partly = [judgement for one, judgement in said.items() if one.startswith(f"{name}/")]
    return GOOD if "judged" in partly else _JUDGEMENTS.get(said.get(name, ""), UNKNOWN)


def monitored_valves(node: Node) -> list[str]:
    """Return the namespaces of the valves whose monitors ``node`` discovers."""
    return [
        match["valve"]
        for topic, types in node.get_topic_names_and_types()
        if "spool_msgs/msg/ValveHealth" in types and (match := _HEALTH.fullmatch(topic))
    ]
