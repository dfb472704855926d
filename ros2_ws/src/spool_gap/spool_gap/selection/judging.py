"""The last step: what was found, fitted to and judged by free runs over whole windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from spool_gap.fitting.hypothesis import Step
from spool_gap.fitting.synchronised import DAMPING_RATIO, following
from spool_gap.registry import EFFECTS
from spool_gap.simulation.noise_floor import noise_floor
from spool_gap.simulation.simulate import Simulation

from .other_laws import swapped
from .rules import CLOSED
from .sliding_laws import told_by_all_windows

if TYPE_CHECKING:
    from .search import Search


#: Why an effect beside others leaves that helps, but by next to nothing.
TRIFLE = "there is so little of it that it means nothing on a machine"


def judged(search: Search, final: Step) -> Step:
    """Measure every step and the ranking by free runs over whole windows from now on.

    Returns:
        ``final``, its last digits fitted to those: a free run holds more of slow effects than pieces do.
    """
    search.simulation = _free_runs(search, final)
    search.stretches = search.simulation.stretches
    if search.has_jumps(final):
        search.simulation.choose_sampling(final.fitted.point)
    for step in search.steps:
        search.measured(step)
    if final.effects:
        search.take_weight(final)
        place = next(n for n, step in enumerate(search.steps) if step is final)
        final = _significant(search, _fitted(search, final))
        search.steps = [*search.steps[:place], final] if final.effects else [final]
    for number, row in enumerate(search.ranking):
        fitted = search.tried.get((row.id, row.beside))
        if fitted is not None:
            search.ranking[number] = replace(row, nrmse_after=search.nrmse(search.measured(fitted)))
    return final


def _fitted(search: Search, final: Step) -> Step:
    own = {free.name for free in final.fitted.free}
    if not own <= {free.name for free in search.free_of(final.effects, final.fitted.point)}:
        return final
    search.score(final)
    closer = search.fit(final.effects, [final.fitted.point], rounds=5)
    best = closer if closer.cost < final.cost else final
    # Free runs over whole windows tell laws of friction apart best.
    return told_by_all_windows(search, best if search.coupled is None else swapped(search, best))


def _free_runs(search: Search, final: Step) -> Simulation:
    """Return the free runs that ``final`` is judged by, over whole windows."""
    if search.coupled is None:
        return search.longer
    simulation = following(search, search.whole, final.fitted.point, DAMPING_RATIO)
    simulation.robust = True
    return simulation


def _significant(search: Search, step: Step) -> Step:
    """Return ``step`` without what whole windows do not show, though pieces did, or what means nothing."""
    known = [name for name in step.effects if name in EFFECTS]
    gone = [name for name in known if search.vanished(step, name)]
    reason = "whole windows do not show it"
    if not gone and len(step.effects) > 1:
        gone = [name for name in known if search.trifling(step, name)]
        reason = TRIFLE
    floor = noise_floor(search.simulation, step.fitted.point, step.held).nrmse
    if not gone and search.nrmse(step) < CLOSED * floor:  # runs that part from the motion tell no effect
        gone, reason = search.needless(step), "the model does as well without it"
    return _significant(search, dropped(search, step, gone, reason)) if gone else step


def dropped(search: Search, step: Step, names: Sequence[str], reason: str) -> Step:
    """Return ``step`` without the effects ``names``, fitted, and let the ranking say the ``reason``."""
    for number, row in enumerate(search.ranking):
        if row.id in names and row.accepted:
            search.ranking[number] = replace(row, accepted=False, reason=reason)
    return search.without(step, names)
