"""Pairwise comparison by synchronised runs: the best by free runs against confusable effects.

With play, preload or stops the motion can go several ways. Free runs of the right numbers then take another
way than the measured motion, so those of a smooth effect that acts alike may leave less.
"""

from __future__ import annotations

from dataclasses import replace

from spool_gap.fitting.hypothesis import BASE_NUMBERS, Fitting, Hypothesis
from spool_gap.fitting.synchronised import DAMPING_RATIO, synchronised_simulation
from spool_gap.registry import EFFECTS
from spool_gap.selection.completeness import is_closed
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import bic_penalty, evidence_of
from spool_gap.selection.joint_fit import synchronised_point
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.point import Point
from spool_gap.thresholds import THRESHOLDS

from .candidates import follows


def compare_pairwise(context: Context, state: SelectionState) -> SelectionState:
    """Pairwise comparison of the choice, if it leaves a gap, with each confusable effect.

    Without a choice effects challenge what is accepted: the motion may go several ways with any of them, with
    the first as with a spring that stiffens, so that free runs show no gain.
    """
    if not state.candidates or not follows(state):
        return state
    ahead = state.chosen or state.hypothesis
    closed, state = is_closed(state, ahead)
    if closed:
        return state
    best = _winner(context, state, ahead)
    if best is ahead:
        return state
    margin = evidence_of(state.fitting, state.hypothesis, ahead) + THRESHOLDS.evidence
    return replace(state, chosen=best, margin=margin, decided=True)


def _winner(context: Context, state: SelectionState, ahead: Hypothesis) -> Hypothesis:
    """Return ``ahead``, or the candidate that acts alike and leaves less by synchronised runs."""
    fitting, step = state.fitting, state.hypothesis
    alone = state.chosen is None
    best: Hypothesis = ahead
    fitted: Point | None = None
    for number, entry in enumerate(state.candidates):
        other = entry.hypothesis
        effect = EFFECTS[other.newest]
        several = effect.local_minima or effect.localised or (alone and number == 0 and effect.terms)
        if other is ahead or not several:
            continue
        if alone and step.effects and evidence_of(fitting, step, other) < 0.0:
            continue
        if best is step or _confusable(best.newest, other.newest):
            fitted = fitted or synchronised_point(context, fitting, best)
            rival = synchronised_point(context, fitting, other)
            if _wins(context, fitting, best, fitted, other, rival):
                best, fitted = fitting.measured(other.at(rival)), rival
                if fitting.nrmse(best) < THRESHOLDS.at_noise_floor * state.noise_floor:
                    break
    return best


def _confusable(name: str, rival: str) -> bool:
    return rival in EFFECTS[name].confusable_with or name in EFFECTS[rival].confusable_with


def _wins(
    context: Context, fitting: Fitting, one: Hypothesis, fitted: Point, other: Hypothesis, rival: Point
) -> bool:
    """Whether ``other`` at ``rival`` leaves less than ``one`` at ``fitted``, with the weight of either."""
    effect = EFFECTS[other.newest]
    if effect.sensible({name: rival.get(name) for name in (*BASE_NUMBERS, *effect.fitted)}, {}):
        return False
    simulation = synchronised_simulation(fitting, context.whole, DAMPING_RATIO, fitting.settings.longest)
    simulation = simulation.counting_robustly()
    held, training = simulation.held_out, simulation.training
    errors = [simulation.errors([point], held) for point in (fitted, rival)]
    before, after = (float(simulation.nrmse(rows, held)[0]) ** 2 for rows in errors)
    if after < THRESHOLDS.decisive * before:
        return True
    numbers = len(other.fitted.free) - len(one.fitted.free)
    for host in (fitted, rival):
        weighed = simulation.weighed_by(simulation.errors([host], training))
        cost, less = (float(weighed.cost(weighed.weigh(rows, held), held)[0]) for rows in errors)
        if cost - less - bic_penalty(fitting) * numbers < max(THRESHOLDS.evidence, THRESHOLDS.clearly * cost):
            return False
    return True
