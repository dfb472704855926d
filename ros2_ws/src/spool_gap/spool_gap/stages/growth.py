"""Forward and backward selection, effect by effect, down to the noise floor."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.registry import EFFECTS
from spool_gap.result import Change
from spool_gap.selection.completeness import is_complete
from spool_gap.selection.context import Context
from spool_gap.selection.state import SelectionState, Stage, run_stages

from .acceptance import accept, require_lasting_gain, require_more_than_noise
from .candidates import (
    choose_candidate,
    fit_candidates,
    free_sensors,
    note_candidates,
    rank_candidates,
    screen_by_regression,
    screen_residual,
)
from .similar_laws import start_from_best_law, start_from_contained, take_closest_law, take_simplest_law
from .synchronise import synchronise

#: Stages that look for one further effect.
FORWARD: tuple[Stage, ...] = (
    screen_by_regression,
    screen_residual,
    fit_candidates,
    start_from_contained,
    start_from_best_law,
    free_sensors,
    rank_candidates,
    note_candidates,
    choose_candidate,
    take_closest_law,
    take_simplest_law,
    require_lasting_gain,
    require_more_than_noise,
    accept,
)
#: Stages that look back at the effects, once there is a further one.
BACKWARD: tuple[Stage, ...] = (synchronise,)


def grow(context: Context, state: SelectionState) -> SelectionState:
    """Forward and backward selection from what is accepted."""
    while len(state.hypothesis.effects) < state.fitting.settings.most_effects:
        if context.late:
            given_up = Change("grow", state.choice, state.choice, gave_up=True)
            return replace(state, trace=(*state.trace, given_up))
        known = " + ".join(state.hypothesis.effects) or "the base"
        context.progress(f"trying effects jointly with {known}", 0.25)
        state = run_stages(FORWARD, context, state.begun)
        if state.chosen is None:
            break
        state = run_stages(BACKWARD, context, replace(state, chosen=None))
        step = state.hypothesis
        if step.effects and EFFECTS[step.newest].nuisance:
            # What it did to the motion misleads every further step: the record is corrected first.
            return replace(state, steps=(*state.steps, step))
        if step.effects in [entry.effects for entry in state.steps]:
            break
        state = replace(state, steps=(*state.steps, step))
        complete, state = is_complete(state, step)
        if complete:
            break
    return state
