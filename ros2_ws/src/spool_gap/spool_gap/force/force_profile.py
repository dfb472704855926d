"""Profile likelihood of the numbers that a balance of forces names.

Forces in proportion to their numbers have a parabola, since the balance is linear in them; numbers that shape
a law, as its velocity scale, are held and all others fitted anew.
"""

from __future__ import annotations

import math

from spool_gap.effect import Effect
from spool_gap.profile_likelihood import ProfileLikelihood, verdict_of
from spool_gap.result import NamedEffect

from .force_balance import ForceBalance, ForceFit, independent_samples
from .force_result import Chosen

#: Standard deviations of a linear number, and factors on one that shapes a law, at which they are held.
DEVIATIONS = (-4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0)
FACTORS = (0.1, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.25, 1.6, 3.0, 10.0)


def force_profiles(
    balance: ForceBalance, chosen: Chosen, fit: ForceFit, effects: tuple[NamedEffect, ...]
) -> tuple[ProfileLikelihood, ...]:
    """Return the profiles of the numbers of ``effects``, the ``chosen`` ones of ``fit``."""
    found = []
    for entry, shape in chosen:
        named = next((effect for effect in effects if effect.id == entry.id), None)
        for quantity in named.parameters if named else ():
            value, deviation = quantity.value, quantity.standard_deviation
            if quantity.name in shape:
                values, rises = _shaped(balance, chosen, fit, entry, quantity.name)
            else:
                steps = [step for step in DEVIATIONS if _possible(entry, value, value + step * deviation)]
                values, rises = tuple(value + step * deviation for step in steps), tuple(s**2 for s in steps)
            found.append(verdict_of(quantity.name, quantity.unit, values, rises, value))
    return tuple(found)


def _possible(entry: Effect, value: float, other: float) -> bool:
    """Whether the law of ``entry`` exists with ``other`` for ``value``: friction below zero does not."""
    return entry.load_cell_zero or value * other > 0.0 or not entry.terms


def _shaped(
    balance: ForceBalance, chosen: Chosen, fit: ForceFit, entry: Effect, name: str
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    independent = sum(independent_samples(row) for row in fit.train)
    own = next(shape for other, shape in chosen if other.id == entry.id)
    values, rises = [], []
    for factor in FACTORS:
        held = {**own, name: own[name] * factor}
        tried = balance.fit([(e, held if e.id == entry.id else shape) for e, shape in chosen])
        values.append(held[name])
        rises.append(independent * math.log(max(tried.squares, 1e-300) / max(fit.squares, 1e-300)))
    return tuple(values), tuple(rises)
