"""Draw of scenarios from a seed: all kinds there are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import drifts, faults, healthy
from .scenario import Scenario

SCENARIOS: tuple[Callable[[np.random.Generator], Scenario], ...] = (
    healthy.healthy, healthy.healthy_warming, healthy.healthy_speed, healthy.healthy_standstill,
    drifts.wear_ramp, drifts.wear_slow, drifts.wear_step, drifts.wear_warming, drifts.wear_speed,
    drifts.contamination, drifts.contamination_slow, drifts.contamination_warming,
    drifts.contamination_standstill, drifts.other_oil, drifts.spring_fatigue, drifts.spring_speed,
    drifts.resonance_15, drifts.resonance_29,
    faults.stuck, faults.dead, faults.clipping, faults.offset, faults.swapped, faults.scale, faults.gaps,
    faults.wear_then_dead, faults.contamination_then_stuck, faults.wear_and_spring, faults.resonance_and_wear,
)  # fmt: skip


def draw_cases(count: int, seed: int) -> list[Scenario]:
    """Return ``count`` scenarios, every kind in turn; each depends on ``seed`` and its own number alone."""
    return [
        SCENARIOS[number % len(SCENARIOS)](np.random.default_rng([seed, number])) for number in range(count)
    ]


def draw_hours(count: int, seed: int) -> list[Scenario]:
    """Return ``count`` healthy hours."""
    return [healthy.healthy_hour(np.random.default_rng([seed, 7, number])) for number in range(count)]
