"""Coverage study of the standard deviations: fits of simulated records whose parameters are known.

Each record is drawn by its number: one of five models, both springs and oils, three excitations, noise of 0.5
to 3 % of each channel; the truth is drawn around the valve's description. The simulated sensors sample at one
instant and without a filter; that they sample at one instant is passed to the fit (``timing`` 0).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure
from spool_blind.field.case import FieldCase
from spool_blind.field.logged import make_logged
from spool_blind.field.nuisances import SPOOL
from spool_blind.files import valve_text
from spool_core.numbers import GRAVITY
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN, Fit, FitSettings
from spool_estimator.identification.record import Record
from spool_report.outputs import write_json
from spool_sim.excitation import Excitation, MachineOrders, SteppedSine, SweptSine
from spool_sim.model import MODELS
from spool_sim.sensors import Sensor, SensorChannel
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve, valve_from_mapping

from spool_evaluation.results.page import interval, markdown_table, save_picture, study_command, write_page
from spool_evaluation.results.timing import Stopwatch
from spool_evaluation.studies.workers import spread

MODEL_NAMES = ("fluid", "microwedge", "mixed", "coulomb_hydrodynamic", "coulomb")
SPRINGS = ("4weh10_soft", "4weh10_stiff")
#: Pa s: HL68 and Azolla ZS22 of the paper's table 2.
VISCOSITIES = {"HL68": 0.0612, "Azolla ZS22": 0.0198}
EXCITATIONS = ("sweep", "stepped", "orders")
SECONDS, SAMPLE_RATE = 20.0, 2000.0
NOISE = (0.005, 0.03)

#: Half the width of a 95 % interval, in standard deviations.
WIDTH = 1.959964
ALL = "all"

STUDY, LOGGERS = "estimation", "loggers"
TITLE = "Coverage of the intervals of offline fits"
LIMITS = (
    "Here truth and fit share one simulator, and the model fitted is the one that made the record: the table "
    "shows whether noise is turned into standard deviations rightly, not what an error of the simulation or "
    "a law that is missing does to the values. For that see [records of loggers](loggers_study.md), "
    "made by another simulator, and the [field cases](field_study.md)."
)
LOGGED = (
    "[Records with dry friction](../../research/spool_blind/README.md#field-cases) of a second simulator, "
    "25 s at 1 to 4 kHz, sampled behind filters of loggers. The fit is given the law, not the filter; the "
    "table counts by the filter. In a quarter of the filtered records the filters of both channels differ "
    "(`differ`): of Butterworth filters the body's has its own corner in the fit."
)


def run(records: int, seed: int, out: Path, workers: int | None = None) -> list[RecordFit]:
    """Fit ``records`` simulated records; write rows, table and picture into ``out``."""
    items = [(seed, number) for number in range(records)]
    rows = list(spread(judge, items, f"{records} simulated records", workers))
    return published(rows, STUDY, seed, out)


def run_loggers(records: int, seed: int, out: Path, workers: int | None = None) -> list[RecordFit]:
    """Fit ``records`` records that loggers sampled, from ``seed`` on; write the same."""
    seeds = range(seed, seed + records)
    rows = list(spread(judge_logged, seeds, f"{records} records of loggers", workers))
    return published(rows, LOGGERS, seed, out)


def published(rows: list[RecordFit], study: str, seed: int, out: Path) -> list[RecordFit]:
    """Write rows, table and picture of ``study`` into ``out``; return the rows in their order."""
    rows.sort(key=lambda entry: entry.number)
    estimates = [entry for row in rows if row.converged for entry in row.estimates]
    write_json(out / f"{study}.json", {"rows": rows, "summary": summary(estimates)})
    save_picture(scores_figure(estimates), out / f"{study}_scores.png")
    command = study_command(study, len(rows), seed)
    page = write_page(out / f"{study}_study.md", TITLE, command, page_parts(rows, estimates, study))
    print(page.read_text(encoding="utf-8"))
    return rows


def judge(item: tuple[int, int]) -> RecordFit:
    """Simulate and fit the record that ``item``, seed and number, stands for."""
    seed, number = item
    generator = np.random.default_rng([seed, number])
    model = MODEL_NAMES[number % len(MODEL_NAMES)]
    cell = number // len(MODEL_NAMES)
    kind = EXCITATIONS[cell % len(EXCITATIONS)]
    spring = SPRINGS[cell // len(EXCITATIONS) % len(SPRINGS)]
    oil = list(VISCOSITIES)[cell // (len(EXCITATIONS) * len(SPRINGS)) % len(VISCOSITIES)]
    noise = float(np.exp(generator.uniform(math.log(NOISE[0]), math.log(NOISE[1]))))
    valve = find_valve(spring).model_copy(update={"oil": oil, "dynamic_viscosity": VISCOSITIES[oil]})
    truth = true_values(model, valve, generator)
    record = simulated(model, valve, truth, draw_excitation(kind, generator), noise, generator)
    watch = Stopwatch()
    result = fit([record], MODELS[model], valve, FitSettings(timing=0.0))
    return RecordFit(
        number, model, spring, oil, kind, noise,
        tuple(estimated(result, {**MODELS[model].values_for(valve), **truth})),
        result.not_observable, result.reason, result.converged,
        result.agreement.nrmse if result.agreement else math.nan,
        watch.read()[0],
    )  # fmt: skip


def given(case: FieldCase) -> tuple[Record, Valve]:
    """Return what a fit gets to see: the record and the valve's description."""
    valve = valve_from_mapping(yaml.safe_load(valve_text(case)), f"case {case.seed}")
    period = 1.0 / case.condition.sample_rate
    return Record(f"case {case.seed}", 0, period, case.body, case.spool), valve


def judge_logged(seed: int) -> RecordFit:
    """Fit the record of a logger that ``seed`` stands for, its law given."""
    case = make_logged(seed)
    record, valve = given(case)
    ((law, truth),) = case.truth.items()
    model = MODELS[law.removesuffix("_friction")]
    watch = Stopwatch()
    result = fit([record], model, valve, FitSettings(fit_gain=True, fit_delay=True))
    kind, condition = case.sampled.replace(", channels", ""), case.condition
    estimates = tuple(replace(one, model=kind) for one in estimated(result, truth))
    return RecordFit(
        seed, law, f"{truth['spring_stiffness']:.0f} N/m", "", condition.excitation.kind,
        case.chain.noise[SPOOL], estimates, result.not_observable, result.reason, result.converged,
        result.agreement.nrmse if result.agreement else math.nan, watch.read()[0],
    )  # fmt: skip


def true_values(model: str, valve: Valve, generator: np.random.Generator) -> dict[str, float]:
    """Return parameters that differ from the valve's description, with friction that lets the spool move."""

    def between(low: float, high: float) -> float:
        return float(generator.uniform(low, high))

    values = {
        "spring_stiffness": valve.spring_stiffness * between(0.9, 1.1),
        "viscous_coefficient": valve.viscous_coefficient * between(0.7, 1.3),
    }
    if model == "coulomb":
        values["coulomb_force"] = between(0.2, 0.6)
    elif model == "microwedge":
        values["contact_proportionality"] = between(150.0, 400.0)
    elif model == "mixed":
        velocity, at_rest = between(0.02, 0.05), between(0.2, 0.6)
        values["mixed_root_coefficient"] = between(0.2, 0.8)
        values["mixed_velocity"] = velocity
        values["mixed_inverse_coefficient"] = at_rest * velocity / (valve.spool_mass * GRAVITY)
    elif model == "coulomb_hydrodynamic":
        values["dry_coefficient"] = between(0.1, 0.35)
        values["film_coefficient"] = between(-0.5, 0.4)
    return values


def draw_excitation(kind: str, generator: np.random.Generator) -> Excitation:
    """Return one of the three excitations, with its own amplitude."""
    amplitude = float(generator.uniform(6.0, 12.0))
    if kind == "sweep":
        return SweptSine(
            start_frequency=8.0,
            stop_frequency=100.0,
            duration=0.5 * SECONDS,
            amplitude=amplitude,
            soft_start=0.2,
        )
    if kind == "stepped":
        return SteppedSine(
            start_frequency=10.0, stop_frequency=100.0, frequency_step=5.0, dwell=1.0,
            amplitude=amplitude, soft_start=0.2,
        )  # fmt: skip
    return MachineOrders(
        speed_profile=((0.0, 500.0), (0.5 * SECONDS, 2400.0), (SECONDS, 500.0)),
        orders=((1.0, 0.6 * amplitude), (2.0, 0.3 * amplitude)),
        broadband_rms=0.4 * amplitude,
        soft_start=0.2,
    )


def simulated(
    model: str,
    valve: Valve,
    truth: Mapping[str, float],
    excitation: Excitation,
    noise: float,
    generator: np.random.Generator,
) -> Record:
    """Return a record; each sensor's white noise is ``noise`` times the rms of what it measures."""
    simulator = Simulator(
        valve, excitation, model=model, parameters=truth, sample_rate=SAMPLE_RATE, block_size=2000
    )
    blocks = list(simulator.records(SECONDS))
    rows = []
    for channel in ("body", "spool"):
        samples = np.concatenate([getattr(block, channel) for block in blocks]).astype(np.float64)
        sensor = Sensor(noise=noise * float(np.sqrt(np.mean(samples**2))))
        rows.append(SensorChannel(sensor, int(generator.integers(2**31))).read(samples))
    return Record(f"{model}", blocks[0].stamp, 1.0 / SAMPLE_RATE, rows[0], rows[1])


def estimated(result: Fit, truth: Mapping[str, float]) -> list[Estimated]:
    """Return each known quantity of the valve with its truth; combinations by evaluating their text."""
    return [
        Estimated(
            result.model.name,
            quantity.name,
            quantity.unit,
            float(eval(quantity.name, {"__builtins__": {}}, dict(truth))),  # names and arithmetic of our own
            quantity.value,
            quantity.standard_deviation,
        )
        for quantity in (*result.parameters, *result.combinations)
        if quantity.known and quantity.name not in (SPOOL_GAIN, SPOOL_DELAY)
    ]


@dataclass(frozen=True, slots=True)
class Estimated:
    """Estimate of one quantity with its truth, in ``unit``."""

    model: str
    quantity: str
    unit: str
    truth: float
    value: float
    deviation: float

    @property
    def score(self) -> float:
        """Error over the standard deviation."""
        return (self.value - self.truth) / self.deviation if self.deviation > 0.0 else math.inf

    @property
    def error(self) -> float:
        """Error relative to the truth."""
        return (self.value - self.truth) / self.truth

    @property
    def covered(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return abs(self.score) <= WIDTH


@dataclass(frozen=True, slots=True)
class RecordFit:
    """Fit of one simulated record.

    Attributes:
        number: of the record; with the seed it gives everything.
        model, spring, oil, excitation, noise: what it is.
        estimates: what the fit told of each quantity, with the truth.
        not_observable: parameters that the fit said it cannot tell.
        reason: why there is no fit, or ``None``.
        converged: the fit says so.
        nrmse: of the free run.
        seconds: the fit took.
    """

    number: int
    model: str
    spring: str
    oil: str
    excitation: str
    noise: float
    estimates: tuple[Estimated, ...]
    not_observable: tuple[str, ...]
    reason: str | None
    converged: bool
    nrmse: float
    seconds: float


def summary(estimates: Sequence[Estimated]) -> list[dict[str, Any]]:
    """Return coverage and bias by model and quantity, and of everything in the last entry."""
    groups: dict[tuple[str, str], list[Estimated]] = {}
    for entry in estimates:
        groups.setdefault((entry.model, entry.quantity), []).append(entry)
    found = [_counted(model, quantity, entries) for (model, quantity), entries in sorted(groups.items())]
    return [*found, _counted(ALL, ALL, estimates)]


def page_parts(rows: Sequence[RecordFit], estimates: Sequence[Estimated], study: str = STUDY) -> list[str]:
    """Return the page's paragraphs and its table, Markdown."""
    failed = sum(row.reason is not None for row in rows)
    unobservable = Counter((row.model, name) for row in rows for name in row.not_observable)
    told = "20 s at 2 kHz; what they are: [how it is tested](../methods/estimation.md#does-it-hold)"
    if study == LOGGERS:
        score = np.median([abs(one.score) for one in estimates])
        told = f"loggers; the error of a number is {score:.2f} standard deviations in the median"
    parts = [
        f"{len(rows)} simulated records of {told}. "
        f"{failed} without a result, {sum(not row.converged for row in rows)} that say they did not "
        "converge; those are not in the table. "
        f"A fit took {median(row.seconds for row in rows):.1f} s (median).",
        LOGGED if study == LOGGERS else LIMITS,
        coverage_table(estimates),
        f"![errors over their standard deviations]({study}_scores.png)",
    ]
    if unobservable:
        lines = [f"- {model}: `{name}` in {count}" for (model, name), count in sorted(unobservable.items())]
        parts += ["Parameters that a fit said it cannot tell, by number of records:", "\n".join(lines)]
    return parts


def coverage_table(estimates: Sequence[Estimated]) -> str:
    """Return coverage and bias by model and quantity, and the coverage of everything, Markdown."""
    body = []
    for entry in summary(estimates):
        low, high = 100 * entry["coverage_low"], 100 * entry["coverage_high"]
        share = f"{100 * entry['coverage']:.0f} % ({low:.0f} to {high:.0f})"
        counts = (str(entry["fits"]), str(entry["covered"]), share)
        if entry["model"] == ALL:
            body.append((ALL, ALL, *counts, "", "", ""))
            continue
        sizes = (f"{100 * entry[name]:.3f} %" for name in ("scatter", "median_deviation"))
        body.append(
            (entry["model"], f"`{entry['quantity']}`", *counts, f"{100 * entry['bias']:+.3f} %", *sizes)
        )
    head = ("model", "quantity", "fits", "covered", "share (95 % interval)", "mean error", "scatter")
    return markdown_table((*head, "median standard deviation"), body)


def scores_figure(estimates: Sequence[Estimated]) -> Figure:
    """Return the errors over their standard deviations, with the normal distribution."""
    scores = np.clip([entry.score for entry in estimates], -6.0, 6.0)
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    axes = figure.subplots()
    edges = np.linspace(-6.0, 6.0, 49)
    axes.hist(scores, bins=list(edges), density=True, color="#0072B2", alpha=0.7, label="estimates")
    place = np.linspace(-6.0, 6.0, 241)
    axes.plot(place, np.exp(-0.5 * place**2) / math.sqrt(2.0 * math.pi), color="black", label="normal")
    axes.set_xlabel("error / standard deviation")
    axes.set_ylabel("density")
    axes.legend(frameon=False)
    return figure


def _counted(model: str, quantity: str, entries: Sequence[Estimated]) -> dict[str, Any]:
    fits = len(entries)
    covered = sum(entry.covered for entry in entries)
    low, high = interval(covered, fits, "exact")
    errors = [entry.error for entry in entries] or [math.nan]
    deviations = [abs(entry.deviation / entry.truth) for entry in entries] or [math.nan]
    return {
        "model": model,
        "quantity": quantity,
        "fits": fits,
        "covered": covered,
        "coverage": covered / fits if fits else math.nan,
        "coverage_low": low,
        "coverage_high": high,
        "bias": float(np.mean(errors)),
        "scatter": float(np.std(errors)),
        "median_deviation": float(np.median(deviations)),
    }
