"""Fits of the base, and of what was selected in the end."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.selection.context import Context
from spool_gap.selection.joint_fit import fitted_base
from spool_gap.selection.state import SelectionState


def fit_base(context: Context, state: SelectionState) -> SelectionState:
    """Fit of the base, which is the first step: once more counting bad windows robustly."""
    context.progress("fitting the base", 0.15)
    fitting, step = fitted_base(state.fitting, context.regressed, context.start)
    fitting = fitting.weighed_by(step)
    step = fitting.fit((), [step.point], rounds=6)
    fitting = fitting.over(fitting.simulation.weighed_by_channels())
    fitting, base = fitted_base(fitting, context.regressed, step.point, rounds=6)
    judging = state.judging.counting_robustly()
    return replace(state, fitting=fitting, judging=judging, accepted=base, steps=(step,))


def polish(_context: Context, state: SelectionState) -> SelectionState:
    """Fit of what was selected with the weight of what it leaves."""
    step = state.hypothesis
    if not step.effects:
        return state
    fitting = state.fitting.weighed_by(step)
    step = fitting.scored(step)
    step = min(step, fitting.polished(step), key=lambda entry: entry.cost)
    return replace(state, fitting=fitting, accepted=step, steps=(*state.steps[:-1], step))
