"""Similar laws: each gets the chance that the best one of them has."""

from __future__ import annotations

from dataclasses import replace

from spool_estimator.identification.least_squares import in_parallel

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import beats_simpler, evidence_of
from spool_gap.selection.friction_laws import equivalent_starts, is_sliding
from spool_gap.selection.sense import refusal, senseless
from spool_gap.selection.state import SelectionState
from spool_gap.thresholds import THRESHOLDS

#: Starts that are followed.
FOLLOWED = 3
#: Rounds of a first fit, and the fall of the sum of squares that ends it.
ROUNDS, ENOUGH = 3, 5e-3


def start_from_contained(_context: Context, state: SelectionState) -> SelectionState:
    """Second fit of what fits worse than an effect that it contains, from there."""
    fitting = state.fitting
    by_name = {entry.newest: entry for entry in state.fits}

    def from_inner(entry: Hypothesis) -> Hypothesis:
        best, effect = entry, EFFECTS[entry.newest]
        for name in effect.replaces:
            inner = by_name.get(name)
            if inner is None or inner.cost >= best.cost:
                continue
            effects = (*inner.effects[:-1], entry.newest)
            values = {
                **inner.point.values, **entry.own_values, **effect.acting_like(inner.point.values)
            }  # fmt: skip
            point = replace(inner.point, values=values, active=fitting.terms_of(effects))
            again = fitting.fit(effects, [point], rounds=ROUNDS, enough=ENOUGH, trials=entry.trials)
            best = min(best, again, key=lambda one: one.cost)
        return best

    return replace(state, fits=tuple(in_parallel(from_inner, state.fits)))


def start_from_best_law(context: Context, state: SelectionState) -> SelectionState:
    """Second fit of sliding laws near the best one, from where they act like that."""
    fitting = state.fitting
    laws = {entry.newest: entry for entry in state.fits if is_sliding(entry.newest)}
    if len(laws) < 2:
        return state
    best = min(laws.values(), key=lambda entry: entry.cost)

    def from_best(entry: Hypothesis) -> Hypothesis:
        name = entry.newest
        # A gain or a delay that one law has let free, and the other not, parts the best of laws.
        freed = best.effects[:-1] != entry.effects[:-1]
        near = entry.cost <= THRESHOLDS.equivalent_cost * best.cost
        near = near and name not in EFFECTS[best.newest].replaces
        if name not in laws or entry is best or not (freed or near):
            return entry
        starts = equivalent_starts(context, fitting, best, best.newest, name, entry.own_values)
        effects = (*best.effects[:-1], name)
        again = fitting.fit(effects, starts, rounds=ROUNDS, enough=ENOUGH, trials=entry.trials)
        return min(entry, again, key=lambda one: one.cost)

    return replace(state, fits=tuple(in_parallel(from_best, state.fits)))


def take_closest_law(context: Context, state: SelectionState) -> SelectionState:
    """Choice of the best of sliding laws close to each other, fitted to their last digits."""
    fitting, winner = state.fitting, state.chosen
    if winner is None or not is_sliding(winner.newest):
        return state
    name = winner.newest

    def close(entry: Hypothesis) -> bool:
        other = entry.newest
        rival = is_sliding(other) and other not in EFFECTS[name].replaces
        return rival and entry.cost < THRESHOLDS.equivalent_cost * winner.cost

    def closer(entry: Hypothesis) -> Hypothesis:
        starts = [
            entry.point,
            *equivalent_starts(context, fitting, winner, name, entry.newest, entry.own_values),
        ]
        effects = (*winner.effects[:-1], entry.newest)
        found = fitting.fit(effects, starts, rounds=5, tries=FOLLOWED, trials=entry.trials)
        return fitting.polished(found)

    others = [entry.hypothesis for entry in state.candidates if not entry.reason][1:]
    rivals = in_parallel(closer, filter(close, others))
    # Down to the last digits a law may leave what makes sense, as a force at rest below that at speed.
    known = [entry for entry in (winner, *rivals) if not senseless(entry, entry.newest)]
    best = max(known or [winner], key=lambda entry: evidence_of(fitting, state.hypothesis, entry))
    return replace(state, chosen=best)


def take_simplest_law(context: Context, state: SelectionState) -> SelectionState:
    """Choice of the simplest of laws that contain each other which none of the others clearly beats."""
    fitting, winner = state.fitting, state.chosen
    if winner is None:
        return state
    replaced = EFFECTS[winner.newest].replaces

    def fitted_on(own: Hypothesis) -> Hypothesis:
        if own.newest not in replaced or not is_sliding(winner.newest):
            return fitting.polished(own)
        # Where the spool sticks the sum of squares is rough: the simpler law may have ended in a dent.
        starts = equivalent_starts(context, fitting, winner, winner.newest, own.newest, own.own_values)
        effects = (*winner.effects[:-1], own.newest)
        starts = [own.point, *starts]
        return fitting.fit(effects, starts, rounds=7, tries=len(starts), trials=own.trials)

    hopeful = [
        own
        for own in (entry.hypothesis for entry in state.candidates)
        if own.newest in replaced
        or (
            winner.newest in EFFECTS[own.newest].replaces and own.cost < THRESHOLDS.hopeful_cost * winner.cost
        )
    ]
    step = state.hypothesis
    family = [
        winner,
        *(
            own
            for own in in_parallel(fitted_on, hopeful)
            if not refusal(fitting, step, own, step.cost - own.cost, state.noise_floor)
        ),
    ]
    family.sort(key=lambda entry: len(entry.fitted.free))
    best = family[0]
    for entry in family[1:]:
        same = len(entry.fitted.free) == len(best.fitted.free)
        if entry.cost < best.cost if same else beats_simpler(fitting, best, entry):
            best = entry
    return replace(state, chosen=best)
