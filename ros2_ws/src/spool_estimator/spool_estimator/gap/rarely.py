"""Effects that act in few stretches: looked for where the usual window is explained, and some are not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .coupled import coupled_start
from .fitting import Step
from .left_over import screen_left_over
from .result import Hypothesis
from .rules import CLOSED
from .screening import LEFT, balance_of

if TYPE_CHECKING:
    from .search import Search

#: Share of the power left without a rare effect that one with may leave, for which no bad window is spared.
HALVED = 0.5
#: Starts that are followed.
FOLLOWED = 4


def by_power(search: Search, without: Step, step: Step) -> float:
    """Return the evidence for ``step`` by the power that both leave in windows that are bad with either.

    0 where ``step`` leaves more than ``HALVED`` of the power: few windows with hits, each counted by a
    logarithm, weigh less than one that is grazed too early.
    """
    if search.nrmse(step) ** 2 >= HALVED * search.nrmse(without) ** 2:
        return 0.0
    simulation, held = search.simulation, search.simulation.held_out
    edges, usual = simulation.parts(held)
    before, after = (
        np.add.reduceat(simulation.weigh(entry.held, held)[0] ** 2, edges[:-1]) for entry in (without, step)
    )
    bad = np.maximum(before, after) > usual
    numbers = len(step.fitted.free) - len(without.fitted.free)
    gain = math.log(float(before[bad].sum()) / float(after[bad].sum())) if bad.any() else 0.0
    return float(np.diff(edges)[bad].sum()) * gain - search.price * numbers


def rare_effect(search: Search, step: Step) -> Step | None:
    """Return ``step``, which explains the usual window, with a rare effect that explains others as well."""
    if search.nrmse(step) < CLOSED * search.floor:
        return None
    rare = [entry for entry in search.catalogue if entry.rare and entry.id not in step.effects]
    motion = balance_of(search.regressed, step.fitted.point.values).joined(())
    for found in screen_left_over(search.simulation, step, rare, motion, LEFT):
        entry, effects = found.effect, (*step.effects, found.effect.id)
        point = replace(step.fitted.point, active=search.terms_of(effects))
        starts = [
            replace(point, values={**point.values, **values})
            for values in entry.starts(found.values, search.reach)
        ]
        coupled = coupled_start(search, search.whole, effects, starts)
        more = search.polished(search.fit(effects, [coupled] if coupled else starts, tries=FOLLOWED))
        more.trials = {**step.trials, entry.id: found.trial}
        evidence = max(search.evidence(step, more), by_power(search, step, more))
        reason = search.refusal(step, more, evidence)
        values = {name: more.fitted.point.get(name) for name in entry.fitted}
        search.tried[entry.id, step.effects] = more
        search.ranking.append(
            Hypothesis(entry.id, step.effects, search.nrmse(more), evidence, values, not reason, reason)
        )
        if not reason:
            return more
    return None
