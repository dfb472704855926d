"""Joint fit of a further effect with what is accepted: from which places, and with which sensors let free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spool_gap.effect import Effect
from spool_gap.fitting.hypothesis import BASE_NUMBERS, Fitting, Hypothesis, parameters_of
from spool_gap.fitting.synchronised import synchronised_start
from spool_gap.registry import EFFECTS, FRICTIONS
from spool_gap.screening.regression import Screened
from spool_gap.screening.screening import balance_of
from spool_gap.simulation.point import DELAY, GAIN, Point
from spool_gap.simulation.segments import Stretch
from spool_gap.thresholds import THRESHOLDS

from .context import Context
from .sense import tolerance
from .state import SelectionState

Array = NDArray[np.float64]

#: Share of what the regression says of an effect from which its joint fit starts, too: with so little of it
#: no base is far off.
HINT = 0.01
#: Rounds of a first fit, and the fall of the sum of squares that ends it: what is far behind is soon seen.
ROUNDS, ENOUGH = 3, 5e-3
#: Starts from which on several are followed.
MANY, FOLLOWED = 6, 3


def fitted_base(
    fitting: Fitting, regressed: Sequence[Stretch], start: Point, rounds: int = 10
) -> tuple[Fitting, Hypothesis]:
    """Return the base fitted from ``start`` and the regression, and windows whose starts ring as it does."""
    values = start.values
    balance = balance_of(regressed, values)
    balance.prepare()
    numbers = joint_numbers(balance.coefficients()[:4], start)
    fitting = fitting.over(fitting.simulation.ringing_as(values["mass"], *numbers[:2]))
    step = fitting.fit((), [start, start.moved(BASE_NUMBERS, numbers)], rounds=rounds, tries=2)
    found = step.point.values
    simulation = fitting.simulation.ringing_as(
        found["mass"], found["spring_stiffness"], found["viscous_coefficient"]
    )
    return fitting.over(simulation), step


def jointly_fitted(context: Context, state: SelectionState, entry: Screened) -> Hypothesis:
    """Return the accepted hypothesis with the effect of ``entry``, fitted for a first comparison."""
    fitting, step = state.fitting, state.hypothesis
    effects = _with(step.effects, entry.effect)
    known = replace(step.point, active=fitting.terms_of(effects))
    joint = known.moved(BASE_NUMBERS, joint_numbers(entry.base, known))
    nominal = nominal_base(fitting, joint)
    starts = []
    for values in entry.effect.starts(entry.values, context.reach):
        own = _bounded(entry.effect, values)
        starts += [replace(point, values={**point.values, **own}) for point in (joint, known, nominal)]
    tries = FOLLOWED if len(starts) > MANY else 1
    hint = {name: HINT * starts[1].values[name] for name in entry.effect.amplitudes}
    if step.effects and hint:
        starts.append(replace(starts[1], values={**starts[1].values, **hint}))
    found = fitting.fit(effects, starts, rounds=ROUNDS, tries=tries, enough=ENOUGH)
    if not state.synchronised and any(EFFECTS[name].local_minima for name in effects):
        start = synchronised_start(fitting, context.whole, effects, starts[2::3])
        if start:
            found = min(found, fitting.fit(effects, [start], rounds=ROUNDS), key=lambda one: one.cost)
    trials = {**{e: t for e, t in step.trials.items() if e in effects}, entry.effect.id: entry.trial}
    return replace(_widened(fitting, found), trials=trials)


def nominal_base(fitting: Fitting, point: Point) -> Point:
    """Return ``point`` with the spring of the description and a spool's channel without error."""
    return point.moved(("spring_stiffness", GAIN, DELAY), (fitting.valve.spring_stiffness, 0.0, 0.0))


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
    parameters |= {p.name: p for p in effect.numbers}
    return {
        name: float(np.clip(value, parameters[name].low, parameters[name].high))
        for name, value in values.items()
    }


def _widened(fitting: Fitting, step: Hypothesis) -> Hypothesis:
    """Return ``step`` with gain or delay let free beyond its tolerance, where it pushes against that."""
    for name in (GAIN, DELAY):
        if name not in step.fitted.at_bound or name in step.effects:
            continue
        effects = (*step.effects[:-1], name, step.effects[-1])
        wider = fitting.fit(effects, [step.point], rounds=ROUNDS, enough=ENOUGH)
        value, spread = wider.point.get(name), wider.fitted.deviations[name]
        beyond = abs(value) > tolerance(fitting.settings, name) + 3.0 * spread
        if beyond and wider.cost < step.cost - THRESHOLDS.evidence:
            step = wider
    return step


def synchronised_point(context: Context, fitting: Fitting, entry: Hypothesis) -> Point:
    """Return the numbers of ``entry`` as fitted by synchronised runs."""
    nominal = nominal_base(fitting, entry.point)
    own = EFFECTS[entry.newest].starts(entry.own_values, context.reach) if entry.effects else [{}]
    starts = [entry.point, *(replace(nominal, values={**nominal.values, **values}) for values in own)]
    return synchronised_start(fitting, context.whole, entry.effects, starts) or entry.point
