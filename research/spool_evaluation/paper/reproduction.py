"""Reproduction of the paper on made data: every series and model simulated and fitted."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from spool_core.system import processors

from .data import MODELS, SERIES, PaperSeries, printed_parameters
from .fit import PaperFit, fit, fit_both, fit_held
from .regimes import Regime, full_stroke
from .simulation import Plan, SteppedResponse, measure, respond

Key = tuple[int, str]
#: Of the sensors' gains and noise.
SEED = 1
#: Table 4's friction falls so steeply with speed that time steps below 1 us are needed: a shorter plan.
LOCK_PLAN = Plan(frequencies=(10.0, 40.0, 70.0, 100.0), dwell=0.2, window=0.1, sample_rate=4000.0)


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
    """Return data, printed models and fits; ``advance`` is told of each piece that is done."""
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
