"""Draw of scenarios from a seed: all kinds there are."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np

from .drifts import passes, passes_and_wears, rubs, seen_after_standstill, thickens, tires, wears
from .faults import clipping, dead, dies, exchanged, loses_data, offset, scale, sticks, sticks_for_good
from .healthy import (
    Generator,
    draw_case,
    healthy_hour,
    with_speeds,
    with_standstills,
    with_warming,
)
from .scenario import Scenario

#: Draws a scenario of a kind.
Draw: TypeAlias = Callable[[Generator, str], Scenario]
#: s of a ramp over minutes, of one in a step, and of one before something else happens; s of long scenarios.
SLOW, STEP, EARLY = (200.0, 300.0), (0.0, 0.0), (10.0, 20.0)
SLOW_SECONDS, TWO_SECONDS = 420.0, 220.0


def after(*happens: Callable[[Generator, Scenario], Scenario], seconds: float = 180.0) -> Draw:
    """Return what draws a healthy scenario and lets things happen to it, one after the other."""

    def draw(generator: Generator, kind: str) -> Scenario:
        case = draw_case(generator, kind, seconds)
        for happen in happens:
            case = happen(generator, case)
        return case

    return draw


#: By kind, in the order of the table.
SCENARIOS: dict[str, Draw] = {
    "healthy": after(),
    "healthy, oil warms": after(with_warming),
    "healthy, speed changes": after(with_speeds),
    "healthy, standstills": after(with_standstills),
    "wear, ramp": after(wears),
    "wear, slow ramp": after(partial(wears, duration=SLOW), seconds=SLOW_SECONDS),
    "wear, step": after(partial(wears, duration=STEP)),
    "wear, oil warms": after(with_warming, wears),
    "wear, speed changes": after(with_speeds, wears),
    "contamination": after(rubs),
    "contamination, slow ramp": after(partial(rubs, duration=SLOW), seconds=SLOW_SECONDS),
    "contamination, oil warms": after(with_warming, rubs),
    "contamination, standstills": after(with_standstills, rubs, seen_after_standstill),
    "oil viscosity, unexplained": after(thickens),
    "spring change": after(tires),
    "spring change, speed changes": after(with_speeds, tires),
    "resonance near 15 Hz": partial(passes, spring=0),
    "resonance near 29 Hz": partial(passes, spring=1),
    "stuck spool": after(sticks),
    "sensor dead": dead,
    "sensor clipping": clipping,
    "sensor offset": offset,
    "sensors swapped": after(exchanged),
    "sensor mis-scaled": scale,
    "data gaps": after(loses_data),
    "wear, then sensor dead": after(partial(wears, duration=EARLY), dies, seconds=TWO_SECONDS),
    "contamination, then stuck": after(partial(rubs, duration=EARLY), sticks_for_good, seconds=TWO_SECONDS),
    "wear and spring change": after(wears, tires),
    "wear and resonance, oil warms": passes_and_wears,
}


def draw_scenario(kind: str, generator: Generator) -> Scenario:
    """Return a scenario of ``kind``."""
    return SCENARIOS[kind](generator, kind)


def draw_cases(count: int, seed: int) -> list[Scenario]:
    """Return ``count`` scenarios, every kind in turn; each depends on ``seed`` and its own number alone."""
    kinds = list(SCENARIOS)
    return [
        draw_scenario(kinds[number % len(kinds)], np.random.default_rng([seed, number]))
        for number in range(count)
    ]


def draw_hours(count: int, seed: int) -> list[Scenario]:
    """Return ``count`` healthy hours."""
    return [healthy_hour(np.random.default_rng([seed, 7, number])) for number in range(count)]
