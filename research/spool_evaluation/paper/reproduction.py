"""Reproduction of the paper on made data: every series and model simulated and fitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from spool_core.system import processors
from spool_sim.terms import term

from spool_evaluation.paper.data import MODELS, SERIES, PaperSeries, printed_parameters
from spool_evaluation.paper.fit import PaperFit, fit, fit_both, fit_held
from spool_evaluation.paper.simulation import TRUTH, Plan, SteppedResponse, measure, respond, truth_model

Key = tuple[int, str]
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
    data: dict[int, SteppedResponse]
    printed: dict[Key, SteppedResponse]
    fits: dict[Key, PaperFit]
    free: dict[Key, PaperFit]
    full: Regime


def reproduce(plan: Plan, advance: Callable[[float], None]) -> Reproduction:
    """Return data, printed models and fits; ``advance`` is called for each finished piece."""
    data: dict[int, SteppedResponse] = {}
    printed: dict[Key, SteppedResponse] = {}
    for series in SERIES:
        data[series.number] = measure(series, plan, SEED)
        for model in MODELS:
            values = printed_parameters(model, series)
            at = LOCK_PLAN if model.name == "mixed" else plan
            printed[series.number, model.name] = respond(series.valve, model.name, values, at)
        advance(1.0)
    fits: dict[Key, PaperFit] = {}
    free: dict[Key, PaperFit] = {}
    # Fresh processes: threads of the libraries do not survive a fork.
    with ProcessPoolExecutor(min(4, processors()), mp_context=get_context("spawn")) as pool:
        waiting = [
            pool.submit(fit_both, series, model.name, data[series.number])
            for model in MODELS
            for series in SERIES
        ]
        large = {series.number: measure(series, full_stroke(series, plan), SEED) for series in SERIES}
        stroked = [pool.submit(fit_all, series, large[series.number]) for series in SERIES]
        for done in as_completed(waiting):
            for found in done.result():
                (free if found.free_gap else fits)[found.series, found.model] = found
            advance(1.0)
        found_full: dict[Key, PaperFit] = {}
        for done_full in as_completed(stroked):
            found_full |= {(found.series, found.model): found for found in done_full.result()}
            advance(1.0)
    return Reproduction(plan, data, printed, fits, free, Regime("full stroke", large, found_full))


def fit_all(series: PaperSeries, measured: SteppedResponse) -> list[PaperFit]:
    """Return the fits of all four models to one series, h held at table 2's value but in model 4."""
    fluid = fit(series, "fluid", measured)
    others = [model.name for model in MODELS if model.name != "fluid"]
    return [fluid, *(fit_held(series, name, measured, fluid.values[0]) for name in others)]


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
    data: Mapping[int, SteppedResponse]
    fits: Mapping[tuple[int, str], PaperFit]


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
        means = [
            float(
                np.mean(
                    [
                        regime.fits[series.number, model.name].objective
                        / regime.data[series.number].spool.size
                        for series in SERIES
                    ]
                )
            )
            for model in MODELS
        ]
        for row, model, mean in zip(rows, MODELS, means, strict=True):
            ratios = [regime.fits[series.number, model.name].ratio for series in SERIES]
            row[f"objective per sample, {regime.name}"] = mean
            row[f"rank, {regime.name}"] = 1 + sum(other < mean for other in means)
            row[f"a_est/a_pom, {regime.name}"] = float(np.mean(ratios))
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
