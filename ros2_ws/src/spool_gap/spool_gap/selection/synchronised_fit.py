"""Synchronised fit of a hypothesis, from wherever it may start."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.fitting.synchronised import synchronised_start
from spool_gap.registry import EFFECTS
from spool_gap.simulation.point import Point

from .context import Context
from .joint_fit import nominal_base


def synchronised_point(context: Context, fitting: Fitting, entry: Hypothesis) -> Point:
    """Return the numbers of ``entry`` as fitted by synchronised runs."""
    nominal = nominal_base(fitting, entry.point)
    own = EFFECTS[entry.newest].starts(entry.own_values, context.reach) if entry.effects else [{}]
    starts = [entry.point, *(replace(nominal, values={**nominal.values, **values}) for values in own)]
    return synchronised_start(fitting, context.whole, entry.effects, starts) or entry.point
