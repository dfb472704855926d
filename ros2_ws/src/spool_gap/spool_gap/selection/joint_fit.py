"""The fit of an effect beside what is accepted: from which places, and with which sensors let free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spool_gap.effect import Effect
from spool_gap.fitting.hypothesis import BASE_NUMBERS, DELAY, GAIN, Step, parameters_of
from spool_gap.fitting.synchronised import coupled_start
from spool_gap.registry import EFFECTS
from spool_gap.screening.regression import Screened
from spool_gap.screening.screening import FRICTIONS
from spool_gap.simulation.point import Point

from .rules import EVIDENCE

if TYPE_CHECKING:
    from .search import Search

Array = NDArray[np.float64]

#: Share of what the regression says of an effect from which its fit beside others starts, too: with so little
#: of it no base is far off.
HINT = 0.01
#: Rounds of a first fit, and the fall of the sum of squares that ends it: what is far behind is soon seen.
ROUNDS, ENOUGH = 3, 5e-3
#: Starts from which on several are followed.
MANY, FOLLOWED = 6, 3


def tried_beside(search: Search, step: Step, entry: Screened) -> Step:
    """Return ``step`` with the effect of ``entry``, fitted for a first comparison."""
    effects = _with(step.effects, entry.effect)
    known = replace(step.fitted.point, active=search.terms_of(effects))
    joint = known.moved(BASE_NUMBERS, joint_numbers(entry.base, known))
    nominal = joint.moved(("spring_stiffness", GAIN, DELAY), (search.valve.spring_stiffness, 0.0, 0.0))
    starts = []
    for values in entry.effect.starts(entry.values, search.reach):
        own = _bounded(entry.effect, values)
        starts += [replace(point, values={**point.values, **own}) for point in (joint, known, nominal)]
    tries = FOLLOWED if len(starts) > MANY else 1
    hint = {name: HINT * starts[1].values[name] for name in entry.effect.amplitudes}
    if step.effects and hint:
        starts.append(replace(starts[1], values={**starts[1].values, **hint}))
    found = search.fit(effects, starts, rounds=ROUNDS, tries=tries, enough=ENOUGH)
    if search.coupled is None and any(EFFECTS[name].valleys for name in effects):
        start = coupled_start(search, search.whole, effects, starts[2::3])
        if start:
            found = min(found, search.fit(effects, [start], rounds=ROUNDS), key=lambda one: one.cost)
    found = _widened(search, found)
    found.trials = {**{e: t for e, t in step.trials.items() if e in effects}, entry.effect.id: entry.trial}
    return found


def joint_numbers(base: Array, point: Point) -> list[float]:
    """Return the base's numbers by the regression, as ``BASE_NUMBERS``, kept to what is physical.

    Args:
        base: of the regression: stiffness, damping, gain error, delay, SI; shape (4,).
        point: where the spring and the damping have been found so far.
    """
    stiffness, damping, gain, delay = base.tolist()
    known = [point.get(name) for name in BASE_NUMBERS]
    return [
        float(np.clip(stiffness, 0.5 * known[0], 2.0 * known[0])),
        max(damping, 0.02 * known[1]),
        gain,
        delay,
    ]


def _with(effects: Sequence[str], entry: Effect) -> tuple[str, ...]:
    """Return ``effects`` with ``entry``, which takes the place of what it contains or excludes."""
    gone = {*entry.replaces, *(FRICTIONS if entry.id in FRICTIONS else ())}
    return (*(name for name in effects if name not in gone), entry.id)


def _bounded(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Return ``values`` of the parameters of ``effect``, each within its bounds."""
    parameters = {p.name: p for name in effect.terms for p in parameters_of(name)}
    return {
        name: float(np.clip(value, parameters[name].low, parameters[name].high))
        for name, value in values.items()
    }


def _widened(search: Search, step: Step) -> Step:
    """Return ``step`` with gain or delay let free beyond its tolerance, where it pushes against that."""
    for name in (GAIN, DELAY):
        if name not in step.fitted.at_bound or name in step.effects:
            continue
        effects = (*step.effects[:-1], name, step.effects[-1])
        wider = search.fit(effects, [step.fitted.point], rounds=ROUNDS, enough=ENOUGH)
        value, spread = wider.fitted.point.get(name), wider.fitted.deviations[name]
        beyond = abs(value) > search.tolerance(name) + 3.0 * spread
        if beyond and wider.cost < step.cost - EVIDENCE:
            step = wider
    return step
