"""Study of the check before a fit: do intervals hold the truth, and does the other half of a record agree?

`cases` records of drawn valves are fitted without the truth. Half as many are drawn with excitations that
cannot determine all parameters (one frequency, weak shaking), fitted in two halves each, and the intervals of
the halves compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from spool_core.uncertainty import Z_95, Quantity, percent
from spool_estimator.identification.determination import IDENTIFIABLE, ONE_SIDED
from spool_estimator.identification.fit import fit, unknowns_of
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_report.outputs import write_json
from spool_sim.excitation import Excitation, Multisine, SteadySine, SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.valve import find_valve
from spool_tools.operations.record_plan import Plan

from spool_evaluation.results.page import markdown_table, save_picture, study_command, write_page
from spool_evaluation.studies.workers import spread

MODEL_NAMES = ("coulomb", "fluid", "fluid_quadratic_damping", "fluid_cubic_stiffness")
SPRINGS = ("4weh10_soft", "4weh10_stiff")
#: s and Hz: short records, so that hundreds take minutes.
SECONDS, SAMPLE_RATE = 10.0, 1000.0
#: m/s^2, noise of each sensor.
NOISE = (0.02, 0.2)
#: Shares of its start value between which the true stiffness is drawn, and factors for other parameters.
STIFFNESS, OTHERS = (0.9, 1.1), (0.7, 1.4)
PAGE, PICTURE = "check_study.md", "check_study.png"


@dataclass(frozen=True, slots=True)
class Recovered:
    """What a fit that does not know the ``truth`` of a parameter finds of it; NaN where it gives no value."""

    JSON_PROPERTIES: ClassVar = ("holds",)

    name: str
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


@dataclass(frozen=True, slots=True)
class Halves:
    """How far two halves of a record differ in a parameter that both determine.

    Attributes:
        model, excitation, name: of the record and the parameter.
        difference: of the values over its standard deviation.
    """

    model: str
    excitation: str
    name: str
    difference: float

    @property
    def contradicted(self) -> bool:
        """Whether they differ by more than 95 of 100 do by chance."""
        return self.difference > Z_95


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[Recovered]:
    """Recover ``cases`` valves, split half as many records; write rows and table into ``out``."""
    items = [(seed, number) for number in range(cases)]
    rows = [one for found in spread(recover_case, items, f"{cases} recovered", workers) for one in found]
    pairs = items[: max(1, cases // 2)]
    split = [one for found in spread(split_case, pairs, f"{len(pairs)} split", workers) for one in found]
    write_json(out / "check.json", {"recovered": rows, "halves": split})
    save_picture(picture(rows, split), out / PICTURE)
    page = write_page(
        out / PAGE, "Check before a fit", study_command("check", cases, seed), parts(rows, split, cases)
    )
    print(page.read_text(encoding="utf-8"))
    return rows


def parts(rows: Sequence[Recovered], split: Sequence[Halves], cases: int) -> list[str]:
    """Return the paragraphs of the page."""
    judged = [one for one in rows if one.holds is not None]
    held = sum(bool(one.holds) for one in judged)
    missed = sum(one.contradicted for one in split)
    names = list(dict.fromkeys(one.name for one in rows))
    table = [
        (f"`{name}`", str(len(own)), str(len(given)), f"{sum(bool(one.holds) for one in given)}")
        for name in names
        for own in ([one for one in rows if one.name == name],)
        for given in ([one for one in own if one.holds is not None],)
    ]
    return [
        f"Recovery: of {cases} drawn valves ({', '.join(MODEL_NAMES)}; both springs; {SECONDS:g} s at "
        f"{SAMPLE_RATE:g} Hz; noise of {NOISE[0]:g} to {NOISE[1]:g} m/s^2), {held} of {len(judged)} 95 % "
        f"intervals hold the truth: {percent(held / max(1, len(judged)))}.",
        markdown_table(("parameter", "fits", "with an interval", "hold the truth"), table),
        f"![errors over their standard deviations]({PICTURE})",
        f"Halves: {max(1, cases // 2)} records with a sweep, a weak multisine or one frequency, each fitted "
        f"in two halves. Of {len(split)} parameters that both halves determine, the intervals contradict "
        f"each other in {missed}: {percent(missed / max(1, len(split)))}; 5 % do by chance.",
    ]


def picture(rows: Sequence[Recovered], split: Sequence[Halves]) -> Figure:
    """Return how often errors and differences stay within so many standard deviations."""
    figure: Figure
    figure, axis = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    errors = [abs(one.value - one.truth) / one.std for one in rows if one.holds is not None and one.std > 0.0]
    for sizes, label in (
        (errors, "fit less truth"),
        ([one.difference for one in split], "one half less the other"),
    ):
        axis.plot(np.sort(sizes), 100.0 * np.arange(1, len(sizes) + 1) / max(1, len(sizes)), label=label)
    deviations = np.linspace(0.0, 4.0, 81)
    axis.plot(
        deviations, [100.0 * math.erf(one / math.sqrt(2.0)) for one in deviations], "k:", label="normal"
    )
    axis.axvline(Z_95, color="0.6", lw=0.8)
    axis.set(xlim=(0.0, 4.0), ylim=(0.0, 101.0), xlabel="standard deviations", ylabel="share within, %")
    axis.legend()
    return figure


def recover_case(item: tuple[int, int]) -> list[Recovered]:
    """Fit the record of the valve that ``item``, seed and number, stands for, without its truth."""
    plan, name = planned(item, weak=False)
    truth = drawn_truth(plan, MODELS[name])
    # The simulated sensors sample at one instant, as a planned logger is supposed to.
    settings = FitSettings(timing=0.0, check=True)
    found = fit([plan.record(MODELS[name], truth)], MODELS[name], plan.valve, settings)
    judged = {one.name: one for one in found.determinations}
    return [
        Recovered(
            one.name, truth[one.name], one.value, one.standard_deviation,
            judged[one.name].verdict, judged[one.name].low, judged[one.name].high,
        )
        for one in found.parameters
    ]  # fmt: skip


def drawn_truth(plan: Plan, model: Model) -> dict[str, float]:
    """Return parameters near those of the plan's valve, drawn by its seed."""
    generator = np.random.default_rng([plan.seed, 1])
    described = model.values_for(plan.valve, plan.values({}))
    truth = {}
    for unknown in unknowns_of(model, plan.valve, FitSettings()):
        low, high = STIFFNESS if unknown.name == "spring_stiffness" else OTHERS
        drawn = described[unknown.name] * float(np.exp(generator.uniform(math.log(low), math.log(high))))
        truth[unknown.name] = min(max(drawn, unknown.low), unknown.high)
    return truth


def split_case(item: tuple[int, int]) -> list[Halves]:
    """Fit both halves of the record that ``item``, seed and number, stands for."""
    plan, model = planned(item, weak=True)
    record = plan.record(MODELS[model], drawn_truth(plan, MODELS[model]))
    middle = record.body.size // 2
    settings = FitSettings(timing=0.0, check=True)
    halves = (record.part(0, middle), record.part(middle, record.body.size))
    fits = [fit([half], MODELS[model], plan.valve, settings) for half in halves]
    return [
        Halves(model, type(plan.excitation).__name__, name, difference)
        for name, difference in _differences(*fits).items()
    ]


def planned(item: tuple[int, int], *, weak: bool) -> tuple[Plan, str]:
    """Return plan and model of a case; ``weak``: also excitations that do not determine everything."""
    seed, number = item
    generator = np.random.default_rng([seed, number, int(weak)])
    noise = float(np.exp(generator.uniform(math.log(NOISE[0]), math.log(NOISE[1]))))
    amplitude = float(generator.uniform(5.0 if weak else 6.0, 12.0))
    drives: tuple[Excitation, ...] = (
        SweptSine(
            start_frequency=8.0, stop_frequency=80.0, duration=0.5 * SECONDS, amplitude=amplitude,
            soft_start=0.2,
        ),
        Multisine(low_frequency=6.0, high_frequency=60.0, rms=(0.4 if weak else 0.6) * amplitude),
        SteadySine(frequency=float(generator.uniform(12.0, 40.0)), amplitude=amplitude),
    )  # fmt: skip
    drive = drives[number % (3 if weak else 2)]
    valve = find_valve(SPRINGS[number // 3 % len(SPRINGS)])
    plan = Plan(valve, drive, SECONDS, SAMPLE_RATE, noise, 1000 * seed + number)
    return plan, MODEL_NAMES[number // 6 % len(MODEL_NAMES)]


def _differences(first: Fit, second: Fit) -> dict[str, float]:
    one, other = _identified(first), _identified(second)
    return {
        name: abs(one[name].value - other[name].value)
        / math.hypot(one[name].standard_deviation, other[name].standard_deviation)
        for name in one
        if name in other
    }


def _identified(found: Fit) -> dict[str, Quantity]:
    known = {one.name for one in found.determinations if one.verdict == IDENTIFIABLE}
    return {one.name: one for one in found.parameters if one.name in known and math.isfinite(one.value)}
