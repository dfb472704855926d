"""Stops: all else is named from free flight, then the contact is added and fitted over everything.

A free run through many hits has wrong valleys unless base and clearance are known within a few per cent. Free
flight gives the base and whatever acts between the stops, the hits themselves give the contact to start from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .by_direction import TWO, by_direction
from .contacts import Contacts, find_contacts
from .fitting import Fitting, Step
from .free_flight import in_free_flight, without_hits
from .pieces import pieces_of
from .result import Hypothesis
from .search import EVIDENCE, Search
from .simulate import Point, Simulation
from .stretches import Stretch, thinned

STOP = "end_stop"
#: Shares of the clearance that the hits show at which a fit starts: the displacement wanders.
SHARES = (0.94, 0.955, 0.97, 0.98, 0.99, 1.0, 1.01, 1.025)
#: Share of the samples on which the starts are compared.
COARSE = 3
#: Gain and delay (s) found in free flight from which the hits are looked at again.
GAIN_MATTERS, DELAY_MATTERS = 0.01, 0.2e-3


def free_flight_search(search: Search, contacts: Contacts, gain: float, delay: float) -> Search | None:
    """Return a search like ``search`` over free flight only; ``None`` where there is too little of it.

    Args:
        search: over everything.
        contacts: in its stretches.
        gain, delay: of the spool's channel, with which those were conditioned, relative, s.
    """
    stretches = in_free_flight(without_hits(search.whole, contacts), contacts)
    if not stretches:
        return None
    longest = search.settings.longest
    pieces = pieces_of(stretches, longest, gain, delay)
    if not all(any(flag == trains for s in pieces for flag in s.training) for trains in (True, False)):
        return None
    catalogue = [entry for entry in search.catalogue if entry.id != STOP]
    return Search(
        pieces, Simulation(pieces, search.simulation.motions), search.base, search.valve, search.settings,
        pieces, thinned(pieces, 3 * longest), search.report, catalogue,
    )  # fmt: skip


def run_with_contacts(search: Search, start: Point) -> Step | None:
    """Return the accepted hypothesis with a stop in it; ``None`` where hits are not what is missing.

    Args:
        search: over everything; holds the steps and the ranking afterwards.
        start: base, with the gain and delay with which the stretches were conditioned.
    """
    mass = start.values["mass"]
    contacts = find_contacts(search.whole, mass)
    free = free_flight_search(search, contacts, start.gain, start.delay) if contacts else None
    if contacts is None or free is None:
        return None
    flight = free.run(start)
    if TWO in flight.effects:  # its start from rest is judged with the stop
        flight = free.steps[-2]
    point = flight.fitted.point
    more, later = (1.0 + point.gain) / (1.0 + start.gain) - 1.0, point.delay - start.delay
    if abs(more) > GAIN_MATTERS or abs(later) > DELAY_MATTERS:
        contacts = find_contacts(search.whole, mass, gain=more, delay=later) or contacts
    _take_over(search, contacts, point)
    step = _with_stop(search, contacts, flight)
    without = search.measured(replace(flight))
    search.take_weight(step)
    step = search.fit(step.effects, [step.fitted.point], rounds=6)
    step.trials = flight.trials
    search.score(without)
    row = _row(search, without, step)
    if row.reason:
        return None
    search.steps = [search.measured(replace(entry)) for entry in free.steps if entry.effects != step.effects]
    search.steps = [entry for entry in search.steps if TWO not in entry.effects]
    search.ranking = [
        replace(entry, nrmse_after=search.nrmse(search.measured(replace(free.tried[entry.id, entry.beside]))))
        for entry in free.ranking
        if (entry.id, entry.beside) in free.tried
    ]
    search.ranking.append(replace(row, accepted=True))
    step = search._backward(step)
    search.steps.append(step)
    directed = by_direction(search, step, EVIDENCE)
    if directed is not None:
        search.steps.append(directed[0])
        search.ranking.append(directed[1])
        step = directed[0]
    return step


def _take_over(search: Search, contacts: Contacts, point: Point) -> None:
    """Weigh ``search`` by the noise beside the hits, and let starts ring as the base of ``point`` does."""
    better = without_hits(search.stretches, contacts)
    search.stretches = better
    motions = search.simulation.motions
    search.simulation = Simulation(better, motions)
    _prepare(search.simulation, point)


def _prepare(simulation: Simulation, point: Point) -> None:
    values = point.values
    simulation.let_start_ring(values["mass"], values["spring_stiffness"], values["viscous_coefficient"])
    simulation.forget_weight()


def _with_stop(search: Search, contacts: Contacts, flight: Step) -> Step:
    """Return ``flight`` with a stop, fitted over all windows from the contact that the hits show."""
    effects = (*flight.effects, STOP)
    point = replace(flight.fitted.point, active=search.terms_of(effects))
    starts = []
    for law in contacts.laws:
        for share in SHARES:
            numbers = {
                "stop_gap": share * law.gap,
                "stop_stiffness": law.stiffness,
                "stop_dissipation": 0.0,
                "stop_damping": law.damping,
            }
            starts.append(replace(point, values={**point.values, **numbers}))
    some = thinned(search.stretches, search.settings.longest // COARSE)
    coarse = Fitting(some, Simulation(some, search.simulation.motions), search.base, search.valve, search.settings)
    _prepare(coarse.simulation, point)
    found = coarse.fit(effects, starts, rounds=8, tries=2, enough=2e-3)
    step = search.fit(effects, [found.fitted.point], rounds=5, enough=1e-3)
    _choose_sampling(search, step)
    return search.measured(step)


def _choose_sampling(search: Search, step: Step) -> None:
    """Compare samples rather than means over their intervals where that leaves less.

    Between two samples a hit that lasts about one is not what a band-limited record says.
    """
    simulation = search.simulation
    everything = list(range(len(simulation.places)))
    every = {place: np.ones(simulation.places[place][1].measured.size) for place in everything}
    left = []
    for jumps in (None, every):
        simulation.compare(jumps)
        errors = simulation.errors([step.fitted.point], everything)
        left.append(float(simulation.cost(simulation.weigh(errors, everything), everything)[0]))
    simulation.compare(every if left[1] < left[0] else None)


def _row(search: Search, without: Step, step: Step) -> Hypothesis:
    evidence = search._evidence(without, step)
    values = {free.name: step.fitted.point.get(free.name) for free in step.fitted.free}
    reason = search._refusal(without, step, evidence)
    search.tried[STOP, without.effects] = step
    return Hypothesis(STOP, without.effects, search.nrmse(step), evidence, values, reason=reason)
