"""Every law of dry friction in place of the one that was found first, beside other effects.

Alone, a law takes what belongs to another effect; beside that one, another law may fit better.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from spool_identification.least_squares.parallel import in_parallel

from spool_gap.fitting.equivalent_start import slides
from spool_gap.fitting.hypothesis import Step, parameters_of
from spool_gap.registry import EFFECTS
from spool_gap.screening.screening import FRICTIONS

from .confusable import NEAR
from .rules import CLEARLY

#: Cost over that of the present law up to which another one that makes no sense yet is fitted on.
HARDLY = 1.05

if TYPE_CHECKING:
    from .search import Search


def swapped(search: Search, step: Step) -> Step:
    """Return ``step`` with another law of friction where that does better beside its other effects."""
    present = next((name for name in step.effects if name in FRICTIONS and name in EFFECTS), None)
    if present is None or len(step.effects) < 2:
        return step

    def in_place(name: str) -> Step | None:
        other = with_law(search, step, present, name)
        if other is None:
            return None
        most = HARDLY if search.senseless(other, name) else NEAR
        return search.polished(other) if other.cost < most * step.cost else other

    best = step
    names = sorted(FRICTIONS - {present})
    for name, other in zip(names, in_parallel(in_place, names), strict=True):
        if other is None:
            continue
        law = next(entry for entry in best.effects if entry in FRICTIONS)
        if name in EFFECTS[law].replaces:
            better = not search.beats_simpler(other, best)
        elif law in EFFECTS[name].replaces:
            better = search.beats_simpler(best, other)
        else:
            numbers = len(other.fitted.free) - len(best.fitted.free)
            clear = CLEARLY * best.cost if numbers > 0 else 0.0
            better = best.cost - other.cost - search.price * numbers > clear
        if better and not search.senseless(other, name):
            best = other
    if best is not step:
        search.overruled[present] = abs(step.cost - best.cost)
        if slides(best.effects[step.effects.index(present)]) and not slides(present):
            return swapped(search, best)
    return best


def with_law(
    search: Search, step: Step, present: str, name: str, *, tries: int = 2, rounds: int = 6
) -> Step | None:
    """Return ``step`` with the law of friction ``name`` in place of ``present``, fitted."""
    effects = tuple(name if entry == present else entry for entry in step.effects)
    own = {parameter.name: parameter.start for parameter in parameters_of(name)}
    known = [found for (law, _), found in search.tried.items() if law == name]
    starts = []
    for found in known:
        own = search.own_of(found)
        values = {**step.fitted.point.values, **own}
        starts.append(replace(step.fitted.point, values=values, active=search.terms_of(effects)))
    if name in [entry.id for entry in search.catalogue]:
        starts += search.acting_like(step, present, name, own)
    if not starts:
        return None
    other = search.fit(effects, starts, tries=tries, rounds=rounds)
    trials = {**step.trials, **(known[-1].trials if known else {})}
    other.trials = {entry: trial for entry, trial in trials.items() if entry in effects}
    return other
