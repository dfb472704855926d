"""Look-alikes with which the motion can go several ways, against the best by free runs: by coupled ones.

Free runs of the right numbers take another way than the measured motion, so those of a smooth effect that
acts alike may leave less.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from .coupled import DAMPING_RATIO, coupled_simulation, coupled_start
from .fitting import DELAY, GAIN, Step
from .point import Point
from .registry import EFFECTS
from .rules import CLEARLY, EVIDENCE

#: Share of the power left by one law that another may leave, so that no weight of windows matters.
DECISIVE = 0.25

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .search import Search


def winner_of_duels(search: Search, step: Step, winner: Step, others: Sequence[Step]) -> Step:
    """Return ``winner``, which leaves a gap, or the one of ``others`` that acts alike and leaves less.

    ``winner`` may be ``step`` itself, which others are added to: with any of them the motion may go several
    ways, so that free runs show no gain.
    """
    best = winner
    for other in others:
        if other is best or not (EFFECTS[other.effects[-1]].valleys or EFFECTS[other.effects[-1]].rare):
            continue
        if best is step or _alike(best.effects[-1], other.effects[-1]):
            best = _duel(search, best, other)
    return best


def _alike(name: str, rival: str) -> bool:
    return rival in EFFECTS[name].confused_with or name in EFFECTS[rival].confused_with


def _duel(search: Search, one: Step, other: Step) -> Step:
    """Return ``other``, as fitted by coupled runs, where it wins with the weight of either."""
    points = [coupled_fit(search, entry) for entry in (one, other)]
    simulation = coupled_simulation(search, search.whole, DAMPING_RATIO, search.settings.longest)
    simulation.robust = True
    held, training = simulation.held_out, simulation.training
    errors = [simulation.errors([point], held) for point in points]
    before, after = (float(simulation.nrmse(rows, held)[0]) ** 2 for rows in errors)
    if after > DECISIVE * before:
        least = [0.5 * stretch.noise.spool for stretch in simulation.stretches]
        numbers = len(other.fitted.free) - len(one.fitted.free)
        for host in points:
            simulation.take_weight(simulation.errors([host], training), training, least)
            cost, less = (float(simulation.cost(simulation.weigh(rows, held), held)[0]) for rows in errors)
            if cost - less - search.price * numbers < max(EVIDENCE, CLEARLY * cost):
                return one
    found = replace(other, fitted=replace(other.fitted, point=points[1], settled=None), train=[], held=[])
    return search.measured(found)


def coupled_fit(search: Search, entry: Step) -> Point:
    """Return the numbers of ``entry`` as fitted by coupled runs, from wherever it may start."""
    known = entry.fitted.point
    nominal = known.moved(("spring_stiffness", GAIN, DELAY), (search.valve.spring_stiffness, 0.0, 0.0))
    own = EFFECTS[entry.effects[-1]].starts(search.own_of(entry), search.reach) if entry.effects else [{}]
    starts = [known, *(replace(nominal, values={**nominal.values, **values}) for values in own)]
    return coupled_start(search, search.whole, entry.effects, starts) or known
