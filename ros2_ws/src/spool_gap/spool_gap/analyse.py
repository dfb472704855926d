"""The workflow: fit the base, locate the gap, name what is missing, add it, look again."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from spool_identification.record import Record
from spool_sim.model import Model
from spool_sim.terms import term
from spool_sim.valve.description import Valve
from spool_stream.quantity import Quantity, Validity

from spool_gap.checks.saturation import find_saturation
from spool_gap.fitting.hypothesis import Step
from spool_gap.report.location import Residual, locate, surface
from spool_gap.report.outcome import Outcome, judge_outcome
from spool_gap.selection.contact_search import contacts_for, free_flight_search, run_with_contacts
from spool_gap.selection.judging import judged
from spool_gap.selection.search import Search
from spool_gap.simulation.batches import Run
from spool_gap.simulation.noise_floor import Floor
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import parts_of, stretches_of, thinned
from spool_gap.simulation.shooting import pieces_of
from spool_gap.simulation.simulate import Simulation
from spool_gap.simulation.switchable import SwitchableMotion, known_terms

from .checks import conditions
from .registry import EFFECTS
from .result import Agreement, Curves, GapResult, GapSettings, NamedEffect, Surface, Where

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
#: Held-out error from which a model explains nothing.
NOTHING = 0.8
#: Samples that are looked at before windows are chosen.
LONGEST_LOOKED_AT = 600_000


def motions_for(base: Model) -> list[SwitchableMotion]:
    """Return the kernels for ``base`` with any effect: one for forces without events, and one for all."""
    wanted = [entry.name for entry in base.terms]
    wanted += [name for entry in EFFECTS.values() for name in entry.terms]
    known = known_terms(wanted)
    smooth = [name for name in known if set(term(name).laws) <= {"force_law"}]
    return [SwitchableMotion(smooth), SwitchableMotion(known)]


def given_by(valve: Valve) -> dict[str, float]:
    """Return the numbers of all effects that the description of ``valve`` gives, as the spool's weight."""
    parameters = [p for entry in EFFECTS.values() for name in entry.terms for p in term(name).parameters]
    return {p.name: p.start_for(valve) for p in parameters if p.valve_attribute is not None}


def analyse(
    records: Sequence[Record],
    valve: Valve,
    base: Model,
    *,
    holdout: Sequence[Record] = (),
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """Return what ``base`` lacks in ``records``, judged on data that no fit has seen.

    Args:
        records: two accelerations each, of one valve.
        valve: gives the mass, which two accelerometers cannot see, and what is expected.
        base: any composition of force terms.
        holdout: records to judge on; without them every other window of ``records`` is held out.
        settings: tolerances and amounts.
        progress: takes what is done and the share of the work.

    Raises:
        InputError: the records cannot be analysed; what is wrong is named.
    """
    begun = time.monotonic()
    chosen = settings or GapSettings()
    tell = progress or (lambda _what, _share: None)
    tell("checking the record", 0.0)
    usable, warnings = conditions.usable(records)
    trusted = True
    for record in usable[:3]:
        found, good = conditions.judge(record, valve)
        warnings += [line for line in found if line not in warnings]
        trusted = trusted and good
    usable = parts_of(usable, LONGEST_LOOKED_AT)
    held, _ = conditions.usable(holdout) if holdout else ([], [])
    held = parts_of(held, LONGEST_LOOKED_AT)
    saturation = find_saturation([*usable, *held])
    warnings += saturation.warnings
    tell("preparing", 0.05)
    motions = motions_for(base)
    start = Point(tuple(entry.name for entry in base.terms), {**given_by(valve), **base.values_for(valve)})
    repaired = saturation.repaired[: len(usable)], saturation.repaired[len(usable) :]

    def search_with(damping: float, gain: float, delay: float, longest: int) -> Search:
        whole = stretches_of(
            *repaired, base, valve, damping=damping, gain=gain, delay=delay, clipped=saturation.kept
        )
        pieces = pieces_of(whole, longest, gain, delay)
        return Search(
            pieces, Simulation(pieces, motions), base, valve, chosen,
            whole, Simulation(thinned(whole, longest), motions), thinned(whole, 3 * longest), tell,
        )  # fmt: skip

    # A first look at the damping says how long a window takes to forget its start.
    rough = search_with(0.5 * valve.viscous_coefficient, 0.0, 0.0, chosen.longest // 2)
    contacts = contacts_for(rough, start.values["mass"])
    flight = free_flight_search(rough, contacts, 0.0, 0.0) if contacts else None
    point = (flight or rough).base_fit(start, rounds=6).fitted.point

    def search_from(found: Point) -> Search:
        return search_with(found.get("viscous_coefficient"), found.gain, found.delay, chosen.longest)

    search = search_from(point)
    # Through many hits a free run is judged over the pieces that it is fitted over.
    final = run_with_contacts(search, point) if flight else None
    if final is None or search.nrmse(final) > NOTHING:
        search = search_from(point)
        final = search.run(point)
        final = judged(search, final)
    tell("measuring what is left", 0.9)
    outcome = judge_outcome(search, final, saturation, chosen, trusted=trusted)
    left = search.nrmse(final)
    if left > NOTHING:
        warnings.append(
            f"even the best model leaves {100.0 * left:.3g} % of the spool's acceleration: units of both "
            "channels, order and sign of the columns, valve file?"
        )
    return _result(records, base, search, final, outcome, tuple(warnings), begun)


def _result(
    records: Sequence[Record],
    base: Model,
    search: Search,
    final: Step,
    outcome: Outcome,
    warnings: tuple[str, ...],
    begun: float,
) -> GapResult:
    first = search.steps[0]
    simulation = search.simulation
    held = simulation.held_out
    before, after = simulation.run([first.fitted.point], held), simulation.run([final.fitted.point], held)
    where, picture = _located(search, first, outcome.floor)
    where_after, picture_after = _located(search, final, outcome.floor)
    return GapResult(
        record=", ".join(dict.fromkeys(record.name for record in records)),
        kind="accelerations",
        base_model=base.name,
        verdict=outcome.verdict,
        confidence=outcome.confidence,
        sentence=outcome.sentence,
        effects=tuple(_named(search, final, outcome)),
        runner_up=outcome.runner_up,
        candidates=outcome.candidates,
        ranking=tuple(sorted(search.ranking, key=lambda entry: (len(entry.beside), -entry.evidence))),
        base=_quantities(first),
        parameters=_quantities(final),
        where=where,
        where_after=where_after,
        surface=picture,
        surface_after=picture_after,
        curves=_curves(search, before, after, first, final, outcome.floor),
        before=Agreement(search.nrmse(first), _amplitude_ratio(search, before)),
        after=Agreement(search.nrmse(final), _amplitude_ratio(search, after)),
        noise_floor=outcome.floor.nrmse,
        model=model_of(base, final),
        warnings=warnings + outcome.warnings,
        seconds=sum((w.stop - w.start) * s.record.sample_period for s, w, _ in simulation.places),
        elapsed=time.monotonic() - begun,
        advice=outcome.advice,
        foretold=outcome.rest.shares,
    )


def model_of(base: Model, step: Step) -> Model:
    """Return ``base`` with the effects of ``step`` as terms, with the fitted numbers."""
    terms = [*base.terms]
    known = {entry.name for entry in terms}
    terms += [term(name) for name in step.fitted.point.active if name not in known]
    names = {parameter.name for entry in terms for parameter in entry.parameters}
    values = {name: value for name, value in step.fitted.point.values.items() if name in names}
    extra = [entry for entry in step.effects if entry in EFFECTS and EFFECTS[entry].terms]
    return Model("_".join([base.name, *extra]), tuple(terms), values)


def _quantities(step: Step) -> tuple[Quantity, ...]:
    found = []
    for free in step.fitted.free:
        value = step.fitted.point.get(free.name)
        found.append(
            Quantity(
                free.name,
                step.fitted.point.unit(free.name),
                value,
                step.fitted.deviations[free.name],
                Validity.VALID,
            )
        )
    return tuple(found)


def _named(search: Search, final: Step, outcome: Outcome) -> list[NamedEffect]:
    by_name = {quantity.name: quantity for quantity in _quantities(final)} | dict(outcome.extra)
    found = []
    last = search.nrmse(search.steps[0])
    for name in outcome.effects:
        entry = EFFECTS[name]
        step = next((s for s in search.steps if name in s.effects), final)
        row = next((h for h in search.ranking if h.id == name and h.accepted), None)
        after = search.nrmse(step)
        found.append(
            NamedEffect(
                name,
                tuple(by_name[p] for p in entry.fitted if p in by_name),
                last,
                after,
                row.evidence if row else math.nan,
                entry.on_the_machine,
                entry.to_check,
            )
        )
        last = after
    return found


def _located(search: Search, step: Step, floor: Floor) -> tuple[Where, Surface]:
    """Return where the gap of ``step`` sits: the force that is missing at the measured motion."""
    simulation = search.simulation
    values, parts = step.fitted.point.values, []
    for number, error in zip(simulation.held_out, step.held, strict=True):
        stretch, window, _ = simulation.places[number]
        part = slice(window.start, window.stop)
        period = stretch.record.sample_period
        time_ = (stretch.record.first_sample + np.arange(window.start, window.stop)) * period
        parts.append((time_, stretch.motion.displacement[part], stretch.motion.velocity[part], -error[0]))
    time_, z, v, error = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    mass = float(values["mass"])
    size = float(np.sqrt(np.mean([np.mean(row**2) for row in floor.errors])))
    residual = Residual(time_, z, v, -mass * error, mass * size, simulation.places[0][0].record.sample_period)
    return locate(residual), surface(residual)


def _curves(
    search: Search, before: Sequence[Run], after: Sequence[Run], first: Step, final: Step, floor: Floor
) -> Curves:
    simulation = search.simulation
    held = simulation.held_out
    loudest = int(np.argmax([float(np.sum(error**2)) for error in first.held]))
    stretch, window, _ = simulation.places[held[loudest]]
    period = stretch.record.sample_period
    count = min(window.stop - window.start, round(1.0 / period))
    error = np.abs(first.held[loudest][0])
    centre = int(np.argmax(np.convolve(error, np.ones(count), mode="valid"))) if error.size > count else 0
    part = slice(centre, centre + count)
    time_ = (stretch.record.first_sample + window.start + np.arange(centre, centre + count)) * period
    number = [s is stretch for s in simulation.stretches].index(True)
    measured = [row[np.newaxis] for row in simulation.measured(held)]
    spectra = [
        simulation.spectra(rows, held)[number] for rows in (measured, first.held, final.held, floor.errors)
    ]
    return Curves(
        time=np.asarray(time_),
        measured=window.measured[part],
        before=before[loudest].acceleration[0, part],
        after=after[loudest].acceleration[0, part],
        frequency=spectra[0][0],
        measured_density=spectra[0][1],
        before_density=spectra[1][1],
        after_density=spectra[2][1],
        floor_density=spectra[3][1],
        unit="m/s^2",
    )


def _amplitude_ratio(search: Search, runs: Sequence[Run]) -> float:
    """Return the paper's a_est/a_pom: the mean ratio of rms values in bands of 5 Hz, 10 to 100 Hz."""
    simulation = search.simulation
    edges = np.arange(10.0, 101.0, 5.0)
    model, measured = np.zeros(edges.size - 1), np.zeros(edges.size - 1)
    for number, run in zip(simulation.held_out, runs, strict=True):
        stretch, window, _ = simulation.places[number]
        frequency = np.fft.rfftfreq(window.measured.size, stretch.record.sample_period)
        taper = np.hanning(window.measured.size)
        place = np.digitize(frequency, edges) - 1
        good = (place >= 0) & (place < model.size)
        for total, row in ((model, run.acceleration[0]), (measured, window.measured)):
            np.add.at(total, place[good], np.abs(np.fft.rfft(row * taper)[good]) ** 2)
    there = measured > 1e-3 * measured.max(initial=0.0)
    return float(np.mean(np.sqrt(model[there] / measured[there]))) if there.any() else math.nan
