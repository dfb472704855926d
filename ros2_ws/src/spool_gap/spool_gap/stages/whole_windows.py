"""Whole windows: free runs over them fit and judge what was selected in the end.

A free run holds more of slow effects than pieces do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.fitting.synchronised import DAMPING_RATIO, following
from spool_gap.registry import EFFECTS
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import needless
from spool_gap.selection.sense import trifling, vanished
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.noise_floor import noise_floor
from spool_gap.simulation.simulate import Simulation
from spool_gap.thresholds import THRESHOLDS

#: Why an effect leaves that helps jointly with others, but by next to nothing.
TRIFLE = "there is so little of it that it means nothing on a machine"


def measure_whole_windows(context: Context, state: SelectionState) -> SelectionState:
    """Free runs over whole windows in place of pieces, by which every step is measured."""
    final = state.hypothesis
    simulation = _free_runs(context, state, final)
    if final.has_jumps:
        simulation = simulation.sampled_for(final.point)
    state = state.over(state.fitting.over(simulation))
    return replace(state, fitting=state.fitting.weighed_by(state.hypothesis)) if final.effects else state


def _free_runs(context: Context, state: SelectionState, final: Hypothesis) -> Simulation:
    """Return the free runs that ``final`` is judged by, over whole windows."""
    if not state.synchronised:
        return state.judging
    return following(state.fitting, context.whole, final.point, DAMPING_RATIO).counting_robustly()


def fit_whole_windows(_context: Context, state: SelectionState) -> SelectionState:
    """Last digits by whole windows."""
    final, fitting = state.hypothesis, state.fitting
    if not is_fitted(state, final):
        return state
    final = fitting.scored(final)
    closer = fitting.fit(final.effects, [final.point], rounds=5)
    return with_final(state, min(final, closer, key=lambda entry: entry.cost))


def drop_insignificant(_context: Context, state: SelectionState) -> SelectionState:
    """Removal of what whole windows do not show, though pieces did, or of what means nothing."""
    step = state.hypothesis
    if not step.effects:
        return state
    gone, reason = _insignificant(state, step)
    if not gone:
        return state
    return drop_insignificant(_context, dropped(state, gone, reason))


def _insignificant(state: SelectionState, step: Hypothesis) -> tuple[list[str], str]:
    """Return which effects of ``step`` must go, and why."""
    known = [name for name in step.effects if name in EFFECTS]
    gone = [name for name in known if vanished(step, name)]
    if gone:
        return gone, "whole windows do not show it"
    gone = [name for name in known if trifling(state.fitting, step, name)] if len(step.effects) > 1 else []
    if gone:
        return gone, TRIFLE
    floor = noise_floor(state.fitting.simulation, step.point, step.held).nrmse
    if state.fitting.nrmse(step) < THRESHOLDS.closed * floor:  # runs that part from the motion show no effect
        gone = needless(state.fitting, step)
    return gone, "the model does as well without it"


def dropped(state: SelectionState, names: Sequence[str], reason: str) -> SelectionState:
    """Return ``state`` without the effects ``names``, fitted, and let the ranking say the ``reason``."""
    ranking = tuple(
        replace(row, accepted=False, reason=reason) if row.id in names and row.accepted else row
        for row in state.ranking
    )
    return with_final(replace(state, ranking=ranking), state.fitting.without(state.hypothesis, names))


def measure_ranking(_context: Context, state: SelectionState) -> SelectionState:
    """Errors of the ranking by free runs over whole windows."""
    fitting = state.fitting

    def error(key: tuple[str, tuple[str, ...]]) -> float:
        return fitting.nrmse(fitting.measured(state.tried[key]))

    ranking = tuple(
        replace(row, nrmse_after=error(row.key)) if row.key in state.tried else row for row in state.ranking
    )
    return replace(state, ranking=ranking)


def is_fitted(state: SelectionState, final: Hypothesis) -> bool:
    """Whether the numbers of ``final`` are those that its effects are fitted with."""
    own = {free.name for free in final.fitted.free}
    wanted = {free.name for free in state.fitting.free_of(final.effects, final.point)}
    return bool(final.effects) and own <= wanted


def with_final(state: SelectionState, final: Hypothesis) -> SelectionState:
    """Return ``state`` with ``final`` as its last step, the only one where it has no effects."""
    steps = (*state.steps[:-1], final) if final.effects else (final,)
    return replace(state, accepted=final, steps=steps)
