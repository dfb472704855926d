"""Assembly of a result: where the gap sat, what closed it, by how much, and the curves of a report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.identification.record import Record
from spool_sim.model import Model
from spool_sim.terms import term

from spool_gap.fitting.descent import Fitted
from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.result import Curves, GapResult, HeldOutAgreement, NamedEffect, SmallEffect, Surface, Where
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.batches import Run
from spool_gap.simulation.noise_floor import Floor
from spool_gap.simulation.point import Point

from .location import Residual, locate, surface
from .outcome import Outcome

Array = NDArray[np.float64]


def assembled(
    records: Sequence[Record],
    base: Model,
    state: SelectionState,
    numbers: Fitted,
    outcome: Outcome,
    elapsed: float,
) -> GapResult:
    """Return the result of what was selected in ``state``, with its ``numbers``, after ``elapsed`` s."""
    first, final, fitting = state.steps[0], state.hypothesis, state.fitting
    simulation = fitting.simulation
    held = simulation.held_out
    before, after = simulation.run([first.point], held), simulation.run([final.point], held)
    where, picture = _located(fitting, first, outcome.floor)
    where_after, picture_after = _located(fitting, final, outcome.floor)
    return GapResult(
        record=", ".join(dict.fromkeys(record.name for record in records)),
        kind="accelerations",
        base_model=base.name,
        verdict=outcome.verdict,
        confidence=outcome.confidence.value,
        confidence_note=outcome.confidence.note,
        signs=outcome.signs,
        sentence=outcome.sentence,
        effects=tuple(_named(state, numbers, outcome)),
        runner_up=outcome.runner_up,
        candidates=outcome.candidates,
        ranking=tuple(sorted(state.ranking, key=lambda entry: (len(entry.jointly_with), -entry.evidence))),
        base=_quantities(first.fitted),
        parameters=_quantities(numbers),
        where=where,
        where_after=where_after,
        surface=picture,
        surface_after=picture_after,
        curves=_curves(fitting, before, after, first, final, outcome.floor),
        before=HeldOutAgreement(fitting.nrmse(first), _amplitude_ratio(fitting, before)),
        after=HeldOutAgreement(fitting.nrmse(final), _amplitude_ratio(fitting, after)),
        noise_floor=outcome.floor.nrmse,
        model=model_of(base, final.effects, numbers.point),
        noise_alone=numbers is final.fitted,
        warnings=outcome.warnings,
        seconds=sum((w.stop - w.start) * s.record.sample_period for s, w, _ in simulation.places),
        elapsed=elapsed,
        advice=outcome.advice,
        predictable=outcome.rest.shares,
        remainder=outcome.remainder,
        nuisances=outcome.nuisances,
        small_effects=tuple(_small(numbers, outcome)),
        trace=state.trace,
        correlation=numbers.correlation,
        correlated=tuple(free.name for free in numbers.free),
    )


def model_of(base: Model, effects: Sequence[str], point: Point) -> Model:
    """Return ``base`` with ``effects`` as terms, with the numbers of ``point``."""
    terms = [*base.terms]
    known = {entry.name for entry in terms}
    terms += [term(name) for name in point.terms if name not in known]
    names = {parameter.name for entry in terms for parameter in entry.parameters}
    values = {name: value for name, value in point.values.items() if name in names}
    extra = [entry for entry in effects if entry in EFFECTS and EFFECTS[entry].terms]
    return Model("_".join([base.name, *extra]), tuple(terms), values)


def _quantities(numbers: Fitted) -> tuple[Quantity, ...]:
    found = []
    for free in numbers.free:
        value = numbers.point.get(free.name)
        found.append(
            Quantity(
                free.name,
                numbers.point.unit(free.name),
                value,
                numbers.deviations[free.name],
                Validity.VALID,
            )
        )
    return tuple(found)


def _named(state: SelectionState, numbers: Fitted, outcome: Outcome) -> list[NamedEffect]:
    fitting, final = state.fitting, state.hypothesis
    by_name = {quantity.name: quantity for quantity in _quantities(numbers)} | dict(outcome.extra)
    found = []
    last = fitting.nrmse(state.steps[0])
    for name in outcome.effects:
        entry = EFFECTS[name]
        step = next((s for s in state.steps if name in s.effects), final)
        row = next((h for h in state.ranking if h.id == name and h.accepted), None)
        after = fitting.nrmse(step)
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


def _small(numbers: Fitted, outcome: Outcome) -> Iterator[SmallEffect]:
    by_name = {quantity.name: quantity for quantity in _quantities(numbers)}
    for name, share in outcome.small.items():
        yield SmallEffect(name, tuple(by_name[p] for p in EFFECTS[name].fitted if p in by_name), share)


def _located(fitting: Fitting, step: Hypothesis, floor: Floor) -> tuple[Where, Surface]:
    """Return where the gap of ``step`` sits: the force that is missing at the measured motion."""
    simulation = fitting.simulation
    values, parts = step.point.values, []
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
    fitting: Fitting,
    before: Sequence[Run],
    after: Sequence[Run],
    first: Hypothesis,
    final: Hypothesis,
    floor: Floor,
) -> Curves:
    simulation = fitting.simulation
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


def _amplitude_ratio(fitting: Fitting, runs: Sequence[Run]) -> float:
    """Return the paper's a_est/a_pom: the mean ratio of rms values in bands of 5 Hz, 10 to 100 Hz."""
    simulation = fitting.simulation
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
