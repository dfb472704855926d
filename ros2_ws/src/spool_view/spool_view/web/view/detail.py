"""Valve's view: estimates against baseline and threshold, resonance, gap analysis."""

from __future__ import annotations

import math
from typing import Any

from spool_monitor.node.valve_condition import NO_WORD
from spool_msgs.msg import GapAnalysis

from .board import HeardValve
from .machine import margin_of, row_of
from .values import known, rounded, shown

#: The monitor's limit of each parameter, and whether it is relative to the baseline.
LIMITS = {
    "spring_stiffness": ("stiffness_change", True),
    "viscous_coefficient": ("viscous_change", True),
    "coulomb_force": ("coulomb_change", False),
}
#: The monitor's limit of the distance to the natural frequency.
BAND = "resonance_band"
#: All of the monitor's limits that are shown.
NAMES = (*(name for name, _ in LIMITS.values()), BAND)
_STATES = ("unknown", "learning", "tracking", "not_excited", "stale", "settling")
_OTHERS = (
    "natural_frequency", "damping_ratio", "oil_temperature", "residual", "excitation",
    "relative_displacement",
)  # fmt: skip


def detail_of(valve: HeardValve, now: float) -> dict[str, Any]:
    """Return what the page of ``valve`` shows at ``now`` (s, monotonic)."""
    estimate = valve.estimate
    detail = row_of(valve, now)
    silent = detail["condition"] == NO_WORD
    detail["alarms"] = list(valve.alarms)
    detail["resonance"] = None if silent or valve.health is None else _resonance(valve)
    detail["judgements"] = [] if silent or valve.health is None else list(valve.health.judgements)
    detail["baseline"] = _baseline(valve.baseline)
    detail["gap"] = _gap(valve.gap)
    detail["estimate"] = None
    if estimate is not None:
        state = _STATES[estimate.state] if estimate.state < len(_STATES) else "unknown"
        detail["estimate"] = {
            "model": estimate.model,
            "state": "stale" if silent else state,
            "parameters": [_parameter(valve, one) for one in estimate.parameters],
            "others": [shown(getattr(estimate, name)) for name in _OTHERS],
            "lost": int(estimate.lost_blocks),
            "refused": int(estimate.refused_blocks),
        }
    return detail


def _resonance(valve: HeardValve) -> dict[str, Any]:
    health = valve.health
    margin, band = margin_of(health), valve.limits.get(BAND)
    return {
        "margin": None if margin is None else round(100.0 * margin),
        "band": None if band is None else rounded(100.0 * band, 3),
        "shakes": shown(health.dominant_frequency),
        "natural": shown(health.natural_frequency),
        "amplification": shown(health.amplification),
    }


def _parameter(valve: HeardValve, quantity: Any) -> dict[str, Any]:
    """Return an estimate with its baseline and the limits that the monitor warns at."""
    compared = quantity
    if quantity.name == "viscous_coefficient" and known(valve.estimate.referred_viscous_coefficient):
        # The monitor compares what drags at one temperature of the oil.
        compared = valve.estimate.referred_viscous_coefficient
    found = {**shown(quantity), "compared": None, "baseline": None, "low": None, "high": None, "change": None}
    values = [] if valve.baseline is None else valve.baseline.values
    baseline = next((one for one in values if one.name == quantity.name), None)
    if compared is not quantity:
        found["compared"] = shown(compared)
    if baseline is None or not math.isfinite(baseline.value):
        return found
    found["baseline"] = shown(baseline)
    limit, relative = LIMITS.get(quantity.name, ("", False))
    change = valve.limits.get(limit)
    if change is not None:
        change = abs(baseline.value) * change if relative else change
        found["low"], found["high"] = rounded(baseline.value - change), rounded(baseline.value + change)
    if known(compared) and baseline.value:
        found["change"] = rounded(100.0 * (compared.value / baseline.value - 1.0), 3)
    return found


def _baseline(answer: Any) -> dict[str, Any] | None:
    if answer is None:
        return None
    return {
        "version": int(answer.version),
        "stage": answer.stage,
        "valve_id": answer.valve_id,
        "oil": answer.oil,
        "frozen_by": answer.frozen_by,
    }


def _gap(message: Any) -> dict[str, Any] | None:
    if message is None:
        return None
    return {
        "done": message.state == GapAnalysis.STATE_DONE,
        "verdict": message.verdict,
        "confidence": rounded(message.confidence.value, 3),
        "sentence": message.sentence,
        "window": rounded(message.window, 3),
        "stamp": int(message.header.stamp.sec),
        "report": bool(message.json),
    }
