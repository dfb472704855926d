"""Stops: all else is named from free flight, then the contact is added and fitted over everything.

A free run through many hits has wrong valleys unless base and clearance are known within a few per cent. Free
flight gives the base and whatever acts between the stops, the hits themselves give the contact to start from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from spool_identification.least_squares.unknown import Unknown
from spool_sim.terms import term

from spool_gap.fitting.by_direction import TWO, by_direction
from spool_gap.fitting.descent import Fitted, descend
from spool_gap.fitting.hypothesis import Step
from spool_gap.registry import EFFECTS
from spool_gap.result import Hypothesis
from spool_gap.simulation.contact_free import in_free_flight, without_hits
from spool_gap.simulation.contacts import FAR, ContactLaw, Contacts, find_contacts
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch, thinned
from spool_gap.simulation.shooting import Piece, pieces_of
from spool_gap.simulation.simulate import Simulation

from .judging import TRIFLE, dropped
from .rules import CLEARLY
from .search import Search

Array = NDArray[np.float64]

STOP = "end_stop"
NUMBERS = ("stop_gap", "stop_stiffness", "stop_dissipation", "stop_damping")
#: Clearances at which a fit starts, least and largest scatter of them, relative, and best that are followed.
GAPS, SPREADS, FOLLOWED = 11, (0.006, 0.03), 3
#: Share of the samples on which the starts are compared.
COARSE = 2
#: Shares of clearance, stiffness and loss beside a fit at which a deeper valley is looked for, how many of
#: the best are followed, and how deep.
BESIDE = ((0.98, 0.99, 0.995, 1.005, 1.01, 1.02), (0.75, 0.87, 1.15, 1.33), (0.8, 1.25))
AROUND, DEEPER = 3, 2e-3
#: Room over that of the law that the hits show in which stiffness and loss of the other are looked for.
OTHER_ROOM = 1.6
#: Squares over those of the one contact law up to which the other is followed.
HOPEFUL = 1.1
#: Samples over those of other fits over which the contact is fitted.
MORE = 2
#: Error of a displacement over the scatter of the clearance from hit to hit.
WANDER = 0.5
#: Gain and delay (s) found in free flight from which the hits are looked at again.
GAIN_MATTERS, DELAY_MATTERS = 0.01, 0.2e-3
#: Share of the power left without a stop that one with may leave, for which no bad window is spared.
HALVED = 0.5


def contacts_for(search: Search, mass: float) -> Contacts | None:
    """Return the hits in ``search``; ``None`` where there are none, or its base has stops."""
    if all(entry.id != STOP for entry in search.catalogue):
        return None
    return find_contacts(search.whole, mass)


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
        pieces, Simulation(pieces, search.simulation.motions), thinned(pieces, 3 * longest), search.report,
        # The starts of pieces between hits are too uncertain for small effects.
        catalogue, small=False,
    )  # fmt: skip


def run_with_contacts(search: Search, start: Point) -> Step | None:
    """Return the accepted hypothesis with a stop in it; ``None`` where hits are not what is missing.

    Args:
        search: over everything; holds the steps and the ranking afterwards.
        start: base, with the gain and delay with which the stretches were conditioned.
    """
    mass = start.values["mass"]
    contacts = contacts_for(search, mass)
    free = free_flight_search(search, contacts, start.gain, start.delay) if contacts else None
    if contacts is None or free is None:
        return None
    flight = free.run(start)
    if TWO in flight.effects:  # its start from rest is judged with the stop
        flight = free.steps[-2]
    trifles = [name for name in flight.effects if name in EFFECTS and free.trifling(flight, name)]
    if trifles:
        flight = dropped(free, flight, trifles, TRIFLE)
        free.steps.append(flight)
    point = flight.fitted.point
    more, later = (1.0 + point.gain) / (1.0 + start.gain) - 1.0, point.delay - start.delay
    if abs(more) > GAIN_MATTERS or abs(later) > DELAY_MATTERS:
        contacts = find_contacts(search.whole, mass, gain=more, delay=later) or contacts
    search.report("fitting the stop", 0.7)
    _take_over(search, without_hits(search.whole, contacts), start, WANDER * contacts.laws[0].spread)
    _prepare(search.simulation, point)
    step = _with_stop(search, contacts, flight)
    without = search.measured(replace(flight))
    search.take_weight(step)
    for entry in (without, step):
        search.score(entry)
    row = _row(search, without, step)
    if row.reason:
        return None
    search.steps = [search.measured(replace(entry)) for entry in free.steps if TWO not in entry.effects]
    search.ranking = [
        replace(entry, nrmse_after=search.nrmse(search.measured(replace(free.tried[entry.id, entry.beside]))))
        for entry in free.ranking
        if (entry.id, entry.beside) in free.tried
    ]
    search.ranking.append(replace(row, accepted=True))
    search.steps.append(step)
    search.overruled = free.overruled
    directed = by_direction(search, step)
    if directed is not None:
        step = directed[0]
        search.steps.append(step)
        search.ranking.append(directed[1])
    return step


def _take_over(search: Search, whole: Sequence[Stretch], start: Point, wander: float) -> None:
    """Let ``search`` go over more pieces of ``whole``, whose displacement wanders by ``wander`` m."""
    stretches = pieces_of(whole, MORE * search.settings.longest, start.gain, start.delay)
    search.stretches = [
        replace(
            stretch,
            windows=tuple(
                replace(window, wander=(wander, 4.0 * math.pi * stretch.low_cut * wander))
                for window in stretch.windows
                if isinstance(window, Piece)
            ),
        )
        for stretch in stretches
    ]
    search.simulation = Simulation(search.stretches, search.simulation.motions)


def _prepare(simulation: Simulation, point: Point) -> None:
    """Weigh by the channels' noise, and let starts ring as the base of ``point`` does."""
    values = point.values
    simulation.let_start_ring(values["mass"], values["spring_stiffness"], values["viscous_coefficient"])
    simulation.forget_weight()


def _with_stop(search: Search, contacts: Contacts, flight: Step) -> Step:
    """Return ``flight`` with a stop, fitted over all windows from the contact that the hits show.

    What free flight has shown stays: a run through many hits would rather bend it.
    """
    effects = (*flight.effects, STOP)
    point = replace(flight.fitted.point, active=search.terms_of(effects))
    some = thinned(search.stretches, search.settings.longest // COARSE)
    coarse = Simulation(some, search.simulation.motions)
    _prepare(coarse, point)
    likely: list[tuple[float, Point, ContactLaw]] = []
    for law in contacts.laws:
        starts = _starts(point, law)
        costs = coarse.cost(
            coarse.weigh(coarse.errors(starts, coarse.training), coarse.training), coarse.training
        )
        likely += [(cost, start, law) for cost, start in zip(costs.tolist(), starts, strict=True)]
    likely.sort(key=lambda entry: entry[0])
    simulation = search.simulation
    simulation.compare(None)
    tried = [
        (descend(simulation, [start], _free(law, "stop_damping"), rounds=3, enough=1e-3), law)
        for _, start, law in likely[:FOLLOWED]
    ]
    found, law = min(tried, key=lambda pair: pair[0].squares)
    _choose_sampling(simulation, found.point)
    training = simulation.training
    simulation.take_weight(
        simulation.errors([found.point], training), training, [0.5 * s.noise.spool for s in search.stretches]
    )
    viscous = _descended(simulation, found.point, _free(law, "stop_damping"))
    # The other law, whose loss grows with the depth.
    loss = law.damping / (law.stiffness * contacts.depth)
    gap = viscous.point.get("stop_gap")
    starts = [
        viscous.point.moved(("stop_gap", "stop_dissipation", "stop_damping"), (share * gap, part * loss, 0.0))
        for share in (1.0, *BESIDE[0])
        for part in (1.0, *BESIDE[2])
    ]
    other = _free(replace(law, damping=loss, factor=OTHER_ROOM * law.factor), "stop_dissipation")
    deep = descend(simulation, starts, other, rounds=3, tries=AROUND, enough=1e-3)
    if deep.squares < HOPEFUL * viscous.squares:
        deep = _descended(simulation, deep.point, other)
    best = deep if deep.squares < (1.0 - CLEARLY) * viscous.squares else viscous
    step = Step(effects, _joined(flight.fitted, best), [], [], trials=flight.trials)
    return search.measured(step)


def _starts(point: Point, law: ContactLaw) -> list[Point]:
    """Return ``point`` with a stop: clearances about that of the hits, since the displacement wanders."""
    spread = law.gap * float(np.clip(law.spread / law.gap, *SPREADS))
    gaps = np.linspace(law.gap - 2.0 * spread, law.gap + spread, GAPS)
    shares = (1.0,) if law.factor < FAR else (0.6, 1.0, 1.7)
    return [
        point.moved(NUMBERS, (gap, share * law.stiffness, 0.0, share**0.5 * law.damping))
        for gap in gaps.tolist()
        for share in shares
    ]


def _descended(simulation: Simulation, start: Point, free: list[Unknown]) -> Fitted:
    """Return the fit from ``start``, and from beside it while that leads into a deeper valley."""
    best = descend(simulation, [start], free, rounds=5, enough=1e-3)
    for _ in range(2):
        around = [
            best.point.moved([entry.name], [share * best.point.get(entry.name)])
            for entry, shares in zip(free, BESIDE, strict=True)
            for share in shares
        ]
        again = descend(simulation, around, free, rounds=4, tries=AROUND, enough=1e-3)
        if again.squares >= best.squares * (1.0 - DEEPER):
            break
        best = again
    return best


def _free(law: ContactLaw, loss: str) -> list[Unknown]:
    """Return what is fitted of the stop, near what the hits show: the run alone tells little of a hit."""
    room = 2.5 * law.gap * float(np.clip(law.spread / law.gap, *SPREADS))
    unit = {parameter.name: parameter.unit for parameter in term(STOP).parameters}
    bounds = {
        "stop_gap": (law.gap - room, law.gap + room, law.gap),
        "stop_stiffness": (law.stiffness / law.factor, law.stiffness * law.factor, law.stiffness),
        loss: (law.damping / law.factor, law.damping * law.factor, law.damping),
    }
    return [Unknown(name, unit[name], *numbers) for name, numbers in bounds.items()]


def _joined(flight: Fitted, stop: Fitted) -> Fitted:
    """Return both fits as one: their numbers come from different samples."""
    sizes = len(flight.free), len(stop.free)
    correlation = np.eye(sum(sizes))
    correlation[: sizes[0], : sizes[0]] = flight.correlation
    correlation[sizes[0] :, sizes[0] :] = stop.correlation
    return replace(
        stop,
        free=(*flight.free, *stop.free),
        deviations={**flight.deviations, **stop.deviations},
        correlation=correlation,
        at_bound=flight.at_bound,
    )


def _choose_sampling(simulation: Simulation, point: Point) -> None:
    """Compare samples rather than means over their intervals where that leaves less.

    Between two samples a hit that lasts about one is not what a band-limited record says.
    """
    everything = list(range(len(simulation.places)))
    every: dict[int, Array] = {
        place: np.ones(simulation.places[place][1].measured.size) for place in everything
    }
    left = []
    for jumps in (None, every):
        simulation.compare(jumps)
        errors = simulation.errors([point], everything)
        left.append(float(simulation.cost(simulation.weigh(errors, everything), everything)[0]))
    simulation.compare(every if left[1] < left[0] else None)


def _row(search: Search, without: Step, step: Step) -> Hypothesis:
    evidence = max(search.evidence(without, step), _by_power(search, without, step))
    values = {free.name: step.fitted.point.get(free.name) for free in step.fitted.free}
    reason = search.refusal(without, step, evidence)
    search.tried[STOP, without.effects] = step
    return Hypothesis(STOP, without.effects, search.nrmse(step), evidence, values, reason=reason)


def _by_power(search: Search, without: Step, step: Step) -> float:
    """Return the evidence for ``step`` by the power that both leave in windows that are bad with either.

    0 where ``step`` leaves more than ``HALVED`` of the power: few windows with hits, each counted by a
    logarithm, weigh less than one that is grazed too early.
    """
    if search.nrmse(step) ** 2 >= HALVED * search.nrmse(without) ** 2:
        return 0.0
    simulation, held = search.simulation, search.simulation.held_out
    edges, usual = simulation.parts(held)
    before, after = (
        np.add.reduceat(simulation.weigh(entry.held, held)[0] ** 2, edges[:-1]) for entry in (without, step)
    )
    bad = np.maximum(before, after) > usual
    numbers = len(step.fitted.free) - len(without.fitted.free)
    gain = math.log(float(before[bad].sum()) / float(after[bad].sum())) if bad.any() else 0.0
    return float(np.diff(edges)[bad].sum()) * gain - search.price * numbers
