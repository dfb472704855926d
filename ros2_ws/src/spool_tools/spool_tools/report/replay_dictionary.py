"""Replay of a record as a dictionary: what ``replay --json`` writes of each valve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from spool_bag.reading.timeline import Timeline
from spool_core.uncertainty import at_uncertain_rate
from spool_estimator.estimate import Estimate
from spool_estimator.refit import Refit
from spool_monitor.detectors import JUDGEMENT_TEXTS
from spool_monitor.events.event import Event
from spool_monitor.health import Health
from spool_monitor.replay import Replay

from spool_tools.input.valve_choice import ChosenValve

#: ns by which an event's stamp may lie before that of the one before it.
ORDER = 10_000_000_000


@dataclass(slots=True)
class Clock:
    """Clock of a record: time since its first stamp, across the steps of a clock that was set.

    Attributes:
        timeline: of the valve.
        first: the record's first stamp, ns.
    """

    timeline: Timeline
    first: int
    _told: int = 0

    def since(self, stamp: int) -> float:
        """Return the time (s) of ``stamp`` (ns); stamps come in the order in which they were told."""
        if not self.timeline.spans:
            return (stamp - self.first) * 1e-9
        passed = self.timeline.since(stamp, self._told)
        self._told = max(self._told, passed - ORDER)
        return (passed + self.timeline.spans[0].first - self.first) * 1e-9


def valve_dictionary(
    one: Replay,
    timeline: Timeline,
    first: int,
    chosen: ChosenValve,
    limits: Mapping[str, Any],
    warnings: Sequence[str],
    rate_std: float = 0.0,
) -> dict[str, Any]:
    """Return the entry of one valve in ``replay --json``.

    Args:
        one: its replay.
        timeline: of its blocks.
        first: the record's first stamp, ns.
        chosen: its description and where that came from.
        limits: that the monitor judged by, and where they came from.
        warnings: about it.
        rate_std: relative standard deviation of the record's sampling rate, which enters those of parameters.
    """
    gate = one.estimator.gate
    events, refits = Clock(timeline, first), Clock(timeline, first)
    return {
        "blocks": gate.accepted,
        "lost_blocks": gate.lost,
        "samples": one.samples,
        "estimate": _estimate(one.estimator.latest, rate_std),
        "health": _health(one.monitor.health),
        "events": [_event(event, events) for event in one.events],
        **({} if one.refits is None else {"refits": [_refit(found, refits) for found in one.refitted]}),
        "valve": _chosen(chosen),
        "limits": dict(limits),
        "warnings": list(warnings),
    }


def _chosen(chosen: ChosenValve) -> dict[str, Any]:
    """Return which valve a replay took."""
    return {
        "id": chosen.valve.id,
        "source": chosen.source,
        "file": chosen.file or None,
        "moving_mass_kg": chosen.valve.moving_mass,
        "natural_frequency_Hz": chosen.valve.natural_frequency,
        "sentence": chosen.sentence(),
    }


def _refit(found: Refit, clock: Clock) -> dict[str, Any]:
    return {
        "t_s": clock.since(found.stamp),
        "model": found.model,
        "state": found.state.name.lower(),
        "reason": found.reason,
        "parameters": {quantity.name: quantity.to_dict() for quantity in found.parameters},
        "fitted": list(found.fitted),
        "correlations": np.reshape(found.correlations, (len(found.fitted),) * 2).tolist(),
        "objective": found.objective.value,
        "amplitude_ratio": found.amplitude_ratio.value,
        "nrmse": found.nrmse.value,
    }


def _health(health: Health) -> dict[str, Any]:
    """Return the last judgement; what could not be judged is said by detector."""
    return {
        "level": health.level.name.lower(),
        "baseline": health.baseline.text,
        "summary": health.summary,
        "judgements": {name: JUDGEMENT_TEXTS[judgement] for name, judgement in health.judgements},
    }


def _estimate(estimate: Estimate | None, rate_std: float) -> dict[str, Any]:
    if estimate is None:
        nothing = dict.fromkeys(("model", "state", "natural_frequency_Hz", "damping_ratio", "nrmse"))
        return {**nothing, "parameters": {}}
    return {
        "model": estimate.model,
        "state": estimate.state.name.lower(),
        "parameters": {
            quantity.name: at_uncertain_rate(quantity, rate_std).to_dict() for quantity in estimate.parameters
        },
        "natural_frequency_Hz": estimate.natural_frequency.value,
        "damping_ratio": estimate.damping_ratio.value,
        "nrmse": estimate.residual.value,
    }


def _event(event: Event, clock: Clock) -> dict[str, Any]:
    return {
        "t_s": clock.since(event.stamp),
        "kind": event.kind,
        "state": event.state.name.lower(),
        "severity": event.severity.name.lower(),
        "cause": event.cause or None,
        "value": event.quantity.value,
        "unit": event.quantity.unit,
        "message": event.message,
    }
