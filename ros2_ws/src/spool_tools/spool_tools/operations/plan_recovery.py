"""`./spool plan --recover`: a planned record simulated with a drawn truth, fitted blind, and compared."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from spool_core.errors import InputError
from spool_core.uncertainty import LEGEND, Z_95, by_name, number, unit_text, with_interval
from spool_estimator.identification.determination import ONE_SIDED, Determination, sentences
from spool_estimator.identification.fit import fit, unknowns_of
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_estimator.record_judgement import Analysis
from spool_report import page as html
from spool_report.evidence.exhibit import AFTER, BEFORE, DARK, DASHED, WIDTH
from spool_report.outputs import write_file, write_json
from spool_report.records.simulation import find_excitation
from spool_report.terminal import progress
from spool_sim.model import Model, load_model
from spool_sim.valve import find_valve

from spool_tools.operations.record_plan import Plan, check_plan

CAPTION = (
    "95 % interval of each parameter less its truth (dashed line at 0). Circle and solid line: the interval "
    "holds the truth; square and thick dotted line: it misses. An arrow: no bound on that side."
)
HOLDS = {True: "holds", False: "MISSES", None: "no interval"}
#: Room beside the intervals of a row, as a share of their reach.
ROOM = 1.25
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
    def shown(self) -> str:
        """What the fit gives, in words: value and interval, or a bound on one side."""
        if math.isfinite(self.value):
            return with_interval(self.value, self.std, self.unit)
        if self.verdict == ONE_SIDED:
            return Determination(self.name, self.unit, self.verdict, self.low, self.high).bound
        return "no value"

    @property
    def ends(self) -> tuple[float, float] | None:
        """Ends of the 95 % interval, infinite without a bound; ``None`` where the fit gives no interval."""
        if self.verdict == ONE_SIDED:
            low = -math.inf if self.low is None else self.low
            return low, math.inf if self.high is None else self.high
        half = Z_95 * self.std
        return (self.value - half, self.value + half) if math.isfinite(self.value) else None

    @property
    def holds(self) -> bool | None:
        """Whether the 95 % interval holds the truth, ``None`` where the fit gives none."""
        return None if self.ends is None else self.ends[0] <= self.truth <= self.ends[1]


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


def recovery_page(rows: Sequence[Recovered], found: Fit, planned: Sequence[tuple[str, str]]) -> str:
    """Return the page of a blind fit; ``planned``: label and value of what the record was simulated with."""
    known = [one for one in rows if one.holds is not None]
    missed = [one.name.replace("_", " ") for one in known if not one.holds]
    held = f"{len(known) - len(missed)} of {len(known)} intervals hold the truth"
    judged = sentences(found.determinations)
    todo = (
        "Plan with another --seed: one 95 % interval in 20 misses by chance."
        if missed
        else "Record as planned. Only noise is counted: unmodelled effects of a real valve add to it."
    )
    less = "" if len(known) == len(rows) else f" {len(rows) - len(known)} of {len(rows)} have no interval."
    table = [
        {
            "parameter": one.name.replace("_", " "),
            "truth": f"{number(one.truth)}{unit_text(one.unit)}",
            "fit": one.shown,
            "interval": HOLDS[one.holds],
            "judgement": one.verdict,
        }
        for one in rows
    ]
    parts = [
        html.verdict(f"{held}{': ' + ', '.join(missed) + ' missed' if missed else ''}.{less}"),
        html.answers([("How sure", f"{LEGEND}. The fit did not know the truth."), ("What to do", todo)]),
        html.drawing(recovery_figure(rows), CAPTION, f"{held}."),
        html.heading("What the planned record determines"),
        html.listing([*judged, *found.warnings]),
        html.heading("Parameters"),
        html.table(list(table[0]), table),
    ]
    return html.page(f"Planned record, {found.model.name.replace('_', ' ')} recovered", parts, planned)


def recovery_figure(rows: Sequence[Recovered]) -> Figure:
    """Draw one row for each parameter: its interval and the estimate, less the truth."""
    figure: Figure
    figure, axes = plt.subplots(
        len(rows), 1, figsize=(WIDTH, 0.5 + 0.85 * len(rows)), layout="constrained", squeeze=False
    )
    for axis, one in zip(axes[:, 0], rows, strict=True):
        name, truth = one.name.replace("_", " "), f"{number(one.truth)}{unit_text(one.unit)}"
        axis.set_yticks([])
        axis.tick_params(labelsize=8)
        if one.ends is None:
            axis.set_title(f"{name}: no interval ({one.verdict}); truth {truth}", fontsize=9, loc="left")
            axis.set_xticks([])
            continue
        scale, across = (100.0 / abs(one.truth), ", % of it") if one.truth else (1.0, f", {one.unit}")
        title = f"{name}: {HOLDS[one.holds]}; fit less the truth of {truth}{across}"
        axis.set_title(title, fontsize=9, loc="left")
        axis.axvline(0.0, color=DARK, lw=1.2, ls=DASHED)
        axis.set_ylim(-1.0, 1.0)
        axis.grid(alpha=0.25, axis="x")
        low, high = (scale * (end - one.truth) for end in one.ends)
        reach = ROOM * max(abs(end) for end in (low, high) if math.isfinite(end)) or 1.0
        axis.set_xlim(-reach, reach)
        colour, dash, marker, width = (AFTER, "-", "o", 2.0) if one.holds else (BEFORE, ":", "s", 3.5)
        axis.plot((max(low, -reach), min(high, reach)), (0.0, 0.0), color=colour, ls=dash, lw=width)
        for end, side in ((low, "<"), (high, ">")):
            if math.isfinite(end):
                axis.plot(end, 0.0, color=colour, marker="|", ms=12, mew=2)
            else:
                axis.plot(math.copysign(reach, end), 0.0, color=colour, marker=side, ms=9, clip_on=False)
        if math.isfinite(one.value) and math.isfinite(low) and math.isfinite(high):
            axis.plot(scale * (one.value - one.truth), 0.0, color=colour, marker=marker, ms=7)
    return figure


def recover_record(
    valve: str,
    model: str,
    excitation: str,
    seconds: float,
    sample_rate: float,
    noise: float,
    seed: int,
    json: Path | None,
    report: Path | None,
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
        truth = f"{number(one.truth)}{unit_text(one.unit)}"
        print(f"  {one.name.replace('_', ' '):<28} truth {truth:<18} fit {one.shown:<28} {HOLDS[one.holds]}")
    if report is not None:
        planned = [
            ("valve", valve), ("model", chosen.name), ("seed", str(seed)),
            ("record", f"{seconds:g} s of {excitation} at {sample_rate:g} Hz, noise {noise:g} m/s² rms"),
        ]  # fmt: skip
        write_file(report, recovery_page(rows, found, planned), "--report")
        print(f"{report}: pictures and tables")
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
