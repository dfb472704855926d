"""Screening: which effects are worth simulating in this round."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.screening.screening import regression_candidates, residual_candidates
from spool_gap.selection.context import Context
from spool_gap.selection.state import State


def screen_by_regression(context: Context, state: State) -> State:
    """Regression of the balance of forces: effects near the best one, or confusable with it."""
    found = regression_candidates(context.regressed, state.catalogue, state.hypothesis)
    return replace(state, screened=tuple(found))


def screen_residual(context: Context, state: State) -> State:
    """Residual of the free run: effects that explain most of it, where the regression is blunt."""
    found = residual_candidates(
        state.fitting.simulation, context.regressed, state.catalogue, state.hypothesis, state.screened
    )
    return replace(state, screened=(*state.screened, *found))
