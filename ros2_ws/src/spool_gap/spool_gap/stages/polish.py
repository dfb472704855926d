"""Last digits of what was selected."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.selection.context import Context
from spool_gap.selection.state import State


def polish(_context: Context, state: State) -> State:
    """Fit of what was selected with the weight of what it leaves."""
    step = state.hypothesis
    if not step.effects:
        return state
    fitting = state.fitting.weighed_by(step)
    step = fitting.scored(step)
    step = min(step, fitting.polished(step), key=lambda entry: entry.cost)
    return replace(state, fitting=fitting, accepted=step, steps=(*state.steps[:-1], step))
