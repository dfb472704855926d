"""`./spool plan --recover`: a planned record simulated with a drawn truth, fitted blind, and compared."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from spool_core.errors import InputError
from spool_core.uncertainty import LEGEND, Z_95, by_name, number, unit_text, with_interval
from spool_estimator.identification.determination import ONE_SIDED, Determination, sentences
from spool_estimator.identification.fit import fit, unknowns_of
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_estimator.record_judgement import Analysis
from spool_report.outputs import write_json
from spool_report.records.simulation import find_excitation
from spool_report.terminal import progress
from spool_sim.model import Model, load_model
from spool_sim.valve import find_valve

from spool_tools.operations.record_plan import Plan, check_plan

#: Shares of its start value between which the true stiffness is drawn, and factors for other parameters.
STIFFNESS, OTHERS = (0.9, 1.1), (0.7, 1.4)


@dataclass(frozen=True, slots=True)
class Recovered:
    """What the blind fit finds of a parameter whose ``truth`` is known; NaN where it gives no value."""

    JSON_PROPERTIES: ClassVar = ("holds",)

    name: str
    unit: str
    truth: float
    value: float
    std: float
    verdict: str
    low: float | None
    high: float | None

    @property
    def holds(self) -> bool | None:
        """Whether the 95 % interval holds the truth, ``None`` where the fit gives none."""
        if self.verdict == ONE_SIDED:
            low = -math.inf if self.low is None else self.low
            return low <= self.truth <= (math.inf if self.high is None else self.high)
        return abs(self.value - self.truth) <= Z_95 * self.std if math.isfinite(self.value) else None


def drawn_truth(plan: Plan, model: Model) -> dict[str, float]:
    """Return parameters near those of the plan's valve, drawn by its seed; a fit does not know them."""
    generator = np.random.default_rng([plan.seed, 1])
    described = model.values_for(plan.valve, plan.values({}))
    truth = {}
    for unknown in unknowns_of(model, plan.valve, FitSettings()):
        low, high = STIFFNESS if unknown.name == "spring_stiffness" else OTHERS
        drawn = described[unknown.name] * float(np.exp(generator.uniform(math.log(low), math.log(high))))
        truth[unknown.name] = min(max(drawn, unknown.low), unknown.high)
    return truth


def recovered(plan: Plan, model: Model) -> tuple[list[Recovered], Fit]:
    """Return truth and interval of each parameter, and the blind fit of the simulated record.

    Raises:
        InputError: excitation and sample rate do not fit.
    """
    truth = drawn_truth(plan, model)
    # The simulated sensors sample at one instant, as a planned logger is supposed to.
    settings = FitSettings(timing=0.0, check=True)
    with progress(f"recovering {model.name}", settings.allowed, at_most=True) as tell:
        found = fit([plan.record(model, truth)], model, plan.valve, settings, tell)
    return compared(found, truth), found


def compared(found: Fit, truth: Mapping[str, float]) -> list[Recovered]:
    """Return each fitted parameter beside its ``truth``."""
    judged: dict[str, Determination] = {one.name: one for one in found.determinations}
    return [
        Recovered(
            one.name, one.unit, truth[one.name], one.value, one.standard_deviation,
            judged[one.name].verdict, judged[one.name].low, judged[one.name].high,
        )
        for one in found.parameters
    ]  # fmt: skip


def recover_record(
    valve: str,
    model: str,
    excitation: str,
    seconds: float,
    sample_rate: float,
    noise: float,
    seed: int,
    json: Path | None,
) -> int:
    """Show truth and interval of each parameter; return 1 where an interval misses or no fit ends.

    Raises:
        InputError: valve, model, excitation or numbers cannot be used.
    """
    chosen, described = load_model(model), find_valve(valve)
    check_plan(Analysis.ESTIMATE, seconds, sample_rate, described)
    plan = Plan(described, find_excitation(excitation), seconds, sample_rate, noise, seed)
    rows, found = recovered(plan, chosen)
    if found.reason is not None:
        raise InputError(f"--recover: the simulated record cannot be fitted: {found.reason}")
    if json is not None:
        write_json(json, _dictionary(plan, valve, excitation, rows, found))
    for line in sentences(found.determinations):
        print(line)
    print(LEGEND)
    for one in rows:
        value = "no value" if math.isnan(one.value) else with_interval(one.value, one.std, one.unit)
        holds = {True: "holds", False: "MISSES", None: "no interval"}[one.holds]
        truth = f"{number(one.truth)}{unit_text(one.unit)}"
        print(f"  {one.name.replace('_', ' '):<28} truth {truth:<18} fit {value:<28} {holds}")
    return 1 if any(one.holds is False for one in rows) else 0


def _dictionary(plan: Plan, valve: str, excitation: str, rows: list[Recovered], found: Fit) -> dict[str, Any]:
    return {
        "valve": valve,
        "model": found.model.name,
        "plan": {
            "seconds": plan.seconds,
            "sample_rate_Hz": plan.sample_rate,
            "noise": plan.noise,
            "excitation": excitation,
            "seed": plan.seed,
        },
        "recovered": by_name(rows),
        "determined": by_name(found.determinations),
    }
