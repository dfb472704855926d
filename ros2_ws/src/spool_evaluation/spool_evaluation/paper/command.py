"""`./spool paper`: the paper's four series and four models, without the authors' measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from spool_sim.sensors import PAPER_CHAIN
from spool_stream.errors import InputError
from spool_stream.kernels.processors import processors
from spool_tools.console.outputs import write_json
from spool_tools.console.progress import progress
from spool_tools.operations.valve_quantities import SPEED, friction_coefficient
from spool_tools.report import page as html

from . import figures
from .data import MODELS, SERIES, PrintedModel, Series, printed_parameters
from .fit import Fit, fit, fit_both, fit_held
from .page import CAN, CANNOT
from .regimes import STROKE, Regime, force_table, full_stroke, ranking_table, verdict
from .simulation import NOISE, TRUTH, Plan, Response, measure, respond, sensors
from .tables import amplitude_table, gap_table, mean_table, parameter_table, write_csv

Key = tuple[int, str]
SEED = 1
#: Share of the objective that a further step may promise for a fit to count as converged; the ranks of the
#: models differ by more.
LEVEL = 0.01
#: Table 4's friction falls so steeply with speed that time steps below 1 us are needed: a shorter plan.
LOCK_PLAN = Plan(frequencies=(10.0, 40.0, 70.0, 100.0), dwell=0.2, window=0.1, sample_rate=4000.0)
TITLE = "A spool in a vibrating body: the paper's models on made data"


@dataclass(frozen=True)
class Results:
    """Everything that goes into the page, by series number and model name."""

    plan: Plan
    data: dict[int, Response]
    printed: dict[Key, Response]
    fits: dict[Key, Fit]
    free: dict[Key, Fit]
    full: Regime


def run_paper(out: Path, plan: Plan | None = None) -> None:
    """Simulate, fit and write page, pictures and tables into the folder ``out``.

    Raises:
        InputError: ``out`` cannot be made or is a file.
    """
    plan = plan or Plan()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made: {error.strerror}; name another folder") from error
    jobs = len(SERIES) * (len(MODELS) + 1)
    with progress("simulating and fitting", jobs + len(SERIES)) as advance:
        results = compute(plan, advance)
    write(out, results)
    _tell(results)
    print(f"{out / 'paper.html'}: figures and tables, beside the printed numbers")


def _quietly(done: float) -> None:
    """Take what has been done since, and show nothing."""


def compute(plan: Plan, advance: Callable[[float], None] = _quietly) -> Results:
    """Return data, printed models and fits; ``advance`` is told of each piece that is done."""
    data: dict[int, Response] = {}
    printed: dict[Key, Response] = {}
    for series in SERIES:
        data[series.number] = measure(series, plan, SEED)
        for model in MODELS:
            values = printed_parameters(model, series)
            at = LOCK_PLAN if model.name == "mixed" else plan
            printed[series.number, model.name] = respond(series.valve, model.name, values, at)
        advance(1.0)
    fits: dict[Key, Fit] = {}
    free: dict[Key, Fit] = {}
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
        found_full: dict[Key, Fit] = {}
        for done_full in as_completed(stroked):
            found_full |= {(found.series, found.model): found for found in done_full.result()}
            advance(1.0)
    return Results(plan, data, printed, fits, free, Regime("full stroke", large, found_full))


def derived_table() -> list[dict[str, object]]:
    """Return what equation (6) and lambda say of each series."""
    rows: list[dict[str, object]] = []
    for series in SERIES:
        valve = series.valve
        rows.append(
            {
                "series": series.label,
                "natural frequency (Hz)": valve.natural_frequency,
                "damping ratio": valve.damping_ratio,
                f"eta (6) at {SPEED:g} m/s": friction_coefficient(valve),
                "roughness at lambda = 3 (µm)": 1e6 * valve.radial_clearance / 3.0,
                "roughness at lambda = 1 (µm)": 1e6 * valve.radial_clearance,
            }
        )
    return rows


def fit_all(series: Series, measured: Response) -> list[Fit]:
    """Return the fits of all four models to one series, h held at table 2's value but in model 4."""
    fluid = fit(series, "fluid", measured)
    others = [model.name for model in MODELS if model.name != "fluid"]
    return [fluid, *(fit_held(series, name, measured, fluid.values[0]) for name in others)]


def write(out: Path, results: Results) -> None:
    """Write ``paper.html``, ``paper.json``, pictures as PNG and tables as CSV into ``out``."""
    tables = {f"table_{model.table}": parameter_table(model, results.fits) for model in MODELS}
    tables["table_7"] = mean_table(results.fits)
    tables["objective_with_h_fitted"] = gap_table(results.fits, results.free)
    regimes = (Regime("small accelerations", results.data, results.fits), results.full)
    tables["derived"] = derived_table()
    tables["models_in_both_regimes"] = ranking_table(regimes)
    tables["forces_in_both_regimes"] = force_table(results.plan)
    for name, rows in tables.items():
        write_csv(out / f"{name}.csv", rows)
    amplitudes = amplitude_table(results.data, results.fits, results.printed)
    write_csv(out / "amplitudes.csv", amplitudes)
    write_json(
        out / "paper.json",
        {
            "truth": {"model": "viscous_friction + stribeck_friction", "parameters": TRUTH},
            "plan": asdict(results.plan),
            "fits": [
                {"series": one.series, "model": one.model, "h_fitted": one.free_gap, "decrease": one.decrease}
                for one in (*results.fits.values(), *results.free.values())
            ],
            "spool_follows_body_with_table_4": locked(results),
            "tables": tables,
            "amplitudes": amplitudes,
        },
    )
    sections = _sections(out, results, tables)
    (out / "paper.html").write_text(html.page(TITLE, sections), encoding="utf-8")


def locked(results: Results) -> dict[str, bool]:
    """Return, by series, whether table 4's values leave the spool at rest in the body: a_spool = a_body."""
    answer = {}
    for series in SERIES:
        response = results.printed[series.number, "mixed"]
        answer[series.label] = bool(np.array_equal(response.body, response.spool))
    return answer


def assumptions(plan: Plan) -> list[str]:
    """Return what the made data rest on, one line each."""
    body, spool = (100.0 * sensor.gain_error for sensor in sensors(SEED))
    static, kinetic = TRUTH["static_force"], TRUTH["coulomb_force"]
    first, last = plan.frequencies[0], plan.frequencies[-1]
    return [
        "The authors' measurements are not published. Every 'measured' number here is simulated.",
        "Truth: fluid friction (12) with table 2, and dry friction that falls with speed (Stribeck), from "
        f"{static:g} N at rest to {kinetic:g} N, by exp(-(v/v_s)^2) with v_s = "
        f"{TRUTH['stribeck_velocity']:g} m/s. It is none of the four models.",
        f"Shaker: {len(plan.frequencies)} steps from {first:g} to {last:g} Hz of {plan.dwell:g} s, "
        f"{plan.amplitude:g} m/s^2 peak throughout; the last {plan.window:g} s of each count. The only "
        "motion in the paper's text is far larger: 60 Hz with a full spool stroke of 9 mm, above 0.5 m/s.",
        f"Measuring chain: (30) to (32) with 5 %; drawn gain errors {body:+.2f} % (body) and {spool:+.2f} % "
        f"(spool), noise {NOISE:g} m/s^2.",
        "Fits: free-run simulations driven by the measured body amplitude, waveforms compared, sigma_i from "
        "the 5 % (as even bounds) and the noise. The sum of squares is minimised; (33) as printed is only "
        "evaluated.",
    ]


def _sections(out: Path, results: Results, tables: Mapping[str, list[dict[str, object]]]) -> list[str]:
    def drawn(name: str, figure: Any, description: str) -> str:
        text, content = html.picture(figure, description)
        (out / f"{name}.png").write_bytes(content)
        return text

    series_4 = SERIES[3]
    sections = [
        html.heading("What the data are"), html.listing(assumptions(results.plan)),
        html.heading("What can be reproduced without the authors' measurements"), html.listing(CAN),
        html.heading("What cannot"), html.listing(CANNOT),
        html.heading("What follows from tables 1 and 2"),
        html.paragraph(
            f"(6): fluid friction coefficient eta = mu v A / (F_N h) under the spool's weight at {SPEED:g} "
            "m/s, what Coulomb's coefficient would have to be for Newton's drag. Lambda: gap height over "
            "combined rms roughness; fluid friction from 3 on, mixed from 1 on. (31): largest error of the "
            f"measuring chain, {100.0 * PAPER_CHAIN.relative_uncertainty:.3g} % of the reading."
        ),
        html.table(list(tables["derived"][0]), tables["derived"]),
        html.heading("Amplitude over frequency: figures 6 to 11"),
        drawn("figures_6_to_9", figures.amplitude_figure(results.data), "amplitudes of body and spool"),
        drawn("figures_10_and_11", figures.comparison_figure(results.data), "all series together"),
        html.heading("Fitted parameters: tables 3 to 6"),
    ]  # fmt: skip
    for model in MODELS:
        rows = tables[f"table_{model.table}"]
        sections += [
            html.paragraph(_about(model)),
            html.table(list(rows[0]), rows),
        ]
    sections += [
        html.paragraph(
            "Intervals (± 95 %) come from the curvature of the objective: they say how sharp its least "
            "value is, not how far a model that is not the truth may be off. 'unknown': the data do not tell."
        ),
        html.heading("The objective: figure 12 and table 7"),
        drawn("figure_12", figures.objective_figure(results.fits), "objective by model and series"),
        html.table(list(tables["table_7"][0]), tables["table_7"]),
        html.heading("Waveform at 60 Hz: figure 13"),
        drawn("figure_13", figures.waveform_figure(results.data[4], series_4, results.fits), "waveforms"),
        html.heading("Amplitude ratios: figures 14 to 17"),
        drawn("figures_14_to_17", figures.ratio_figure(results.data, results.fits), "amplitude ratios"),
        html.heading("Table 4 locks the spool"), *_lock(results, drawn),
        html.heading("Two regimes of motion"),
        html.paragraph(
            f"The paper's conclusions name a spool that oscillates at 60 Hz with a full stroke of "
            f"{1e3 * STROKE:g} mm. For that regime the body is shaken, at each step up to 60 Hz, as much as "
            "fluid friction alone needs for that stroke. Forces at the step nearest to 60 Hz, in the truth:"
        ),
        html.table(list(tables["forces_in_both_regimes"][0]), tables["forces_in_both_regimes"]),
        html.paragraph(
            "All four models fitted in both regimes, h held at 15 µm but in model 4; means over the four "
            f"series. {verdict(tables['models_in_both_regimes'])} Gains of 5 % are in both, so that at full "
            "stroke, where dry friction is a small part of all forces, they count for more than it does."
        ),
        html.table(list(tables["models_in_both_regimes"][0]), tables["models_in_both_regimes"]),
        html.heading("Models that contain model 4"),
        html.paragraph(
            "Model 3 contains model 4 for any h: mu_0 = 0 and K_V = 1 - (15 µm)/h. A converged fit of it "
            "never has the larger objective, but three of the four printed ones do: those fits did not "
            "converge, were bounded, or follow another equation; the text does not tell which. Models 1 "
            "and 2 contain model 4 only with h fitted and may lose to it with h held. The fits here start "
            "from what they contain, so none ends above it. "
            f"{_convergence(results)} Objectives with h held at 15 µm and with h fitted:"
        ),
        html.table(
            list(tables["objective_with_h_fitted"][0]), tables["objective_with_h_fitted"]
        ),
    ]  # fmt: skip
    return sections


def _lock(results: Results, drawn: Callable[[str, Any, str], str]) -> list[str]:
    series = SERIES[3]
    root, inverse = MODELS[1].values[series.number]
    weight = series.valve.spool_mass * 9.80665
    speed = np.linspace(0.0, 3.0, 601)
    force = (root * np.sqrt(speed) + inverse / (speed + 0.01)) * weight
    followed = [label for label, same in locked(results).items() if same]
    inertia = series.valve.moving_mass * results.plan.amplitude
    loose = force[0] / series.valve.moving_mass
    say = (
        f"Equation (23) with table 4 takes up to {force[0]:.0f} N at rest and never less than "
        f"{force.min():.0f} N at any speed, against an inertia force of {inertia:.2g} N. Simulated, spool "
        f"and body move as one, a_spool = a_body bit for bit, in {len(followed)} of {len(SERIES)} series. "
        f"The body would have to be shaken with {loose:.0f} m/s^2 to break the spool loose. A locked "
        "spool has no resonance and does not depend on the oil, but the text tells of resonances near 15 and "
        "30 Hz that the oil changes, so these values were not at work as (23) is printed."
    )
    figure = figures.lock_figure(
        series, results.data[4], results.printed[4, "mixed"], (speed.tolist(), force.tolist())
    )
    return [html.paragraph(say), drawn("table_4_locks_the_spool", figure, "locked spool")]


def _about(model: PrintedModel) -> str:
    """Return the caption of a model's table."""
    caption = f"Table {model.table}: model {model.number}, equation {model.equation}"
    if model.name != "microwedge":
        return caption
    return (
        f"{caption}. By (14), k_t = C_k mu_s: contact stiffness times coefficient of static friction. With "
        "mu_s = 0.1, as of steel on steel in oil, 100 N/m stand for a contact of 1 kN/m."
    )


def _convergence(results: Results) -> str:
    """Return a sentence on how many fits are at a point where the objective is level."""
    every = [*results.fits.values(), *results.free.values()]
    level = sum(one.decrease < LEVEL for one in every)
    return (
        f"In {level} of {len(every)} fits a step of Gauss and Newton promises less than {100.0 * LEVEL:g} % "
        "of the objective; in the others the spool sticks, the objective has kinks there, and its slopes "
        "promise what a search around the point did not find."
    )


def _tell(results: Results) -> None:
    for row in mean_table(results.fits):
        print(
            f"model {row['model']:9} a_est/a_pom {row['a_est/a_pom, fitted']:.3f} (printed "
            f"{row['a_est/a_pom, printed']:.2f}), objective {row['objective, fitted']:.3g}"
        )
    followed = sum(locked(results).values())
    print(f"table 4's values lock the spool (a_spool = a_body) in {followed} of {len(SERIES)} series")
