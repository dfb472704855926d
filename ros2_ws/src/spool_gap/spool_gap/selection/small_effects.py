"""Effects that half of the data does not show: fitted to all of it, and judged by the price of their numbers.

Held-out data guards against numbers that fit chance, at the cost of half of what is known. Where nothing
was found that way, the likelihood ratio over all windows says more, at a price for each number (Schwarz).
The ratio takes lines of a spectrum for independent; near a weakly damped resonance they are not, so it is
measured in what draws of the noise give in its direction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from spool_identification.least_squares.parallel import in_parallel

from spool_gap.fitting.hypothesis import Step
from spool_gap.registry import EFFECTS
from spool_gap.result import Hypothesis
from spool_gap.screening.screening import small_candidates
from spool_gap.simulation.noise_floor import noise_floor
from spool_gap.simulation.simulate import Simulation

from .rules import SMALLEST

if TYPE_CHECKING:
    from .search import Search

Array = NDArray[np.float64]

#: Twice the log likelihood ratio, less the price of its numbers, that an effect needs, and one that goes with
#: the drive's frequency, as small errors of any model do.
ENOUGH, WITH_TIME = 5.0, 20.0
#: Draws of the noise.
DRAWS = 4


class AllWindows(Simulation):
    """A simulation all of whose windows are fitted, and judge."""

    @property
    def training(self) -> list[int]:
        """Numbers of all windows."""
        return list(range(len(self.places)))

    @property
    def held_out(self) -> list[int]:
        """Numbers of all windows."""
        return self.training

    @classmethod
    def of(cls, other: Simulation) -> AllWindows:
        """Return that over the records of ``other`` that are fitted, weighed alike."""
        found = cls([stretch for stretch in other.stretches if any(stretch.training)], other.motions)
        found.take_way(other)
        return found


def small_effect(search: Search, base: Step) -> Step | None:
    """Return ``base`` with the effect that all windows together show, ``None`` where they show none."""
    kept = search.simulation, search.stretches
    everything = AllWindows.of(search.simulation)
    search.simulation, search.stretches = everything, everything.stretches
    try:
        start = search.fit((), [base.fitted.point])
        search.take_weight(start)
        start = search.polished(start, rounds=10)
        chosen = small_candidates(everything, search.regressed, search.catalogue, start)
        found = in_parallel(lambda entry: _fitted(search, start, entry.effect.id, entry.values), chosen)
        evidence = _evidence(everything, start, found)
        fall = [search.nrmse(start) ** 2 - search.nrmse(step) ** 2 for step in found]
    finally:
        search.simulation, search.stretches = kept
    if not found:
        return None
    best = max(range(len(found)), key=evidence.__getitem__)
    reasons = [
        _refusal(search, step, own, less) for step, own, less in zip(found, evidence, fall, strict=True)
    ]
    for number, step in enumerate(found):
        step.trials = {chosen[number].effect.id: chosen[number].trial}
        # All windows named it; its numbers come from those that are fitted, so that the others can judge.
        found[number] = search.polished(search.measured(step)) if number == best else search.measured(step)
        name = step.effects[-1]
        values = {own: step.fitted.point.values[own] for own in EFFECTS[name].fitted}
        accepted = number == best and not reasons[best]
        row = Hypothesis(
            name, (), search.nrmse(found[number]), evidence[number], values, accepted, reasons[number]
        )
        search.ranking = [*(known for known in search.ranking if known.id != name), row]
        search.tried[name, ()] = found[number]
    if reasons[best]:
        return None
    search.steps.append(found[best])
    return found[best]


def beyond_noise(search: Search, base: Step, step: Step) -> bool:
    """Whether ``step`` explains more of what ``base`` leaves on held-out windows than such noise allows."""
    return _evidence(search.simulation, base, [step])[0] >= _enough(step.effects[-1])


def _enough(name: str) -> float:
    return WITH_TIME if EFFECTS[name].follows_time else ENOUGH


def _refusal(search: Search, step: Step, evidence: float, fall: float) -> str:
    """Return why ``step``, with that evidence and fall of the share of power left, is none, or nothing."""
    name = step.effects[-1]
    if evidence < _enough(name):
        return "it does not close the gap significantly"
    if fall < SMALLEST**2:
        return "it is too small to be told from errors of the simulation"
    return search.senseless(step, name)


def _fitted(search: Search, start: Step, name: str, values: Mapping[str, float]) -> Step:
    """Return ``start`` with the effect ``name``, fitted from ``values`` to all windows."""
    point = replace(
        start.fitted.point, active=search.terms_of((name,)), values={**start.fitted.point.values, **values}
    )
    return search.polished(search.fit((name,), [point]), rounds=10)


def _evidence(simulation: Simulation, start: Step, found: list[Step]) -> list[float]:
    """Return twice the log likelihood ratio of each of ``found`` over ``start``, less the price."""
    if not found:
        return []
    chosen = simulation.held_out
    price = math.log(sum(window.stop - window.start for _, window, _ in simulation.places))
    noise = [
        simulation.weigh(noise_floor(simulation, start.fitted.point, start.held, seed=seed).errors, chosen)[0]
        for seed in range(DRAWS)
    ]
    edges, _ = simulation.parts(chosen)
    before = simulation.weigh(start.held, chosen)[0]
    rows = []
    for step in found:
        change = simulation.weigh(step.held, chosen)[0] - before
        often = spread(change, noise, edges)
        numbers = len(step.fitted.free) - len(start.fitted.free)
        rows.append((start.cost - step.cost) / max(1.0, often) - price * numbers)
    return rows


def spread(change: Array, noise: list[Array], edges: NDArray[np.int64]) -> float:
    """Return the variance of ``noise`` in the direction of ``change`` over that of independent numbers.

    Both are weighed, shape (m,); ``edges`` are where their windows begin, which are independent.
    """
    along = [np.add.reduceat(change * row, edges[:-1]) for row in noise]
    return float(np.mean([np.sum(row**2) for row in along])) / max(1e-30, float(change @ change))
