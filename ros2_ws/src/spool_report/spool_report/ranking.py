"""Ranking of models: each fitted and validated, and which one the data prefer.

Models are compared by what the logger reads of them, each with the filter that fits it best. Of samples at
instants those beside a jump of dry friction are left out, the same ones for every model: chance decides on
which side of the jump they are.

With many samples almost any further term is significant without mattering. So a term must earn its place: of
the models whose error is about the least, the one with the fewest parameters is preferred. One whose numbers
make no sense on a machine is not: a law may stand for what else a record holds, as the shape of a logger's
filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_estimator.identification.fit import fit, free_run_agreement
from spool_estimator.identification.fit_result import Agreement, Fit, FitSettings
from spool_estimator.identification.record import Record
from spool_estimator.identification.residuals import apart
from spool_gap.catalogue import EFFECTS
from spool_sim.model import Model
from spool_sim.observation import INSTANTS

from spool_report.fit_curves import Overlay, overlay, sensor_noise
from spool_report.records.record_loading import FitData
from spool_report.terminal import spoken

#: By how much a larger model must cut the error, 1.
WORTH = 0.03
#: How many times the sensor's noise is more than noise: the body's sensor shakes the model as well.
UNEXPLAINED = 3.0

#: Difference of BIC up to which it is "not worth more than a bare mention": Kass and Raftery, 1995, 3.2.
MENTIONED = 2.0
#: How many times a descent that has not converged goes on.
ROUNDS = 2


@dataclass(frozen=True, slots=True)
class FittedSeries:
    """One set of data and every model fitted to it."""

    data: FitData
    validated: tuple[ValidatedFit, ...]

    def doubt(self, place: int) -> str:
        """Return why a model's numbers make no sense on a machine, if a law that it contains is beside it."""
        found, narrow = self.validated[place].fit, self.validated[place].fit.model.narrower()
        if narrow is None or not any(one.fit.model.terms == narrow.terms for one in self.validated):
            return ""
        known = {one.name: one.standard_deviation for one in found.parameters}
        deviations = {name: value for name, value in known.items() if math.isfinite(value)}
        laws = (EFFECTS[one.name] for one in found.model.terms if one.name in EFFECTS)
        return next(filter(None, (law.sensible(found.values, deviations) for law in laws)), "")


@dataclass(frozen=True, slots=True)
class Rank:
    """Rank of a model over all series.

    Attributes:
        model: name.
        parameters: fitted in one series.
        criterion: the fits' information criterion, summed over the series; NaN where one has no result.
        error: residual away from jumps, rms, m/s^2: on held-out data where there are any.
        excess: ``error`` over the least of all models that may be preferred, less 1.
        objective: the paper's (33), mean over the series.
        amplitude_ratio: amplitude of the model over the measured one, mean over the series.
        training_error, held_out_error: nrmse with every sample, mean over the series; NaN where not known.
        reason: why there is no result, ``None`` where there is one in every series.
        doubt: why its numbers make no sense on a machine where a law that it contains is beside it, or "".
    """

    model: str
    parameters: int
    criterion: float
    error: float
    excess: float
    objective: float
    amplitude_ratio: float
    training_error: float
    held_out_error: float
    reason: str | None
    doubt: str = ""


@dataclass(frozen=True, slots=True)
class Ranking:
    """Ranking of all models, best first.

    Attributes:
        ranks: first those that do equally well, fewest parameters first, then the next that do, and so on.
        preferred: name of the best, ``None`` where no model has a result.
        equal: names of those that do as well with as many parameters or more.
        sentences: the outcome in words.
    """

    ranks: tuple[Rank, ...]
    preferred: str | None
    equal: tuple[str, ...]
    sentences: tuple[str, ...]

    @property
    def least_criterion(self) -> float:
        """Least information criterion of all, NaN where no model has one."""
        return min((one.criterion for one in self.ranks if math.isfinite(one.criterion)), default=math.nan)


def rank(series: Sequence[FittedSeries]) -> Ranking:
    """Return the ranking of models, each fitted to every one of ``series``."""
    unseen = [_left(one, one.data.held_out) for one in series]
    held = all(any(row is not None and row.size for row in rows) for rows in unseen)
    counted = unseen if held else [_left(one, one.data.fitted) for one in series]
    found = []
    for place, first in enumerate(series[0].validated):
        own = [one.validated[place] for one in series]
        reason = next((entry.fit.reason for entry in own if entry.fit.reason is not None), None)
        agreements = [entry.fit.agreement for entry in own]
        rows = [row for every in counted if (row := every[place]) is not None]
        together = np.concatenate(rows) if len(rows) == len(counted) else np.empty(0)
        found.append(
            Rank(
                first.name,
                len(first.fit.parameters),
                sum(entry.fit.information_criterion for entry in own),
                math.sqrt(float(np.mean(together**2))) if together.size else math.nan,
                math.nan,
                float(np.mean([math.nan if entry is None else entry.objective for entry in agreements])),
                float(
                    np.mean([math.nan if entry is None else entry.amplitude_ratio for entry in agreements])
                ),
                float(np.mean([entry.training_error for entry in own])),
                float(np.mean([entry.held_out_error for entry in own])),
                reason,
                "" if reason else next(filter(None, (one.doubt(place) for one in series)), ""),
            )
        )
    noise = max((sensor_noise(one.data.fitted) for one in series), default=math.nan)
    fits = [entry.fit for one in series for entry in one.validated]
    unsure = {one.model.name for one in fits if one.reason is None and not one.converged}
    return ordered(found, noise, unsure)


def ordered(found: Sequence[Rank], noise: float = math.nan, unsure: Collection[str] = ()) -> Ranking:
    """Return ``found`` in order, with ``excess`` filled in.

    One whose numbers make no sense is behind those that it would beat.

    Args:
        found: in any order.
        noise: rms of the spool's accelerometer at most, m/s^2, NaN where it is not known.
        unsure: names of models whose descent did not converge.
    """
    finite = [entry for entry in found if math.isfinite(entry.error)]
    sensible = [entry for entry in finite if not entry.doubt] or finite
    least = min((entry.error for entry in sensible), default=math.nan)
    known = [replace(entry, excess=entry.error / least - 1.0) for entry in found]
    lost = [entry for entry in known if math.isnan(entry.excess)]
    behind = [entry for entry in known if (1.0 + WORTH) * entry.error < least]
    left = [entry for entry in known if entry not in behind and not math.isnan(entry.excess)]
    groups: list[list[Rank]] = []
    while left:
        limit = (1.0 + WORTH) * min(entry.error for entry in left)
        alike = sorted(
            (entry for entry in left if entry.error <= limit), key=lambda one: (one.parameters, one.error)
        )
        groups.append(alike)
        left = [entry for entry in left if entry.error > limit]
    ranks = (*(entry for group in groups for entry in group), *behind, *lost)
    if not groups:
        return Ranking(ranks, None, (), ("No model has a result on these data.",))
    equal, worse = groups[0], [entry for group in groups[1:] for entry in group]
    odd = (
        f"{_names(one)} leaves {-100.0 * one.excess:.0f} % less error, but its numbers make no sense on a "
        f"machine: {one.doubt}."
        for one in behind
    )
    said = (*_sentences(equal, worse, lost, noise, unsure), *odd)
    return Ranking(ranks, ranks[0].model, tuple(entry.model for entry in equal[1:]), said)


def residuals(run: Overlay) -> list[Array]:
    """Return model - measured in each window, m/s^2."""
    return [
        response.acceleration[0] - window.measured
        for response, window in zip(run.responses, run.run.windows, strict=True)
    ]


def away_from_jumps(runs: Sequence[Overlay | None]) -> list[NDArray[np.bool_]]:
    """Return by window which samples count: of samples at instants those beside no jump of the best run."""
    known = [run for run in runs if run is not None]
    if not known:
        return []
    best = min(known, key=lambda run: sum(float(np.sum(row**2)) for row in residuals(run)))
    if best.observation.kind == INSTANTS:
        return [apart(response) for response in best.responses]
    return [np.ones(response.acceleration.shape[1], dtype=np.bool_) for response in best.responses]


@dataclass(frozen=True, slots=True)
class ValidatedFit:
    """Fit, and how it does on data that it has not seen, ``None`` where there are none."""

    data: FitData
    fit: Fit
    held_out: Agreement | None

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.fit.model.name

    @property
    def training_error(self) -> float:
        """Nrmse on the fitted data, NaN without a result."""
        return math.nan if self.fit.agreement is None else self.fit.agreement.nrmse

    @property
    def held_out_error(self) -> float:
        """Nrmse on held-out data, NaN without any."""
        return math.nan if self.held_out is None else self.held_out.nrmse


def fit_and_validate(
    data: FitData, model: Model, settings: FitSettings, tell: Callable[[float], None] = lambda _steps: None
) -> ValidatedFit:
    """Return ``model`` fitted to the data and its agreement with what was held out; ``tell``: as of ``fit``.

    Raises:
        InputError: the settings do not fit the model.
    """
    # A fit that goes on from where it stopped until it converges, ROUNDS times at most.
    found = fit(data.fitted, model, data.valve, settings, tell)
    for _ in range(ROUNDS):
        if found.converged or found.stopped_early or found.reason is not None:
            break
        # Bounds are of the model: what is fitted lies within them.
        reached = {name: value for name, value in found.values.items() if name not in found.held}
        further = fit(data.fitted, model, data.valve, replace(settings, start=reached, starts=1))
        if further.agreement is None:
            break
        found = replace(further, notes=found.notes)
    return validated(data, found, settings)


def no_worse(data: FitData, fits: Sequence[ValidatedFit], settings: FitSettings) -> list[ValidatedFit]:
    """Return ``fits`` of one set of data, none worse on it than that of a model which its model contains.

    A fit that is worse ended beside its optimum: it is made again from where the other one ended.
    """
    best = list(fits)
    for place in sorted(range(len(best)), key=lambda at: len(best[at].fit.model.parameters)):
        for other in list(best):
            wide = best[place].fit
            start = wide.model.values_as(other.fit.model, other.fit.values, data.valve)
            worse = wide.reason is not None or other.training_error < best[place].training_error
            if start is None or other.fit.reason is not None or not worse:
                continue
            free = {name: value for name, value in start.items() if name not in wide.held}
            again = fit_and_validate(data, wide.model, replace(settings, start=free, starts=1))
            if again.fit.reason is None and not again.training_error > best[place].training_error:
                best[place] = replace(again, fit=replace(again.fit, notes=wide.notes))
    return best


def validated(data: FitData, found: Fit, settings: FitSettings) -> ValidatedFit:
    """Return a fit with its agreement with what was held out of ``data``."""
    held_out = None
    if found.agreement is not None and data.held_out:
        with suppress(InputError):  # every held-out stretch is shorter than what settling takes
            held_out = free_run_agreement(
                data.held_out, found.model, data.valve, found.values, sensor=found.sensor,
                observation=found.observation, run_in=settings.run_in, low_cut=settings.low_cut,
            )  # fmt: skip
    return ValidatedFit(data, found, held_out)


def natural_frequency(found: Fit) -> float:
    """Return the undamped natural frequency, Hz, NaN where the stiffness is not known."""
    mass, stiffness = found.values.get("mass", math.nan), found.values.get("spring_stiffness", math.nan)
    if found.reason is not None or "spring_stiffness" in found.not_observable:
        return math.nan
    return math.sqrt(stiffness / mass) / (2.0 * math.pi)


def damping_ratio(found: Fit) -> float:
    """Return the share of critical damping of the viscous drag alone, NaN where it is not known."""
    drag = found.values.get("viscous_coefficient", math.nan)
    frequency = natural_frequency(found)
    if "viscous_coefficient" in found.not_observable or not frequency > 0.0:
        return math.nan
    return drag / (4.0 * math.pi * frequency * found.values["mass"])


def _sentences(
    equal: Sequence[Rank], worse: Sequence[Rank], lost: Sequence[Rank], noise: float, unsure: Collection[str]
) -> tuple[str, ...]:
    best = equal[0]
    said = []
    twins = [entry for entry in equal[1:] if entry.parameters == best.parameters]
    larger = [entry for entry in equal[1:] if entry.parameters > best.parameters]
    if twins:
        said.append(
            f"{_names(best, *twins)} cannot be distinguished on these data: the same number of parameters, "
            f"and errors within {100.0 * WORTH:g} %."
        )
    elif worse:
        ratio = worse[0].error / best.error
        more = f"{ratio:.1f} times as much" if ratio >= 2.0 else f"{100.0 * (ratio - 1.0):.0f} % more"
        said.append(
            f"{_names(best)} is preferred: the next different model, {_names(worse[0])}, leaves {more} error."
        )
    else:
        said.append(
            f"{_names(best)} is preferred: none that makes sense does better; it has the fewest parameters."
        )
    if larger:
        verb = "fits" if len(larger) == 1 else "fit"
        few, most = (
            extreme(entry.parameters for entry in larger) - best.parameters for extreme in (min, max)
        )
        said.append(
            f"{_names(*larger)} {verb} equally well with {few if few == most else f'{few} to {most}'} more "
            f"parameter{'s' if most > 1 else ''}; the data do not justify this."
        )
    known = [entry for entry in (*equal, *worse) if math.isfinite(entry.criterion)]
    certain = min(known, key=lambda one: one.criterion, default=best)
    if best.criterion - certain.criterion > MENTIONED:
        cut = 1.0 - certain.error / best.error
        less = f"reduces the error by only {100.0 * cut:.1f} %" if cut > 0.0 else "does not reduce the error"
        said.append(
            f"The information criterion alone, which takes each model's own residual for its noise, prefers "
            f"{_names(certain)}, by {best.criterion - certain.criterion:.0f}; {_names(certain)} {less}, and "
            "the error decides."
        )
    if best.error > UNEXPLAINED * noise:
        said.append(
            f"Even {_names(best)} leaves {best.error / noise:.1f} times the noise of the spool's sensor: "
            "something is missing in all of these models; ./spool gap looks for it."
        )
    doubtful = [entry for entry in (*equal, *worse) if entry.model in unsure]
    if doubtful:
        said.append(f"{_names(*doubtful)} did not converge: might do better.")
    said += [f"{_names(entry)} has no result: {entry.reason}." for entry in lost]
    return tuple(said)


def _names(*entries: Rank) -> str:
    *others, last = (spoken(entry.model) for entry in entries)
    return f"{', '.join(others)} and {last}" if others else last


def _left(series: FittedSeries, records: Sequence[Record]) -> list[Array | None]:
    """Return what each model leaves of ``records``, m/s^2, away from jumps of the one that leaves least."""
    runs: list[Overlay | None] = []
    for validated in series.validated:
        try:
            usable = validated.fit.reason is None
            runs.append(overlay(records, validated.fit, series.data.valve) if usable and records else None)
        except InputError:  # too short for the model's run-in
            runs.append(None)
    kept = away_from_jumps(runs)
    return [
        None if run is None else np.concatenate([
            row[keep] for row, keep in zip(residuals(run), kept, strict=True)
        ])
        for run in runs
    ]  # fmt: skip
