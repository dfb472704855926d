"""Fit of a stop over windows with hits, from the contact that those show.

A free run through many hits has wrong local minima unless base and clearance are known within a few per cent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.least_squares import Unknown
from spool_sim.terms import term

from spool_gap.fitting.descent import Fitted, descend
from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.simulation.contacts import FAR, ContactLaw, Contacts
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import thinned
from spool_gap.simulation.simulate import Simulation
from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]

STOP = "end_stop"
NUMBERS = ("stop_gap", "stop_stiffness", "stop_dissipation", "stop_damping")
#: Clearances at which a fit starts, least and largest scatter of them, relative, and best that are followed.
GAPS, SPREADS, FOLLOWED = 11, (0.006, 0.03), 3
#: Share of the samples on which the starts are compared.
COARSE = 2
#: Shares of clearance, stiffness and loss around a fit at which a deeper minimum is looked for, how many of
#: the best are followed, and how deep.
AROUND = ((0.98, 0.99, 0.995, 1.005, 1.01, 1.02), (0.75, 0.87, 1.15, 1.33), (0.8, 1.25))
TRIES, DEEPER = 3, 2e-3
#: Room over that of the law that the hits show in which stiffness and loss of the other are looked for.
OTHER_ROOM = 1.6
#: Squares over those of the one contact law up to which the other is followed.
HOPEFUL = 1.1


def with_stop(fitting: Fitting, contacts: Contacts, between: Hypothesis) -> tuple[Fitting, Hypothesis]:
    """Return ``between`` with a stop, and the weight by which all windows were fitted.

    The fit starts from the contact that the hits show. What contact-free segments have shown stays: a run
    through many hits would rather bend it.
    """
    effects = (*between.effects, STOP)
    point = replace(between.point, active=fitting.terms_of(effects))
    simulation = _prepared(fitting.simulation, between.point)
    law, found = _first_fit(simulation, fitting.settings.longest // COARSE, contacts, point)
    simulation = _sampled(simulation, found.point)
    simulation = simulation.weighed_by(simulation.errors([found.point], simulation.training))
    viscous = _descended(simulation, found.point, _free(law, "stop_damping"))
    deep = _dissipative(simulation, viscous, law, contacts)
    best = deep if deep.squares < (1.0 - THRESHOLDS.clearly) * viscous.squares else viscous
    fitting = fitting.over(simulation)
    return fitting, fitting.measured(
        Hypothesis(effects, _joined(between.fitted, best), trials=between.trials)
    )


def _first_fit(
    simulation: Simulation, longest: int, contacts: Contacts, point: Point
) -> tuple[ContactLaw, Fitted]:
    """Return the likeliest contact law of the hits, and its first fit; starts compare ``longest`` samples."""
    coarse = _prepared(Simulation(thinned(simulation.stretches, longest), simulation.motions), point)
    likely: list[tuple[float, Point, ContactLaw]] = []
    for law in contacts.laws:
        starts = _starts(point, law)
        chosen = coarse.training
        costs = coarse.cost(coarse.weigh(coarse.errors(starts, chosen), chosen), chosen)
        likely += [(cost, start, law) for cost, start in zip(costs.tolist(), starts, strict=True)]
    likely.sort(key=lambda entry: entry[0])
    tried = [
        (law, descend(simulation, [start], _free(law, "stop_damping"), rounds=3, enough=1e-3))
        for _, start, law in likely[:FOLLOWED]
    ]
    return min(tried, key=lambda pair: pair[1].squares)


def _dissipative(simulation: Simulation, viscous: Fitted, law: ContactLaw, contacts: Contacts) -> Fitted:
    """Return the fit of the other law, whose loss grows with the depth (Hunt and Crossley)."""
    loss = law.damping / (law.stiffness * contacts.depth)
    gap = viscous.point.get("stop_gap")
    starts = [
        viscous.point.moved(("stop_gap", "stop_dissipation", "stop_damping"), (share * gap, part * loss, 0.0))
        for share in (1.0, *AROUND[0])
        for part in (1.0, *AROUND[2])
    ]
    free = _free(replace(law, damping=loss, factor=OTHER_ROOM * law.factor), "stop_dissipation")
    deep = descend(simulation, starts, free, rounds=3, tries=TRIES, enough=1e-3)
    return _descended(simulation, deep.point, free) if deep.squares < HOPEFUL * viscous.squares else deep


def _prepared(simulation: Simulation, point: Point) -> Simulation:
    """Return ``simulation`` weighed by the channels' noise, starts ringing as the base of ``point`` does."""
    values = point.values
    ringing = values["mass"], values["spring_stiffness"], values["viscous_coefficient"]
    return simulation.ringing_as(*ringing).weighed_by_channels()


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
    """Return the fit from ``start``, and from around it while that leads into a deeper minimum."""
    best = descend(simulation, [start], free, rounds=5, enough=1e-3)
    for _ in range(2):
        around = [
            best.point.moved([entry.name], [share * best.point.get(entry.name)])
            for entry, shares in zip(free, AROUND, strict=True)
            for share in shares
        ]
        again = descend(simulation, around, free, rounds=4, tries=TRIES, enough=1e-3)
        if again.squares >= best.squares * (1.0 - DEEPER):
            break
        best = again
    return best


def _free(law: ContactLaw, loss: str) -> list[Unknown]:
    """Return what is fitted of the stop, near what the hits show: the run alone shows little of a hit."""
    room = 2.5 * law.gap * float(np.clip(law.spread / law.gap, *SPREADS))
    unit = {parameter.name: parameter.unit for parameter in term(STOP).parameters}
    bounds = {
        "stop_gap": (law.gap - room, law.gap + room, law.gap),
        "stop_stiffness": (law.stiffness / law.factor, law.stiffness * law.factor, law.stiffness),
        loss: (law.damping / law.factor, law.damping * law.factor, law.damping),
    }
    return [Unknown(name, unit[name], *numbers) for name, numbers in bounds.items()]


def _joined(between: Fitted, stop: Fitted) -> Fitted:
    """Return both fits as one: their numbers come from different samples."""
    sizes = len(between.free), len(stop.free)
    correlation = np.eye(sum(sizes))
    correlation[: sizes[0], : sizes[0]] = between.correlation
    correlation[sizes[0] :, sizes[0] :] = stop.correlation
    return replace(
        stop,
        free=(*between.free, *stop.free),
        deviations={**between.deviations, **stop.deviations},
        correlation=correlation,
        at_bound=between.at_bound,
    )


def _sampled(simulation: Simulation, point: Point) -> Simulation:
    """Return ``simulation`` comparing samples rather than means over their intervals where that leaves less.

    Between two samples a hit that lasts about one is not what a band-limited record says.
    """
    sizes = [window.measured.size for _, window, _ in simulation.places]
    every: dict[int, Array] = {place: np.ones(size) for place, size in enumerate(sizes)}
    means, samples = simulation.comparing(None), simulation.comparing(every)
    return samples if samples.cost_of(point) < means.cost_of(point) else means
