"""Fit of one model to records, and how well it agrees with them.

1. Start: the balance of forces at the measured motion (:mod:`.equation_error`).
2. Descent: least squares of the free run over windows (:mod:`.free_run`, :mod:`.residuals`), first with equal
   weights, then weighed by the spectrum of the residual. Where a force jumps, the record shows how its logger
   filters (:mod:`spool_sim.observation`); the filter's numbers are fitted with the others.
3. Standard deviations (:mod:`.residuals`); what the noise of the excitation does to the parameters
   (:mod:`.equation_error`) is taken off; rank of the information matrix (:mod:`.least_squares`).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95, Quantity, Validity
from spool_sim.model import Model
from spool_sim.observation import CAUSAL, INSTANTS, LINEAR, MEAN, Observation
from spool_sim.sensors import PAPER_CHAIN
from spool_sim.valve import Valve

from spool_estimator.identification import fit_check, least_squares
from spool_estimator.identification.determination import (
    IDENTIFIABLE,
    NOT,
    TOGETHER,
    Determination,
    hidden_by_name,
    refuted,
)
from spool_estimator.identification.equation_error import EquationError, diverging, input_noise_effect
from spool_estimator.identification.fit_result import (
    FILTER,
    MASS,
    SPOOL_DELAY,
    SPOOL_GAIN,
    Agreement,
    Fit,
    FitSettings,
)
from spool_estimator.identification.free_run import USUAL, FreeRun, Reading, Response
from spool_estimator.identification.record import Record
from spool_estimator.identification.residuals import (
    Residuals,
    Weighted,
    filter_numbers,
    fit_covariance,
    information_criterion,
    read_as,
    standard_deviations,
    with_numbers,
)
from spool_estimator.identification.spectra import density_of

#: s of data that the first descents from several starts use.
FIRST_SECONDS = 8.0
#: Most rounds of the first descents and of each later one, fall of the cost that ends them, and rounds after
#: which the starts to follow are chosen.
FIRST_ROUNDS, ROUNDS, ENOUGH, GLANCE = 30, 20, 1e-6, 8
#: How often the weights are taken again after the first descents, at most, and the relative fall of the cost
#: below which they have settled.
REWEIGHED, SETTLED = 5, 0.01
#: Ways of reading that are tried, and further orders of a causal low-pass, away from the one tried first.
LOW_PASSES = (Observation(LINEAR, 4.0, 0.42), Observation(CAUSAL, 4.0, 0.36, 0.36))
CAUSAL_ORDERS = ((3.0, 2.0), (5.0, 6.0, 7.0, 8.0))
#: Corner of a low-pass, over the sample rate, beyond which it keeps no alias out: samples at instants.
NO_FILTER = 0.5
#: Of two ends of first descents: distance over the size of their numbers from which they differ, and relative
#: difference of their costs up to which both are followed.
SAME, CLOSE = 0.02, 0.1
#: Rounds of these descents, and jumps from which they are made.
OBSERVED, FEWEST_JUMPS = 8, 20
#: Sizes of what friction at rest may be, relative to its start value, that are tried.
BLIND_FACTORS = (0.1, 0.3, 1.0, 3.0)
#: Relative standard deviation from which a quantity that cannot be 0 (a velocity, a length) is not told.
UNTOLD = 0.5
#: What the valve's description gives and yet is fitted.
FITTED_OF_VALVE = ("spring_stiffness", "viscous_coefficient")

#: Hz, width of the bands in which amplitudes are compared, and the range that the mean covers.
BAND = 5.0
LOWEST, HIGHEST = 10.0, 100.0
#: A band counts where the measured power is this share of the strongest band's, at least.
SMALLEST_POWER = 1e-4


def unknowns_of(model: Model, valve: Valve, settings: FitSettings) -> tuple[least_squares.Unknown, ...]:
    """Return what a fit of ``model`` finds, the sensor's nuisances last.

    Raises:
        InputError: the settings name a parameter that the model does not have.
    """
    for name in (*settings.held, *settings.free, *settings.start):
        model.parameter(name, "fit")
    found = []
    for parameter in model.parameters:
        given = parameter.valve_attribute is not None and parameter.name not in FITTED_OF_VALVE
        given = given or parameter.held
        if parameter.name in settings.held or (given and parameter.name not in settings.free):
            continue
        low, high = parameter.low, parameter.high
        start = abs(parameter.start_for(valve))
        scale = start if start > 0.0 else min(1.0, high - low)
        found.append(least_squares.Unknown(parameter.name, parameter.unit, low, high, scale))
    if settings.fit_gain:
        found.append(least_squares.Unknown(SPOOL_GAIN, "1", -0.5, 1.0, 0.05, absolute=True))
    if settings.fit_delay:
        found.append(least_squares.Unknown(SPOOL_DELAY, "s", -5e-3, 5e-3, 1e-4, absolute=True))
    return tuple(found)


def fit(
    records: Sequence[Record],
    model: Model,
    valve: Valve,
    settings: FitSettings | None = None,
    tell: Callable[[float], None] = lambda _steps: None,
) -> Fit:
    """Return ``model`` fitted to ``records``; bad data make a result with a reason, never an error.

    Args:
        records: stretches without gaps, of one valve.
        model: any composition of force terms.
        valve: gives the mass, which is held, and start values.
        settings: what is free, the band, the windows.
        tell: takes the simulated steps since it was last called, of ``settings.allowed`` at most.

    Raises:
        InputError: the settings name parameters that the model does not have, or values out of their range;
            with ``check``, a parameter that the law does not use.
    """
    chosen = settings or FitSettings()
    return _fit(records, model, valve, chosen, least_squares.Work(chosen.allowed, tell))


def _fit(
    records: Sequence[Record], model: Model, valve: Valve, chosen: FitSettings, work: least_squares.Work
) -> Fit:
    # What is not determined is held by a second fit.
    work.take(0.5 if chosen.check and not chosen.force_free else 1.0)
    unknowns = unknowns_of(model, valve, chosen)
    values = model.values_for(valve, {**chosen.start, **chosen.held})
    held = {name: value for name, value in values.items() if name not in {u.name for u in unknowns}}
    failed = Fit(model, valve.id, held=held)
    try:
        ended = follow(records, model, valve, chosen, unknowns, values, work)
        found = replace(_result(ended, unknowns, values, held, valve, chosen), stopped_early=work.cut)
        return _held_back(found, records, valve, chosen, work) if chosen.check else found
    except fit_check.UnusedParameterError:
        raise
    except InputError as error:
        return replace(failed, reason=str(error))
    except (np.linalg.LinAlgError, FloatingPointError, OverflowError, ValueError) as error:
        return replace(failed, reason=f"the numbers broke down: {error}")


def determined_before(records: Sequence[Record], model: Model, valve: Valve) -> tuple[Determination, ...]:
    """Return what ``records`` determine of ``model`` at the start values, before any fit.

    Empty where no fit can begin.
    """
    settings = FitSettings()
    unknowns = unknowns_of(model, valve, settings)
    values = model.values_for(valve)
    try:
        run = FreeRun(
            records, model, valve, window=settings.window, run_in=settings.run_in, longest=FIRST_SECONDS
        )
        balance = EquationError(run, unknowns, run.sets(values), settings.low_cut)
        point = _starts(run, balance, unknowns, values, settings)[0]
        # The ends of intervals at the start values are no result.
        found = [
            replace(one, low=None, high=None) if one.verdict == IDENTIFIABLE else one
            for one in fit_check.before_fit(run, unknowns, point, values, settings)
        ]
        silent = {one.name for one in found if one.verdict == NOT}
        seen = [unknown for unknown in unknowns if unknown.name not in silent]
        return (*found, *fit_check.scale_of(run, seen, values, settings))
    except (InputError, np.linalg.LinAlgError, FloatingPointError, OverflowError):
        return ()


def free_run_agreement(
    records: Sequence[Record],
    model: Model,
    valve: Valve,
    values: Mapping[str, float],
    *,
    sensor: Mapping[str, float] | None = None,
    observation: Observation = USUAL,
    run_in: float = 0.5,
    low_cut: float = 3.0,
) -> Agreement:
    """Return how ``model`` with ``values`` agrees with ``records``, simulated in one piece each.

    Args:
        records: not necessarily those of a fit.
        model, valve: as in a fit.
        values: all parameters of the model.
        sensor: gain error and delay of the spool's sensor, none by default.
        observation: of both channels.
        run_in: s at the start of each record that do not count.
        low_cut: Hz, of the conditioning that gives the motion to start from.

    Raises:
        InputError: no record is long enough.
    """
    run = FreeRun(records, model, valve, run_in=run_in, low_cut=low_cut)
    run.choose_substeps(values)
    errors = sensor or {}
    reading = Reading(errors.get(SPOOL_GAIN, 0.0), errors.get(SPOOL_DELAY, 0.0), observation)
    return agreement(run, run.responses(run.sets(values), [reading]))


def agreement(run: FreeRun, responses: Sequence[Response]) -> Agreement:
    """Return how the first set of ``responses`` agrees with the windows of ``run``."""
    measured = [window.measured for window in run.windows]
    simulated = [response.acceleration[0] for response in responses]
    errors = [one - other for one, other in zip(simulated, measured, strict=True)]
    squares = float(sum(np.sum(row**2) for row in errors))
    power = float(sum(np.sum(row**2) for row in measured))
    samples = sum(row.size for row in measured)
    sigma = PAPER_CHAIN.relative_uncertainty / np.sqrt(3.0) * np.sqrt(power / samples)
    periods = [run.records[window.record].sample_period for window in run.windows]
    centres, ratios = _amplitude_ratios(simulated, measured, periods)
    inside = (centres >= LOWEST) & (centres <= HIGHEST) & np.isfinite(ratios)
    # Of the records with the shortest period.
    shortest = min(periods)
    rows = [row for row, period in zip(errors, periods, strict=True) if period == shortest]
    frequency, density = density_of(rows, shortest)
    return Agreement(
        nrmse=float(np.sqrt(squares / power)) if power > 0.0 else float("nan"),
        objective=squares / sigma**2 if sigma > 0.0 else float("nan"),
        frequencies=centres, amplitude_ratios=ratios,
        amplitude_ratio=float(ratios[inside].mean()) if inside.any() else float("nan"),
        residual_frequencies=frequency, residual_spectrum=density,
        seconds=float(sum(row.size * period for row, period in zip(measured, periods, strict=True))),
        samples=samples,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Ended:
    """End of the descents of a fit.

    Attributes:
        residuals: weighed by their spectrum; its unknowns are those that were fitted.
        best: where the descent ended.
        law: balance of forces with all unknowns.
        before: the judgement at the start values, empty without ``FitSettings.check``.
    """

    residuals: Residuals
    best: least_squares.Descent
    law: EquationError
    before: list[Determination]

    def criterion(self, parameters: int) -> float:
        """Return the information criterion of the fit with so many ``parameters``."""
        return information_criterion(self.residuals, self.best.point, parameters)[0]


def follow(
    records: Sequence[Record],
    model: Model,
    valve: Valve,
    settings: FitSettings,
    unknowns: tuple[least_squares.Unknown, ...],
    values: Mapping[str, float],
    work: least_squares.Work,
) -> Ended:
    """Return where the fit of ``unknowns`` ends; what no force shows by itself is held at ``values``.

    Raises:
        InputError: the records are too short, or the spool's acceleration is 0.
    """
    run = FreeRun(
        records, model, valve, window=settings.window, run_in=settings.run_in, low_cut=settings.low_cut,
        longest=settings.longest, work=work,
    )  # fmt: skip
    if not any(np.any(window.measured) for window in run.windows):
        raise InputError(f"{records[0].name}: the spool's acceleration is 0 throughout; check the sensor")
    given = inside(np.array([values.get(unknown.name, 0.0) for unknown in unknowns]), unknowns)
    law = EquationError(run, unknowns, run.sets(values), settings.low_cut)
    unseen = least_squares.unseen_directions(law.force_slopes(given), least_squares.sizes_of(unknowns, given))
    # What the valve's description gives is held first.
    order = sorted(range(len(unknowns)), key=lambda n: unknowns[n].name in settings.free)
    gauge = least_squares.to_hold(unseen[:, order], [unknowns[n].name for n in order])
    if settings.force_free:
        gauge = ()
    free = tuple(unknown for unknown in unknowns if unknown.name not in gauge)
    balance = EquationError(run, free, run.sets(values), settings.low_cut) if gauge else law
    points = _starts(run, balance, free, values, settings)
    first = {unknown.name: float(value) for unknown, value in zip(free, points[0], strict=True)}
    run.choose_substeps({**values, **{name: value for name, value in first.items() if name in values}})
    band = (settings.low_cut, settings.high_cut)
    some = Residuals(run.fewer(FIRST_SECONDS), free, values, band)
    if not np.isfinite(some.at(points[0])).all():
        raise diverging(some, points[0])
    before: list[Determination] = []
    if settings.check:
        start = np.array([first.get(unknown.name, values.get(unknown.name, 0.0)) for unknown in unknowns])
        before = fit_check.before_fit(some.run, unknowns, start, values, settings)
    narrow = None if settings.start or settings.starts < 2 else model.narrower()
    if narrow is None:
        seen = observed(some, points[0])
    else:
        wider, seen = _widened(some, narrow, valve, settings.low_cut)
        points = [*wider, points[0]]
    trial, ends = _first_ends(some, points, seen, settings.starts)
    if seen is None or len(points) > 1:  # the start may have been too far off to show it
        again = observed(some, ends[0].point[: len(free)])
        if again is not None and (seen is None or family_of(again) != family_of(seen)):
            seen, points = again, [one.point[: len(free)] for one in ends]
            if narrow is not None:  # so read, another speed of the law may be likelier
                points = [*_widened(some, narrow, valve, settings.low_cut, seen)[0], *points]
            trial, ends = _first_ends(some, points, seen, settings.starts)
    whole = Residuals(run, trial.unknowns, values, band)
    whole.observation = trial.observation
    if not np.isfinite(whole.at(ends[0].point)).all():  # numbers that the first seconds hardly show
        _, ends = _first_ends(Residuals(run, free, values, band), points, seen, settings.starts)
    refined = [_refined(copy.copy(whole), end, law, before) for end in ends]
    return min(refined, key=lambda one: one.criterion(len(free)))


def _refined(
    residuals: Residuals, end: least_squares.Descent, law: EquationError, before: list[Determination]
) -> Ended:
    """Return the fit that first ended at ``end``, weighed by its spectra and read as it shows."""
    residuals.spectrum = list(residuals.spectrum)
    best = refine(residuals, end, REWEIGHED)
    residuals.observation = with_numbers(residuals.observation, residuals.unknowns, best.point.tolist())
    return Ended(residuals, best, law, before)


def family_of(one: Observation) -> tuple[str, float]:
    """Return the kind of a reading, with the order of a causal low-pass, a whole number."""
    return one.kind, one.order if one.kind == CAUSAL else 0.0


def likeliest_reading(ended: Ended, others: Iterable[Observation]) -> Ended:
    """Return a fit that ended, with its channels read as one of ``others`` where that is likelier."""
    own = ended.residuals
    free = tuple(one for one in own.unknowns if one.name not in FILTER)
    found = [ended]
    for seen in others:
        if family_of(seen) == family_of(own.observation):
            continue
        trial = read_as(Residuals(own.run, free, own.values, own.band), seen)
        point = np.append(ended.best.point[: len(free)], filter_numbers(seen))
        trial.leave_out(point)
        end = trial.descend(point[np.newaxis], FIRST_ROUNDS, ENOUGH)
        found.append(_refined(trial, end, ended.law, ended.before))
    return min(found, key=lambda one: one.criterion(len(free)))


def _widened(
    some: Residuals, narrow: Model, valve: Valve, low_cut: float, seen: Observation | None = None
) -> tuple[list[Array], Observation | None]:
    """Return points where the law of ``some`` begins as ``narrow``, fitted, and how that one reads.

    ``seen``: how it reads, where that is known.

    What the narrower law does not have, such as a velocity, is held at several values meanwhile: the forces
    are linear in the rest.
    """
    unknowns, run = some.unknowns, some.run.of(narrow)
    own = tuple(one for one in unknowns if one.name in run.names or one.name not in some.values)
    values = {**narrow.values_for(valve), **{n: v for n, v in some.values.items() if n in run.names}}
    fewer = Residuals(run, own, values, some.band)
    point = inside(EquationError(run, own, run.sets(values), low_cut).starts()[0], own)
    seen = seen or observed(fewer, point)
    trial, (best, *_) = _first_ends(fewer, [point], seen, 1)
    found = {one.name: float(value) for one, value in zip(trial.unknowns, best.point, strict=True)}
    narrowed = {name: found.get(name, value) for name, value in values.items()}
    # Readings at instants hardly move with the numbers.
    read = Observation(MEAN) if trial.observation.kind == INSTANTS else trial.observation
    start = {**found, **(some.run.model.values_as(narrow, narrowed, valve) or {})}
    point = inside(np.array([start[one.name] for one in unknowns]), unknowns)
    left = [one.name not in found and start[one.name] == some.values[one.name] for one in unknowns]
    ends = []
    for factor in BLIND_FACTORS if any(left) else ():
        first = inside(np.where(left, factor * point, point), unknowns).tolist()
        fixed = tuple(
            replace(one, low=place, high=place) if is_left else one
            for one, place, is_left in zip(unknowns, first, left, strict=True)
        )
        held = read_as(Residuals(some.run, fixed, some.values, some.band), read)
        end = held.descend(np.array([[*first, *filter_numbers(read)]]), GLANCE, ENOUGH)
        ends.append((end.cost, end.point[: len(first)]))
    ends.sort(key=lambda one: one[0])
    return [point for _, point in ends[:2]], seen


def _first_ends(
    some: Residuals, points: Sequence[Array], seen: Observation | None, starts: int
) -> tuple[Residuals, list[least_squares.Descent]]:
    """Return where the best descents from ``points`` end, with the numbers of the filter that was seen.

    Those that the weights to come may put in another order; the best first.
    """
    trial, numbers = (some, []) if seen is None else (read_as(some, seen), filter_numbers(seen))
    chosen = [np.append(point, numbers) for point in points]
    if trial.observation.kind == INSTANTS:
        means = read_as(some, Observation(MEAN))
        chosen += [means.descend(point[np.newaxis], GLANCE, ENOUGH).point for point in chosen]

    def descended(point: Array, rounds: int) -> least_squares.Descent:
        own = copy.copy(trial)
        own.leave_out(point)
        return own.descend(point[np.newaxis], rounds, ENOUGH)

    if len(chosen) > max(1, starts):
        glances = [descended(point, GLANCE) for point in chosen]
        chosen = [one.point for one in sorted(glances, key=lambda one: one.cost)[: max(1, starts)]]
    ends = [descended(point, FIRST_ROUNDS) for point in chosen]
    ends.sort(key=lambda one: one.cost)
    size = SAME * least_squares.sizes_of(trial.unknowns, ends[0].point)[: len(some.unknowns)]
    rivals = [
        end for end in ends[1:]
        if end.cost < (1.0 + CLOSE) * ends[0].cost
        and (np.abs(end.point - ends[0].point)[: size.size] > size).any()
    ]  # fmt: skip
    return trial, [ends[0], *rivals[:1]]


def observed(some: Residuals, point: Array) -> Observation | None:
    """Return how both channels are read, as the record shows near ``point`` (u,); ``None`` if it does not.

    A force that jumps shows the logger's low-pass. ``some`` has equal weights.
    """
    jumps = [response.jumps.size for response in some.respond(point[np.newaxis])]
    if sum(jumps) < FEWEST_JUMPS:
        return None
    glance = copy.copy(some)
    if max(jumps) >= FEWEST_JUMPS:
        glance.run = some.run.driven_by([some.run.windows[int(np.argmax(jumps))]])

    def tried(one: Observation, start: Array) -> tuple[float, Observation, Array]:
        trial = read_as(glance, one)
        start = np.append(start[: point.size], filter_numbers(one))
        found = trial.descend(start[np.newaxis], OBSERVED, ENOUGH)
        return found.cost, with_numbers(one, trial.unknowns, found.point.tolist()), found.point

    # Each begins with the forces of the best one before: from far off, corner and order make up for them.
    rows = [tried(Observation(MEAN), point)]
    rows += [tried(one, rows[0][2]) for one in LOW_PASSES]
    for orders in CAUSAL_ORDERS:
        before = min(rows[2:], key=lambda row: row[0])
        for order in orders if before is rows[2] else ():
            rows.append(tried(replace(before[1], order=order), before[2]))
            if rows[-1][0] > before[0]:
                break
            before = rows[-1]
    _, causal, near = min(rows[2:], key=lambda row: row[0])
    # Of another family, a filter of order 4 may look like one of Butterworth's of order 2.
    shapes = [
        tried(replace(causal, order=order, shape=0.0), near)
        for order in sorted({causal.order, LOW_PASSES[1].order})
    ]
    shaped = min(shapes, key=lambda row: row[0])
    best, samples = min(rows, key=lambda row: row[0]), sum(one.stop - one.start for one in glance.run.windows)
    # One number more has to pay (Schwarz, 1978).
    if shaped[0] < best[0] * (1.0 - math.log(samples) / samples):
        rows.append(shaped)
        best = shaped
    if best[1].kind != LINEAR:
        rows.append(tried(LOW_PASSES[0], best[2]))
    elif (causal := min(rows[2:], key=lambda row: row[0])[1]).kind == CAUSAL:
        rows.append(tried(causal, best[2]))
    best = min(rows, key=lambda row: row[0])
    if best[1].kind != MEAN and best[1].corner > NO_FILTER:
        mean = tried(Observation(MEAN), best[2])
        return mean[1] if mean[0] < best[0] else Observation()
    return best[1]


def _held_back(
    found: Fit, records: Sequence[Record], valve: Valve, settings: FitSettings, work: least_squares.Work
) -> Fit:
    """Return ``found`` with what the records do not determine at the values of model and valve.

    Intervals stay those of the fit in which everything was free.
    """
    if settings.force_free or found.reason is not None:
        return found
    model = found.model
    if any(one.name == MASS and one.verdict == TOGETHER for one in found.determinations) and (
        MASS in settings.free
    ):
        # All other numbers are known over the mass: a fit as if it had not been freed.
        start = {name: value for name, value in settings.start.items() if name != MASS}
        free = tuple(name for name in settings.free if name != MASS)
        again = _fit(records, model, valve, replace(settings, free=free, start=start), work)
        if again.reason is not None:
            return again
        return replace(
            again,
            parameters=(Quantity(MASS, model.parameter(MASS).unit), *again.parameters),
            not_observable=(MASS, *again.not_observable),
            stopped_early=found.stopped_early or again.stopped_early,
            held={name: value for name, value in again.held.items() if name != MASS},
        )
    chosen = {one.name: one for one in fit_check.to_hold(found.determinations, model, valve)}
    chosen.pop(MASS, None)
    if not chosen or len(chosen) == len(found.parameters):
        return found
    held = {name: one.held_at for name, one in chosen.items() if one.held_at is not None}
    start = {name: value for name, value in found.values.items() if name not in {**held, **found.held}}
    again = _fit(
        records, model, valve,
        replace(settings, held={**settings.held, **held}, start=start, starts=1, check=False,
                free=tuple(name for name in settings.free if name not in held)),
        work,
    )  # fmt: skip
    if again.reason is not None:
        return found
    return replace(
        found,
        values=again.values,
        agreement=again.agreement,
        stopped_early=found.stopped_early or again.stopped_early,
        determinations=tuple(chosen.get(one.name, one) for one in found.determinations),
    )


def _moved_starts(model: Model, settings: FitSettings) -> tuple[str, ...]:
    """Return a line for each start value of the settings that lies at a bound and was moved inside."""
    found = []
    for name, value in settings.start.items():
        one = model.parameter(name)
        if value in (one.low, one.high) and name not in settings.held:
            found.append(
                f"{name}: the start value {value:g} {one.unit} lies at its bound, where a fit may stall; "
                "the fit started a little inside"
            )
    return tuple(found)


def refine(residuals: Weighted, start: least_squares.Descent, rounds: int) -> least_squares.Descent:
    """Return the end of ``rounds`` descents, each with weights from where the one before ended."""
    best = start
    for _ in range(rounds):
        residuals.reweigh(best.point)
        before = float(residuals.costs(residuals.residuals(best.point[np.newaxis]))[0])
        best = residuals.descend(best.point[np.newaxis], ROUNDS, ENOUGH)
        if best.cost > (1.0 - SETTLED) * before:
            break
    return best


def _starts(
    run: FreeRun,
    balance: EquationError,
    unknowns: Sequence[least_squares.Unknown],
    values: Mapping[str, float],
    settings: FitSettings,
) -> list[Array]:
    """Return points to start from, the best first, judged by the free run."""
    points = balance.starts()
    blind = [n for n, unknown in enumerate(unknowns) if unknown.name in balance.blind]
    given = np.array([values.get(unknown.name, 0.0) for unknown in unknowns])
    named = [n for n, unknown in enumerate(unknowns) if unknown.name in settings.start]
    for point in points:
        point[named] = given[named]
        point[blind] = given[blind]
    if blind:
        points = [
            np.where(np.isin(np.arange(point.size), blind[:1]), point * factor, point)
            for point in points
            for factor in BLIND_FACTORS
        ]
    held = None if named else balance.held(points[0])
    if held is not None:
        points.append(held)
    points = [inside(point, unknowns) for point in points]
    if len(points) == 1:
        return points
    named_best = {u.name: float(v) for u, v in zip(unknowns, points[0], strict=True) if u.name in values}
    run.choose_substeps({**values, **named_best})
    trial = Residuals(run.fewer(FIRST_SECONDS), unknowns, values, (settings.low_cut, settings.high_cut))
    order = np.argsort(trial.costs(trial.residuals(np.array(points))))
    if held is not None and order[0] != len(points) - 1:
        order = order[order != len(points) - 1]
    return [points[number] for number in order.tolist()]


def inside(point: Array, unknowns: Sequence[least_squares.Unknown]) -> Array:
    """Return ``point`` a little inside of the bounds, where slopes to both sides exist."""
    low, high = least_squares.bounds_of(unknowns)
    room = np.minimum(1e-3 * np.array([unknown.scale for unknown in unknowns]), 0.1 * (high - low))
    return np.asarray(np.clip(point, low + room, high - room))


def _result(
    ended: Ended,
    unknowns: Sequence[least_squares.Unknown],
    values: Mapping[str, float],
    held: Mapping[str, float],
    valve: Valve,
    settings: FitSettings,
) -> Fit:
    residuals, best, law = ended.residuals, ended.best, ended.law
    run = residuals.run
    free = residuals.unknowns
    names = [unknown.name for unknown in unknowns]
    rate_std = max(entry.rate_std for entry in run.records)
    descended, covariance = fit_covariance(
        residuals, best.point, least_squares.sizes_of(free, best.point), settings, rate_std
    )
    descended = inside(descended, free)
    shown = np.isfinite(np.diag(covariance))
    best = replace(best, point=_without_noise(residuals, descended, covariance, settings))
    named = {unknown.name: float(value) for unknown, value in zip(free, best.point, strict=True)}
    final = {**values, **{name: value for name, value in named.items() if name in values}}
    sensor = {name: named[name] for name in (SPOOL_GAIN, SPOOL_DELAY) if name in named}
    # Nuisances that are not observable beside the rest were held at 0.
    ending = {SPOOL_GAIN: 0.0, SPOOL_DELAY: 0.0, **final, **sensor}
    ends = np.array([ending[name] for name in names])
    scales = least_squares.sizes_of(unknowns, ends)
    unseen = least_squares.unseen_directions(law.force_slopes(inside(ends, unknowns)), scales)
    constants = [p for p in run.model.parameters if p.name in held]
    lost, told = least_squares.combinations(
        np.hstack([unseen, np.zeros((unseen.shape[0], len(constants)))]),
        [*names, *(constant.name for constant in constants)],
        [*(unknown.unit for unknown in unknowns), *(constant.unit for constant in constants)],
        ending,
        np.concatenate([scales, np.zeros(len(constants))]),
    )
    deviations = dict(zip(named, standard_deviations(covariance).tolist(), strict=True))
    determinations = _judged(
        residuals, unknowns, descended, ends, covariance, unseen, ended.before, final, settings
    )
    judged = {one.name: one for one in determinations}
    fitted = {unknown.name: float(value) for unknown, value in zip(free, descended, strict=True)}
    parameters = []
    unclear = list(lost)
    for unknown in unknowns:
        deviation = deviations.get(unknown.name, math.nan)
        untold = unknown.low > 0.0 and not deviation < UNTOLD * abs(named.get(unknown.name, 0.0))
        untold |= refuted(judged.get(unknown.name), unknown, fitted.get(unknown.name, 0.0), deviation)
        if unknown.name in lost or untold or not math.isfinite(deviation):
            parameters.append(Quantity(unknown.name, unknown.unit))
            unclear += [unknown.name] if unknown.name not in unclear else []
        else:
            value = named[unknown.name]
            one = judged.get(unknown.name)
            if one is not None and not (one.low or -math.inf) <= value <= (one.high or math.inf):
                # Too far moved by the noise of the excitation for one step to be right.
                value = fitted[unknown.name]
                ends_of = [end for end in (one.low, one.high) if end is not None]
                deviation = max((abs(end - value) / Z_95 for end in ends_of), default=deviation)
            parameters.append(Quantity(unknown.name, unknown.unit, value, deviation, Validity.VALID))
    observable = [n for n, unknown in enumerate(free) if unknown.name not in (*unclear, *FILTER)]
    spread = standard_deviations(covariance)[observable]
    at_bound = tuple(
        unknown.name
        for unknown, value in zip(free, best.point.tolist(), strict=True)
        if unknown.name not in FILTER
        and min(value - unknown.low, unknown.high - value) <= 1e-6 * unknown.scale
    )
    places = [names.index(unknown.name) for unknown in free if unknown.name not in FILTER]
    criterion, samples = information_criterion(residuals, best.point, int(shown.sum()))
    read, apart = residuals.observation, deviations.get(FILTER[2], math.inf)
    if read.body_corner is not None and not abs(read.body_corner - read.corner) > Z_95 * apart:
        read = replace(read, body_corner=None)
    return Fit(
        model=run.model,
        valve=valve.id,
        converged=best.converged,
        parameters=tuple(parameters),
        not_observable=tuple(unclear),
        combinations=tuple(
            quantity
            for quantity in (_told(entry, covariance[: len(places), : len(places)], places) for entry in told)
            if math.isfinite(quantity.standard_deviation)
        ),
        held=held,
        values=final,
        sensor=sensor,
        correlation=covariance[np.ix_(observable, observable)] / np.outer(spread, spread),
        observable=tuple(free[n].name for n in observable),
        at_bound=at_bound,
        agreement=free_run_agreement(
            run.records, run.model, valve, final,
            sensor={**sensor, SPOOL_DELAY: sensor.get(SPOOL_DELAY, 0.0) + residuals.delay},
            observation=residuals.observation,
            run_in=settings.run_in, low_cut=settings.low_cut,
        ),
        observation=read,
        information_criterion=criterion,
        effective_samples=samples,
        determinations=tuple(determinations),
        notes=_moved_starts(run.model, settings),
    )  # fmt: skip


def _without_noise(residuals: Residuals, point: Array, covariance: Array, settings: FitSettings) -> Array:
    """Return ``point`` (u,) without the effect of the excitation's noise, which ``covariance`` takes in."""
    shown = np.isfinite(np.diag(covariance))
    part = np.ix_(shown, shown)
    deviations = standard_deviations(covariance)[shown]
    effect = None
    if shown.any():
        effect = input_noise_effect(residuals, point, shown, settings.noise_seconds, deviations)
    if effect is None:
        return point
    moved = point.copy()
    moved[shown], covariance[part] = effect.taken_off(point[shown], covariance[part])
    return inside(moved, residuals.unknowns)


def _judged(
    residuals: Residuals,
    unknowns: Sequence[least_squares.Unknown],
    ended: Array,
    ends: Array,
    covariance: Array,
    unseen: Array,
    before: Sequence[Determination],
    values: Mapping[str, float],
    settings: FitSettings,
) -> list[Determination]:
    """Return the judgement at the result, nothing without one ``before``.

    Raises:
        UnusedParameterError: the law does not use a parameter.
    """
    if not before:
        return []
    names = [unknown.name for unknown in unknowns]
    found = fit_check.at_result(residuals, unknowns, ended, covariance, hidden_by_name(unseen, names), before)
    silent = {one.name for one in found if one.verdict == NOT}
    fit_check.check_applied(residuals, unknowns, ends, silent)
    if MASS not in names:
        seen = [unknown for unknown in unknowns if unknown.name not in silent]
        found += fit_check.scale_of(residuals.run, seen, values, settings)
    return found


def _told(combination: least_squares.Combination, covariance: Array, places: Sequence[int]) -> Quantity:
    gradient = combination.gradient[list(places)]
    counts = gradient != 0.0
    part = gradient[counts]
    deviation = math.sqrt(max(0.0, float(part @ covariance[np.ix_(counts, counts)] @ part)))
    return Quantity(combination.name, combination.unit, combination.value, deviation, Validity.VALID)


def _amplitude_ratios(
    simulated: Sequence[Array], measured: Sequence[Array], periods: Sequence[float]
) -> tuple[Array, Array]:
    """Return the centres of the bands and the ratio of the rms amplitudes in each."""
    highest = min(0.4 / max(periods), 500.0)
    edges = np.arange(0.5 * BAND, highest + BAND, BAND)
    powers = np.zeros((2, edges.size - 1))
    for rows, total in ((simulated, powers[0]), (measured, powers[1])):
        for row, period in zip(rows, periods, strict=True):
            spectrum = np.abs(np.fft.rfft(row * np.hanning(row.size + 2)[1:-1])) ** 2 / row.size
            place = np.digitize(np.fft.rfftfreq(row.size, period), edges) - 1
            good = (place >= 0) & (place < total.size)
            np.add.at(total, place[good], spectrum[good])
    there = powers[1] > SMALLEST_POWER * powers[1].max(initial=0.0)
    ratios = np.full(edges.size - 1, np.nan)
    ratios[there] = np.sqrt(powers[0, there] / powers[1, there])
    return 0.5 * (edges[1:] + edges[:-1]), ratios
