"""Fits of the paper's four models by equation (33), and what of its results they reproduce."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np
from scipy.optimize import least_squares, minimize
from spool_core.numbers import Array
from spool_sim.sensors import PAPER_CHAIN
from spool_sim.terms import term

from spool_evaluation.paper.experiment import (
    MODELS,
    NOISE,
    SERIES,
    TRUTH,
    PaperSeries,
    Plan,
    SteppedResponse,
    as_measured,
    measure,
    printed_parameters,
    respond,
    truth_model,
)
from spool_evaluation.studies.workers import spread

#: Measured windows by number of series.
Data: TypeAlias = Mapping[int, SteppedResponse]
#: Number of a series and name of a model.
Key: TypeAlias = tuple[int, str]
Fits: TypeAlias = Mapping[Key, "PaperFit"]

#: m, radial clearance of table 2, which all but model 4 keep.
CLEARANCE = 15e-6
#: How many of the grid's best points a descent starts from.
STARTS = 2
#: Relative step of the slopes, wide enough that reversals move by more than rounding.
STEP = 1e-2


@dataclass(frozen=True, slots=True)
class FittedNumber:
    """Its bounds, a typical step, and where a fit starts from, in its unit."""

    name: str
    unit: str
    low: float
    high: float
    scale: float
    starts: tuple[float, ...]


GAP = FittedNumber("h", "m", 2e-6, 1e-3, 1e-5, (5e-6, 1e-5, 2e-5, 4e-5))
#: Only k_t (d_k0 - a_k0) acts in model 1: the three of table 3 cannot be distinguished.
UNKNOWNS: dict[str, tuple[FittedNumber, ...]] = {
    "microwedge": (FittedNumber("k_t (d_k0 - a_k0)", "N", 0.0, 10.0, 0.1, (0.0, 0.1, 0.4, 0.8, 1.6)),),
    "mixed": (
        FittedNumber("C1", "sqrt(s/m)", 0.0, 20.0, 0.1, (0.0, 0.1, 0.4)),
        FittedNumber("C2", "m/s", 0.0, 20.0, 1e-3, (0.0, 1e-3, 4e-3)),
    ),
    "coulomb_hydrodynamic": (
        FittedNumber("mu_0", "1", 0.0, 2.0, 0.1, (0.0, 0.1, 0.2)),
        FittedNumber("K_V", "1", -20.0, 0.95, 0.3, (-0.5, 0.0, 0.5)),
    ),
    "fluid": (GAP,),
}


@dataclass(frozen=True, slots=True)
class PaperFit:
    """Fit of one model to one series.

    Attributes:
        series: its number.
        model: name.
        free_gap: h was fitted as well, where the paper holds it at 15 um.
        names, units, values, deviations: of the fitted parameters; standard deviations from the curvature.
        objective: sum of squared weighted residuals, what (33) means.
        objective_as_printed: sum of residuals over variance, not squared, as (33) stands.
        amplitudes: of the fitted spool at each step, m/s^2.
        ratio: its mean ratio to the measured ones, a_est/a_pom.
        waveform: the fitted spool at the step nearest to 60 Hz, m/s^2.
        decrease: share of the objective that a step of Gauss and Newton promises still to take away, along
            the parameters that are not at a bound; what is far below 1 tells a converged fit.
    """

    series: int
    model: str
    free_gap: bool
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[float, ...]
    deviations: tuple[float, ...]
    objective: float
    objective_as_printed: float
    amplitudes: tuple[float, ...]
    ratio: float
    waveform: tuple[float, ...]
    decrease: float


def uncertainty(measured: SteppedResponse) -> Array:
    """Return sigma_i of (33), m/s^2, shape (steps, 1): the chain's 5 % as even bounds, and the noise."""
    gain = PAPER_CHAIN.relative_uncertainty / np.sqrt(3.0) * measured.spool_amplitudes
    return np.asarray(np.sqrt(gain**2 + NOISE**2)[:, None])


def unknowns(model: str, free_gap: bool) -> tuple[FittedNumber, ...]:
    """Return what is fitted in ``model``."""
    own = UNKNOWNS[model]
    return (*own, GAP) if free_gap and GAP not in own else own


def parameters(model: str, series: PaperSeries, values: dict[str, float]) -> dict[str, float]:
    """Return the parameters, by the suite's names, for fitted values by the paper's."""
    drag = series.drag(values.get("h", CLEARANCE))
    own = [value for name, value in values.items() if name != "h"]
    if model == "microwedge":  # one of the three carries the product, over 100 N/m
        own = [0.0, own[0] / 100.0, 100.0]
    names = next(printed.parameters for printed in MODELS if printed.name == model) if own else ()
    film = {"film_drag": drag} if model == "coulomb_hydrodynamic" else {}
    return {"viscous_coefficient": drag, **dict(zip(names, own, strict=True)), **film}


def fit_both(data: Data, key: tuple[PaperSeries, str]) -> tuple[PaperFit, ...]:
    """Return the fit with h as in table 2 and the one with h fitted, of a series and a model.

    Each starts from what it contains, too: model 3 from model 4, those with h fitted from model 4 and from
    the one with h held, so that none ends above a model that it contains. For ``fluid``, where h is the one
    unknown, there is one fit.
    """
    series, model = key
    held, measured = fit_held(data, key), data[series.number]
    if GAP in UNKNOWNS[model]:
        return (held,)
    gap = fit(series, "fluid", measured).values[0]
    none = np.array((*(0.0 for _ in UNKNOWNS[model]), gap))
    also = (np.array((*held.values, CLEARANCE)), none)
    return held, fit(series, model, measured, free_gap=True, also=also)


def fit_held(data: Data, key: tuple[PaperSeries, str]) -> PaperFit:
    """Return the fit of a model to the data of a series, h held but in model 4.

    Model 3 with mu_0 = 0 and K_V = 1 - h / gap is model 4 with that gap.
    """
    series, model = key
    measured = data[series.number]
    if model != "coulomb_hydrodynamic":
        return fit(series, model, measured)
    film, gap = UNKNOWNS[model][1], fit(series, "fluid", measured).values[0]
    inside = float(np.clip(1.0 - CLEARANCE / gap, film.low, film.high))
    return fit(series, model, measured, also=(np.array((0.0, inside)),))


def fit(
    series: PaperSeries,
    model: str,
    measured: SteppedResponse,
    *,
    free_gap: bool = False,
    also: tuple[Array, ...] = (),
) -> PaperFit:
    """Fit ``model`` to the windows of ``measured``, from the best points of a coarse grid on.

    Args:
        series: springs and oil.
        model: name of one of the four.
        measured: data.
        free_gap: fit h as well.
        also: further points to start from.
    """
    plan = as_measured(measured.plan, measured)
    sigma = uncertainty(measured)
    wanted = unknowns(model, free_gap)

    def simulated(point: Array) -> SteppedResponse:
        named = {unknown.name: float(value) for unknown, value in zip(wanted, point, strict=True)}
        return respond(series.valve, model, parameters(model, series, named), plan)

    def residuals(point: Array) -> Array:
        return np.asarray(((measured.spool - simulated(point).spool) / sigma).ravel())

    def cost(point: Array) -> float:
        return float(np.sum(residuals(point) ** 2))

    grid = sorted((np.array(point) for point in itertools.product(*(u.starts for u in wanted))), key=cost)
    starts = [*grid[:STARTS], *also]
    # A descent along slopes that sticking bends may end above its start.
    reached = min((*also, *(_descend(residuals, start, wanted) for start in starts)), key=cost)
    point = min((reached, _polish(cost, reached, wanted)), key=cost)
    best = simulated(point)
    jacobian = _jacobian(residuals, point, wanted)
    amplitudes = best.spool_amplitudes
    return PaperFit(
        series.number,
        model,
        free_gap,
        tuple(unknown.name for unknown in wanted),
        tuple(unknown.unit for unknown in wanted),
        tuple(float(value) for value in point),
        _deviations(jacobian, cost(point)),
        cost(point),
        float(np.sum((measured.spool - best.spool) / sigma**2)),
        tuple(amplitudes.tolist()),
        float(np.mean(amplitudes / measured.spool_amplitudes)),
        tuple(best.spool[waveform_step(measured)].tolist()),
        _left(jacobian, residuals(point), point, wanted),
    )


def _descend(residuals: Callable[[Array], Array], start: Array, wanted: Sequence[FittedNumber]) -> Array:
    found = least_squares(
        residuals,
        start,
        bounds=([unknown.low for unknown in wanted], [unknown.high for unknown in wanted]),
        x_scale=[unknown.scale for unknown in wanted],
        diff_step=STEP,
        xtol=1e-4,
        ftol=1e-6,
        max_nfev=12,
    )
    return np.asarray(found.x)


def _polish(cost: Callable[[Array], float], start: Array, wanted: Sequence[FittedNumber]) -> Array:
    """Return the best point around ``start``; where sticking sets in, slopes mislead a descent."""
    scale = np.array([unknown.scale for unknown in wanted])
    bounds = [(unknown.low / unknown.scale, unknown.high / unknown.scale) for unknown in wanted]
    corners = np.vstack([start / scale, start / scale + 0.1 * np.eye(scale.size)])
    found = minimize(
        lambda point: cost(point * scale),
        start / scale,
        method="Nelder-Mead",
        bounds=bounds,
        options={"maxfev": 30 * scale.size, "xatol": 1e-3, "fatol": 1.0, "initial_simplex": corners},
    )
    return np.asarray(found.x * scale)


def _jacobian(residuals: Callable[[Array], Array], point: Array, wanted: Sequence[FittedNumber]) -> Array:
    columns = []
    for place, unknown in enumerate(wanted):
        step = STEP * max(abs(float(point[place])), 0.1 * unknown.scale)
        there = point.copy()
        there[place] += step if point[place] + step <= unknown.high else -step
        columns.append((residuals(there) - residuals(point)) / (there[place] - point[place]))
    return np.array(columns).T


def _left(jacobian: Array, residual: Array, point: Array, wanted: Sequence[FittedNumber]) -> float:
    inside = [
        unknown.low + 1e-6 * unknown.scale < value < unknown.high - 1e-6 * unknown.scale
        for unknown, value in zip(wanted, point, strict=True)
    ]
    columns = jacobian[:, inside]
    if columns.shape[1] == 0:
        return 0.0
    explained = columns @ np.linalg.lstsq(columns, residual, rcond=1e-10)[0]
    return float(np.sum(explained**2) / np.sum(residual**2))


def waveform_step(measured: SteppedResponse) -> int:
    """Return the step whose frequency is nearest to 60 Hz, that of figure 13."""
    return int(np.argmin(np.abs(np.array(measured.plan.frequencies) - 60.0)))


def _deviations(jacobian: Array, objective: float) -> tuple[float, ...]:
    """Return standard deviations of the parameters; infinite where the data do not tell them."""
    rows, columns = jacobian.shape
    scale = np.linalg.norm(jacobian, axis=0)
    if not scale.all() or np.linalg.cond(jacobian / scale) > 1e10:
        return (float("inf"),) * columns
    covariance = np.linalg.inv(jacobian.T @ jacobian) * objective / max(1, rows - columns)
    return tuple(np.sqrt(np.diag(covariance)).tolist())


#: Of the sensors' gains and noise.
SEED = 1
#: Table 4's friction falls so steeply with speed that time steps below 1 us are needed: a shorter plan.
LOCK_PLAN = Plan(frequencies=(10.0, 40.0, 70.0, 100.0), dwell=0.2, window=0.1, sample_rate=4000.0)


#: m, full stroke that the paper's conclusions name, for a spool that oscillates at 60 Hz.
STROKE = 9e-3
#: Highest frequency at which the text names that stroke, Hz.
HIGHEST = 60.0


@dataclass(frozen=True)
class Reproduction:
    """Reproduction of the paper, by series number and model name."""

    plan: Plan
    data: Data
    printed: Mapping[Key, SteppedResponse]
    fits: Fits
    free: Fits
    full: Regime


def reproduce(plan: Plan) -> Reproduction:
    """Return data, printed models and fits."""
    data = {series.number: measure(series, plan, SEED) for series in SERIES}
    large = {series.number: measure(series, full_stroke(series, plan), SEED) for series in SERIES}
    printed = {}
    for series, model in itertools.product(SERIES, MODELS):
        at = LOCK_PLAN if model.name == "mixed" else plan
        values = printed_parameters(model, series)
        printed[series.number, model.name] = respond(series.valve, model.name, values, at)
    keys = [(series, model.name) for model in MODELS for series in SERIES]
    both = [one for found in spread(partial(fit_both, data), keys, "fits") for one in found]
    held = _by_key(one for one in both if not one.free_gap)
    stroked = spread(partial(fit_held, large), keys, "fits at full stroke")
    full = Regime("full stroke", large, _by_key(stroked))
    return Reproduction(plan, data, printed, held, _by_key(one for one in both if one.free_gap), full)


def _by_key(fits: Iterable[PaperFit]) -> dict[Key, PaperFit]:
    return dict(sorted(((one.series, one.model), one) for one in fits))


def locked(results: Reproduction) -> dict[str, bool]:
    """Return, by series, whether table 4's values leave the spool at rest in the body: a_spool = a_body."""
    answer = {}
    for series in SERIES:
        response = results.printed[series.number, "mixed"]
        answer[series.label] = bool(np.array_equal(response.body, response.spool))
    return answer


@dataclass(frozen=True)
class Regime:
    """Data and fits of one regime of motion, by series number and model name; h is held but in model 4."""

    name: str
    data: Data
    fits: Fits


def full_stroke(series: PaperSeries, plan: Plan) -> Plan:
    """Return ``plan`` up to 60 Hz, the body shaken so that with fluid friction alone each step has STROKE.

    Body acceleration a and relative displacement z of m z'' + c z' + k z = -m a: abs(a) = abs(z) abs(k -
    m w^2 + i w c) / m.
    """
    frequencies = tuple(frequency for frequency in plan.frequencies if frequency <= HIGHEST)
    omega = 2.0 * np.pi * np.array(frequencies)
    valve = series.valve
    stiffness = np.abs(
        valve.spring_stiffness - valve.moving_mass * omega**2 + 1j * omega * valve.viscous_coefficient
    )
    amplitudes = 0.5 * STROKE * stiffness / valve.moving_mass
    return replace(plan, frequencies=frequencies, amplitudes=tuple(amplitudes.tolist()))


def force_table(plan: Plan) -> list[dict[str, object]]:
    """Return, by regime and series at the step nearest to 60 Hz, the rms of each force and the mean speed.

    Forces are those of the truth without sensors, from the fundamental of the relative motion; that of dry
    friction is its law over one period, the level at rest where the spool sticks.
    """
    rows: list[dict[str, object]] = []
    for regime, large in (("small accelerations", False), ("full stroke", True)):
        for series in SERIES:
            own = full_stroke(series, plan) if large else plan
            step = int(np.argmin(np.abs(np.array(own.frequencies) - HIGHEST)))
            response = respond(series.valve, truth_model(), {}, own)
            omega = 2.0 * math.pi * own.frequencies[step]
            relative = response.spool[step] - response.body[step]
            turns = np.exp(-1j * omega * np.arange(relative.size) / own.sample_rate)
            speed = abs(complex(np.mean(2.0 * relative * turns))) / omega
            valve = series.valve
            viscous = valve.viscous_coefficient * speed / math.sqrt(2.0)
            dry = _dry(speed)
            rows.append(
                {
                    "regime": regime,
                    "series": series.label,
                    "frequency (Hz)": own.frequencies[step],
                    "stroke (mm)": 2e3 * speed / omega,
                    "mean speed (m/s)": 2.0 * speed / math.pi,
                    "spring (N rms)": valve.spring_stiffness * speed / omega / math.sqrt(2.0),
                    "fluid friction (N rms)": viscous,
                    "dry friction (N rms)": dry,
                    "fluid share of friction": viscous / (viscous + dry),
                }
            )
    return rows


def ranking_table(regimes: tuple[Regime, ...]) -> list[dict[str, object]]:
    """Return, by model, the mean objective per sample, the rank and a_est/a_pom in each regime."""
    rows: list[dict[str, object]] = [{"model": f"{model.number} {model.equation}"} for model in MODELS]
    for regime in regimes:
        fits = [[regime.fits[series.number, model.name] for series in SERIES] for model in MODELS]
        sizes = [regime.data[series.number].spool.size for series in SERIES]
        means = [
            float(np.mean([one.objective / size for one, size in zip(of_model, sizes, strict=True)]))
            for of_model in fits
        ]
        for row, of_model, mean in zip(rows, fits, means, strict=True):
            row[f"objective per sample, {regime.name}"] = mean
            row[f"rank, {regime.name}"] = 1 + sum(other < mean for other in means)
            row[f"a_est/a_pom, {regime.name}"] = float(np.mean([one.ratio for one in of_model]))
    return rows


def verdict(rows: list[dict[str, object]]) -> str:
    """Return sentences on the ranks of :func:`ranking_table` in each regime, and what they do not tell."""
    said = []
    for name in (column.removeprefix("rank, ") for column in rows[0] if column.startswith("rank, ")):
        order = sorted(rows, key=lambda row: int(str(row[f"rank, {name}"])))
        explained = [
            str(row["model"]) for row in order if float(str(row[f"objective per sample, {name}"])) < 1.0
        ]
        said.append(f"{name.capitalize()}, the best first: {', '.join(str(row['model']) for row in order)}.")
        if len(explained) > 1:
            said.append(
                f"There {', '.join(explained)} leave less than the chain's uncertainty (objective per sample "
                "below 1), so that their order tells nothing."
            )
    return " ".join(said)


def _dry(speed: float) -> float:
    """Return the rms of the truth's dry friction, N, over a period of a sine of velocity ``speed``, m/s."""
    velocity, none = speed * np.sin(2.0 * np.pi * (np.arange(1000) + 0.5) / 1000.0), np.zeros(1000)
    force = term("stribeck_friction").force(none, velocity, none, {**TRUTH, "stribeck_exponent": 2.0})
    return float(np.sqrt(np.mean(force**2)))
