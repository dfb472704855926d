"""Laws of dry friction that do not contain each other, told apart by all windows.

Mixed and Stribeck friction are alike over most speeds: held-out windows alone decide by chance. Neither is
the richer one, so that the likelihood over all windows counts, at a price for each number (Schwarz).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from spool_identification.least_squares.parallel import in_parallel

from spool_gap.fitting.equivalent_start import slides
from spool_gap.fitting.hypothesis import Step
from spool_gap.registry import EFFECTS
from spool_gap.screening.screening import FRICTIONS

from .other_laws import with_law
from .rules import FEWEST, in_windows
from .small_effects import AllWindows

Array = NDArray[np.float64]

#: Starts that are followed, and for how long: fits of these laws end in several valleys.
FOLLOWED, ROUNDS = 4, 3
#: Cost over that of the other law from which a law is given up after those, and where it is so in nearly all
#: held-out windows.
FAR, APART = 1.3, 1.1
#: Share of the windows, on either end of what they say, that do not count: with play, preload or stops a run
#: may go another way in one of them, which would outweigh all others.
EXTREME = 0.1

if TYPE_CHECKING:
    from .search import Search


def told_by_all_windows(search: Search, step: Step) -> Step:
    """Return ``step`` with the sliding law that all windows show, in place of one that they show less."""
    best = step
    for present in filter(_falls_with_speed, step.effects):
        for name in _others(search, present):
            other = with_law(search, step, present, name, tries=FOLLOWED, rounds=ROUNDS)
            if other is None or too_far(step.costs, other.costs):
                continue
            other, margin = _compared(search, step, other)
            if search.senseless(other, name):
                continue
            if search.senseless(step, present):
                margin = abs(margin)
            search.overruled[present if margin > 0.0 else name] = abs(margin)
            if margin > 0.0:
                _overrule(search, present, name)
                # All windows named it; its numbers come from those that are fitted, the others judge.
                best = search.polished(search.measured(other))
    return best


def _falls_with_speed(name: str) -> bool:
    """Whether ``name`` is a law of sliding friction with speeds in it."""
    return name in EFFECTS and name in FRICTIONS and slides(name) and any(EFFECTS[name].speeds_to_try(1.0))


def _others(search: Search, present: str) -> list[str]:
    """Return the laws like ``present`` that neither contain it nor are contained in it."""
    names = sorted(entry.id for entry in search.catalogue if entry.id != present)
    return [
        name
        for name in filter(_falls_with_speed, names)
        if name not in EFFECTS[present].replaces and present not in EFFECTS[name].replaces
    ]


def _compared(search: Search, one: Step, other: Step) -> tuple[Step, float]:
    """Return ``other`` fitted to all windows, and its evidence over ``one`` in all but extreme ones."""
    kept = search.simulation, search.stretches
    everything = AllWindows.of(search.simulation)
    search.simulation, search.stretches = everything, everything.stretches
    try:
        everything.choose_sampling(one.fitted.point)
        both = [replace(step, fitted=replace(step.fitted, settled=None)) for step in (one, other)]
        one, other = in_parallel(lambda step: search.polished(search.measured(step)), both)
        numbers = len(other.fitted.free) - len(one.fitted.free)
        return other, usual_sum(one.costs - other.costs) - search.price * numbers
    finally:
        search.simulation, search.stretches = kept


def usual_sum(gains: Array) -> float:
    """Return the sum of ``gains``, one a window, shape (w,), were its extremes like the others."""
    return gains.size * float(stats.trim_mean(gains, EXTREME))


def too_far(costs: Array, rival: Array) -> bool:
    """Whether a law is too far behind another one on held-out windows to catch up.

    Args:
        costs: weighed sum of squares of the law that is ahead, one a window, shape (w,).
        rival: of the other, which is hardly fitted yet.
    """
    behind = float(rival.sum() / costs.sum())
    if APART < behind <= FAR:
        return costs.size >= FEWEST and in_windows(rival - costs, behind - 1.0)
    return behind > FAR


def _overrule(search: Search, present: str, name: str) -> None:
    """Let the ranking say that ``name`` was taken in place of ``present``."""
    for number, row in enumerate(search.ranking):
        if row.id == present and row.accepted:
            reason = f"{name.replace('_', ' ')} fits all windows better"
            search.ranking[number] = replace(row, accepted=False, reason=reason)
            for place, rival in enumerate(search.ranking):
                if (rival.id, rival.beside) == (name, row.beside):
                    search.ranking[place] = replace(rival, accepted=True, reason="")
