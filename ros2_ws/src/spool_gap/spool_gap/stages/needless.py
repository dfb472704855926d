"""Needless effects leave."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.selection.context import Context
from spool_gap.selection.evidence import without_needless
from spool_gap.selection.state import State


def drop_needless(_context: Context, state: State) -> State:
    """Removal of an effect that is no longer needed jointly with the newest."""
    return replace(state, accepted=without_needless(state.fitting, state.hypothesis))
