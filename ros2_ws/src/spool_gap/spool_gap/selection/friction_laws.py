"""Friction laws that act alike: fits of one from where another stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from spool_gap.fitting.equivalent_start import acting_alike, slides
from spool_gap.fitting.hypothesis import Fitting, Hypothesis, parameters_of
from spool_gap.registry import EFFECTS, FRICTIONS
from spool_gap.simulation.point import Point

from .context import Context
from .state import SelectionState


def is_sliding(name: str) -> bool:
    """Whether the effect ``name`` is dry friction that depends on speed alone."""
    return name in EFFECTS and name in FRICTIONS and slides(name)


def equivalent_starts(
    context: Context, fitting: Fitting, like: Hypothesis, law: str, name: str, own: Mapping[str, float]
) -> list[Point]:
    """Return points of ``like`` at which ``name``, in place of its ``law``, acts most like that.

    None where one of both does not depend on speed alone; ``own`` are numbers of ``name`` to begin with.
    """
    if not (slides(law) and slides(name)):
        return []
    speed = np.concatenate([np.abs(stretch.motion.velocity) for stretch in context.whole])
    active = fitting.terms_of(tuple(name if entry == law else entry for entry in like.effects))
    found = []
    for speeds in EFFECTS[name].speeds_to_try(float(np.quantile(speed, 0.99))):
        start = replace(like.point, active=active, values={**like.point.values, **own, **speeds})
        free = [number for number in EFFECTS[name].fitted if number not in speeds]
        found.append(acting_alike(like.point, law, start, name, free, speed))
    return found


def with_law(
    context: Context,
    state: SelectionState,
    step: Hypothesis,
    present: str,
    name: str,
    *,
    tries: int = 2,
    rounds: int = 6,
) -> Hypothesis | None:
    """Return ``step`` with the law of friction ``name`` in place of ``present``, fitted."""
    fitting = state.fitting
    effects = tuple(name if entry == present else entry for entry in step.effects)
    own = {parameter.name: parameter.start for parameter in parameters_of(name)}
    known = [found for (law, _), found in state.tried.items() if law == name]
    starts = []
    for found in known:
        own = found.own_values
        values = {**step.point.values, **own}
        starts.append(replace(step.point, values=values, active=fitting.terms_of(effects)))
    if name in [entry.id for entry in state.catalogue]:
        starts += equivalent_starts(context, fitting, step, present, name, own)
    if not starts:
        return None
    trials = {**step.trials, **(known[-1].trials if known else {})}
    trials = {entry: trial for entry, trial in trials.items() if entry in effects}
    return fitting.fit(effects, starts, tries=tries, rounds=rounds, trials=trials)
