"""Selection of effects: its stages in their order."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.selection.context import Context
from spool_gap.selection.state import SelectionState, Stage, run_stages

from .fits import fit_base, polish
from .growth import grow
from .sliding_laws import compare_sliding_laws
from .small_effects import find_small_effect
from .two_directions import split_by_direction
from .whole_windows import (
    drop_insignificant,
    fit_whole_windows,
    measure_ranking,
    measure_whole_windows,
)

#: Stages that name effects over short pieces of the records.
SELECTION: tuple[Stage, ...] = (
    fit_base,
    grow,
    polish,
    split_by_direction,
    find_small_effect,
)
#: Stages that fit and judge what was named by free runs over whole windows.
FINAL: tuple[Stage, ...] = (
    measure_whole_windows,
    fit_whole_windows,
    compare_sliding_laws,
    drop_insignificant,
    measure_ranking,
)


def select(context: Context, state: SelectionState) -> SelectionState:
    """Selection over pieces: what is accepted is the last step, the base where no effect is."""
    state = run_stages(SELECTION, context, state)
    return replace(state, accepted=state.steps[-1])


def judge(context: Context, state: SelectionState) -> SelectionState:
    """Judging of what was selected by free runs over whole windows."""
    return run_stages(FINAL, context, state)
