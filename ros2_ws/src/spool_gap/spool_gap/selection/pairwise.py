"""Look-alikes with which the motion can go several ways, against the best by free runs: by coupled ones.

Free runs of the right numbers take another way than the measured motion, so those of a smooth effect that
acts alike may leave less.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from spool_gap.fitting.hypothesis import BASE_NUMBERS, DELAY, GAIN, Step
from spool_gap.fitting.synchronised import DAMPING_RATIO, coupled_simulation, coupled_start
from spool_gap.registry import EFFECTS
from spool_gap.simulation.point import Point

from .rules import AT_FLOOR, CLEARLY, EVIDENCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .search import Search

#: Share of the power left by one law that another may leave, so that no weight of windows matters.
DECISIVE = 0.25


def winner_of_duels(search: Search, step: Step, winner: Step, others: Sequence[Step]) -> Step:
    """Return ``winner``, which leaves a gap, or the one of ``others`` that acts alike and leaves less.

    ``winner`` may be ``step`` itself, which others are added to: the motion may go several ways with any of
    them, with the first as with a spring that stiffens, so that free runs show no gain.
    """
    best, fitted = winner, None
    for number, other in enumerate(others):
        entry = EFFECTS[other.effects[-1]]
        several = entry.valleys or entry.rare or (winner is step and number == 0 and entry.terms)
        if other is winner or not several:
            continue
        if winner is step and step.effects and search.evidence(step, other) < 0.0:
            continue
        if best is step or _alike(best.effects[-1], other.effects[-1]):
            fitted = fitted or coupled_fit(search, best)
            rival = coupled_fit(search, other)
            if _wins(search, best, fitted, other, rival):
                best, fitted = replace(other, fitted=replace(other.fitted, point=rival, settled=None)), rival
                search.measured(best)
                if search.nrmse(best) < AT_FLOOR * search.floor:
                    break
    return best


def _alike(name: str, rival: str) -> bool:
    return rival in EFFECTS[name].confused_with or name in EFFECTS[rival].confused_with


def _wins(search: Search, one: Step, fitted: Point, other: Step, rival: Point) -> bool:
    """Whether ``other`` at ``rival`` leaves less than ``one`` at ``fitted``, with the weight of either."""
    entry = EFFECTS[other.effects[-1]]
    if entry.sensible({name: rival.get(name) for name in (*BASE_NUMBERS, *entry.fitted)}, {}):
        return False
    simulation = coupled_simulation(search, search.whole, DAMPING_RATIO, search.settings.longest)
    simulation.robust = True
    held, training = simulation.held_out, simulation.training
    errors = [simulation.errors([point], held) for point in (fitted, rival)]
    before, after = (float(simulation.nrmse(rows, held)[0]) ** 2 for rows in errors)
    if after < DECISIVE * before:
        return True
    least = [0.5 * stretch.noise.spool for stretch in simulation.stretches]
    numbers = len(other.fitted.free) - len(one.fitted.free)
    for host in (fitted, rival):
        simulation.take_weight(simulation.errors([host], training), training, least)
        cost, less = (float(simulation.cost(simulation.weigh(rows, held), held)[0]) for rows in errors)
        if cost - less - search.price * numbers < max(EVIDENCE, CLEARLY * cost):
            return False
    return True


def coupled_fit(search: Search, entry: Step) -> Point:
    """Return the numbers of ``entry`` as fitted by coupled runs, from wherever it may start."""
    known = entry.fitted.point
    nominal = known.moved(("spring_stiffness", GAIN, DELAY), (search.valve.spring_stiffness, 0.0, 0.0))
    own = EFFECTS[entry.effects[-1]].starts(search.own_of(entry), search.reach) if entry.effects else [{}]
    starts = [known, *(replace(nominal, values={**nominal.values, **values}) for values in own)]
    return coupled_start(search, search.whole, entry.effects, starts) or known
