"""Page of the reproduction: figures and tables in the paper's order, and what they tell."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from spool_core.errors import InputError
from spool_core.numbers import GRAVITY, Array
from spool_core.uncertainty import PLUS_MINUS, Z_95
from spool_report import page as html
from spool_report.outputs import write_json
from spool_report.records.valve_sheet import SPEED, friction_coefficient
from spool_report.terminal import Table
from spool_sim.sensors import PAPER_CHAIN

from spool_evaluation.paper.experiment import (
    MODELS,
    NOISE,
    SERIES,
    TRUTH,
    PaperSeries,
    Plan,
    PrintedModel,
    SteppedResponse,
    sensors,
)
from spool_evaluation.paper.fit import (
    SEED,
    STROKE,
    Data,
    Fits,
    Regime,
    Reproduction,
    force_table,
    locked,
    ranking_table,
    reproduce,
    verdict,
    waveform_step,
)

TITLE = "A spool in a vibrating body: the paper's models on made data"
#: Share of the objective that a further step may promise for a fit to count as converged; the ranks of the
#: models differ by more.
LEVEL = 0.01

#: Okabe and Ito's colours with a marker each: distinct for the colour-blind and in print.
BODY, SPOOL, MEASURED = "#0072B2", "#D55E00", "#999999"
STYLES = (("#E69F00", "o"), ("#0072B2", "s"), ("#009E73", "^"), ("#CC79A7", "D"))
MODEL_NAMES = {model.name: f"model {model.number} {model.equation}" for model in MODELS}

TableRow = dict[str, object]

#: What the page shows, in its order.
PARTS = Path(__file__).with_name("page.yaml")


def facts(results: Reproduction, tables: Mapping[str, list[TableRow]]) -> dict[str, object]:
    """Return the numbers that the page's texts name."""
    plan, fits = results.plan, [*results.fits.values(), *results.free.values()]
    body, spool = (100.0 * sensor.gain_error for sensor in sensors(SEED))
    valve, (_, force) = SERIES[3].valve, locking_friction()
    return {
        "plan": plan, "truth": TRUTH, "noise": NOISE, "body": body, "spool": spool,
        "steps": len(plan.frequencies), "first": plan.frequencies[0], "last": plan.frequencies[-1],
        "speed": SPEED, "uncertainty": 100.0 * PAPER_CHAIN.relative_uncertainty, "stroke": 1e3 * STROKE,
        "rest": force[0], "least": force.min(), "inertia": valve.moving_mass * plan.amplitude,
        "loose": force[0] / valve.moving_mass, "followed": sum(locked(results).values()),
        "series": len(SERIES), "verdict": verdict(tables["models_in_both_regimes"]),
        "level": sum(one.decrease < LEVEL for one in fits), "fits": len(fits), "promise": 100.0 * LEVEL,
    }  # fmt: skip


def sections(out: Path, results: Reproduction, tables: Mapping[str, list[TableRow]]) -> list[Markup]:
    """Return the sections of the page; the pictures go into the folder ``out`` as PNG, too."""
    numbers, series = facts(results, tables), SERIES[3]
    figures = {
        "figures_6_to_9": amplitude_figure(results.data),
        "figures_10_and_11": comparison_figure(results.data),
        "figure_12": objective_figure(results.fits),
        "figure_13": waveform_figure(results.data[4], series, results.fits),
        "figures_14_to_17": ratio_figure(results.data, results.fits),
        "table_4_locks_the_spool": lock_figure(
            series, results.data[4], results.printed[4, "mixed"], locking_friction()
        ),
    }
    found = []
    for part in yaml.safe_load(PARTS.read_text(encoding="utf-8")):
        match part:
            case {"picture": name, "shows": description}:
                text, content = html.picture(figures[name], description)
                (out / f"{name}.png").write_bytes(content)
                found.append(text)
            case {"table": name}:
                found.append(html.table(Table.of(tables[name])))
            case {"list": lines}:
                found.append(html.listing([line.format(**numbers) for line in lines]))
            case {"heading": text}:
                found.append(html.heading(text))
            case {"paragraph": text}:
                found.append(html.paragraph(text.format(**numbers)))
    return found


def locking_friction() -> tuple[Array, Array]:
    """Return relative velocities (m/s) and the mixed friction (N) with table 4's values for series 4."""
    root, inverse = MODELS[1].values[4]
    speed: Array = np.linspace(0.0, 3.0, 601, dtype=np.float64)
    return speed, (root * np.sqrt(speed) + inverse / (speed + 0.01)) * SERIES[3].valve.spool_mass * GRAVITY


def amplitude_figure(data: Data) -> Figure:
    """Return figures 6 to 9: amplitudes of body and spool over frequency, one panel a series."""
    figure, panels = _panels("frequency, Hz", "acceleration amplitude, m/s²")
    for axis, series in zip(panels, SERIES, strict=True):
        response = data[series.number]
        _marked(axis, response, response.body_amplitudes, (BODY, "s"), "body")
        _marked(axis, response, response.spool_amplitudes, (SPOOL, "o"), "spool")
        axis.axvline(series.valve.natural_frequency, color="#666666", lw=1, ls=":", label="natural frequency")
        axis.set_ylim(0.0, None)
        axis.set_title(f"as Fig. {series.figure}: {series.label}", fontsize=10)
    panels[0].legend(fontsize=8)
    return figure


def comparison_figure(data: Data) -> Figure:
    """Return figures 10 and 11: body and spool of all series."""
    figure, axes = _pair("as Fig. 10: body", "as Fig. 11: spool")
    for series, style in zip(SERIES, STYLES, strict=True):
        response, name = data[series.number], f"{series.number}: {series.label}"
        _marked(axes[0], response, response.body_amplitudes, style, name)
        _marked(axes[1], response, response.spool_amplitudes, style, name)
    axes[0].set_ylim(0.0, 1.3 * max(float(data[series.number].body_amplitudes.max()) for series in SERIES))
    axes[1].set_ylim(0.0, None)
    axes[1].legend(fontsize=8)
    for axis in axes:
        _label(axis, "frequency, Hz", "acceleration amplitude, m/s²")
    return figure


def objective_figure(fits: Fits) -> Figure:
    """Return figure 12: the objective by model and series, ours and the print; scales are their own."""
    figure, axes = _pair("as Fig. 12: made data", "Fig. 12 as printed: tables 3 to 6")
    for place, (model, (colour, _)) in enumerate(zip(MODELS, STYLES, strict=True)):
        at = np.arange(len(SERIES)) + 0.2 * (place - 1.5)
        ours = [fits[series.number, model.name].objective for series in SERIES]
        printed = [model.objective[series.number] for series in SERIES]
        for axis, heights in zip(axes, (ours, printed), strict=True):
            axis.bar(at, heights, 0.18, color=colour, label=MODEL_NAMES[model.name])
    for axis in axes:
        axis.set_yscale("log")
        axis.set_xticks(range(len(SERIES)), [f"{s.spring_stiffness:g} N/m\n{s.oil}" for s in SERIES])
        axis.tick_params(axis="x", labelsize=8)
        axis.set_ylabel("objective (33), no unit")
        axis.grid(axis="y", alpha=0.3)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=len(MODELS))
    return figure


def waveform_figure(response: SteppedResponse, series: PaperSeries, fits: Fits) -> Figure:
    """Return figure 13: the spool's acceleration at 60 Hz, data in grey, the four models in colour."""
    step = waveform_step(response)
    frequency = response.plan.frequencies[step]
    shown = min(response.plan.samples, round(3.0 / frequency * response.plan.sample_rate))
    time = 1e3 * np.arange(shown) / response.plan.sample_rate
    figure, panels = _panels("time, ms", "spool acceleration, m/s²")
    for axis, model, letter in zip(panels, MODELS, "abcd", strict=True):
        fit = fits[series.number, model.name]
        axis.plot(time, response.spool[step, :shown], color=MEASURED, lw=3, label="data")
        axis.plot(time, fit.waveform[:shown], color=BODY, lw=1.2, label="model")
        axis.set_title(f"({letter}) {MODEL_NAMES[model.name]}, {frequency:g} Hz", fontsize=10)
    panels[0].legend(fontsize=8)
    return figure


def ratio_figure(data: Data, fits: Fits) -> Figure:
    """Return figures 14 to 17: fitted over measured amplitude, one panel a series."""
    figure, panels = _panels("frequency, Hz", "amplitude ratio a_est / a_pom")
    for axis, series in zip(panels, sorted(SERIES, key=lambda entry: entry.ratio_figure), strict=True):
        response = data[series.number]
        for model, style in zip(MODELS, STYLES, strict=True):
            ratio = np.array(fits[series.number, model.name].amplitudes) / response.spool_amplitudes
            _marked(axis, response, ratio, style, MODEL_NAMES[model.name], lw=1)
        axis.axhline(1.0, color="#444444", lw=1)
        axis.set_title(f"as Fig. {series.ratio_figure}: {series.label}", fontsize=10)
    panels[0].legend(fontsize=8)
    return figure


def lock_figure(
    series: PaperSeries, measured: SteppedResponse, printed: SteppedResponse, friction: tuple[Array, Array]
) -> Figure:
    """Return the picture of table 4's values at work: amplitudes of body and spool, and the friction law.

    ``friction`` is the relative velocity (m/s) and the force (N) of the mixed friction as printed.
    """
    figure, axes = _pair(f"model 2 with table 4: {series.label}", "what would have to be overcome")
    _marked(axes[0], measured, measured.spool_amplitudes, (MEASURED, "o"), "spool, made data")
    axes[0].plot(printed.plan.frequencies, printed.body_amplitudes, color=BODY, lw=4, alpha=0.5, label="body")
    _marked(axes[0], printed, printed.spool_amplitudes, (SPOOL, "s"), "spool, table 4", ls="--")
    axes[0].set_ylim(0.0, None)
    _label(axes[0], "frequency, Hz", "acceleration amplitude, m/s²")
    axes[1].semilogy(*friction, color=SPOOL, label="friction with table 4")
    largest = series.valve.moving_mass * printed.plan.amplitude
    axes[1].axhline(largest, color=BODY, ls="--", label=f"largest inertia force, {largest:.2g} N")
    _label(axes[1], "relative velocity, m/s", "force, N")
    for axis in axes:
        axis.legend(fontsize=8)
    return figure


def parameter_table(model: PrintedModel, fits: Fits) -> list[TableRow]:
    """Return table 3, 4, 5 or 6: printed values, then the fitted ones with half widths of 95 %."""
    rows = []
    for series in SERIES:
        fit = fits[series.number, model.name]
        row: TableRow = {"series": series.label}
        for column, value in zip(model.columns, model.values[series.number], strict=True):
            row[f"{column}, printed"] = value
        if model.name == "microwedge":
            overlap, length, proportionality = model.values[series.number]
            row["k_t (d_k0 - a_k0) (N), printed"] = proportionality * (length - overlap)
        row["objective, printed"] = model.objective[series.number]
        for name, unit, value, deviation in zip(
            fit.names, fit.units, fit.values, fit.deviations, strict=True
        ):
            row[f"{name} ({unit}), fitted"] = value
            row[f"{name}, {PLUS_MINUS}"] = Z_95 * deviation
        row["objective, squared"] = fit.objective
        row["objective, as (33) stands"] = fit.objective_as_printed
        rows.append(row)
    return rows


def mean_table(fits: Fits) -> list[TableRow]:
    """Return table 7: means over the four series."""
    rows: list[TableRow] = []
    for model in MODELS:
        own = [fits[series.number, model.name] for series in SERIES]
        rows.append(
            {
                "model": f"{model.number} {model.equation}",
                "objective, printed": model.mean_objective,
                "objective, mean of the printed tables": float(np.mean(list(model.objective.values()))),
                "objective, fitted": float(np.mean([fit.objective for fit in own])),
                "a_est/a_pom, printed": model.mean_ratio,
                "a_est/a_pom, fitted": float(np.mean([fit.ratio for fit in own])),
            }
        )
    return rows


def gap_table(fits: Fits, free: Fits) -> list[TableRow]:
    """Return the objectives with h held at table 2's value and with h fitted."""
    rows: list[TableRow] = []
    for series in SERIES:
        row: TableRow = {"series": series.label}
        for model in MODELS:
            if model.name == "fluid":
                row["model 4, h fitted"] = fits[series.number, "fluid"].objective
            else:
                row[f"model {model.number}, h = 15 µm"] = fits[series.number, model.name].objective
                row[f"model {model.number}, h fitted"] = free[series.number, model.name].objective
        rows.append(row)
    return rows


def amplitude_table(
    data: Data, fits: Fits, printed: Mapping[tuple[int, str], SteppedResponse]
) -> list[TableRow]:
    """Return all amplitudes (m/s^2): data, fitted models, and models with the printed values."""
    rows: list[TableRow] = []
    for series in SERIES:
        response = data[series.number]
        for step, frequency in enumerate(response.plan.frequencies):
            row: TableRow = {
                "series": series.number,
                "frequency_Hz": frequency,
                "body_m_s2": float(response.body_amplitudes[step]),
                "spool_m_s2": float(response.spool_amplitudes[step]),
            }
            for model in MODELS:
                key = (series.number, model.name)
                known = zip(
                    printed[key].plan.frequencies, printed[key].spool_amplitudes.tolist(), strict=True
                )
                row[f"{model.name}_fitted_m_s2"] = fits[key].amplitudes[step]
                row[f"{model.name}_printed_values_m_s2"] = dict(known).get(frequency)
            rows.append(row)
    return rows


def derived_table() -> list[TableRow]:
    """Return what equation (6) and lambda say of each series."""
    rows: list[TableRow] = []
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


def write_csv(path: Path, rows: Sequence[TableRow]) -> None:
    """Write ``rows``, all of the same columns, with a header."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _panels(across: str, up: str) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    panels = list(figure.subplots(2, 2, sharex=True).ravel())
    for number, axis in enumerate(panels):
        _label(axis, across if number > 1 else "", up if number % 2 == 0 else "")
    return figure, panels


def _pair(left: str, right: str) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = list(figure.subplots(1, 2))
    for axis, title in zip(axes, (left, right), strict=True):
        axis.set_title(title, fontsize=10)
    return figure, axes


def _marked(
    axis: Axes, response: SteppedResponse, row: Array, style: tuple[str, str], label: str, **line: Any
) -> None:
    """Draw ``row`` over the frequencies of ``response``; ``style`` is colour and marker."""
    axis.plot(response.plan.frequencies, row, color=style[0], marker=style[1], ms=4, label=label, **line)


def _label(axis: Axes, across: str, up: str) -> None:
    axis.set_xlabel(across)
    axis.set_ylabel(up)
    axis.grid(alpha=0.3)


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
    results = reproduce(plan)
    write(out, results)
    _tell(results)
    print(f"{out / 'paper.html'}: figures and tables, with the printed numbers")


def write(out: Path, results: Reproduction) -> None:
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
    page = html.page(TITLE, sections(out, results, tables))
    (out / "paper.html").write_text(page, encoding="utf-8")


def _tell(results: Reproduction) -> None:
    for row in mean_table(results.fits):
        print(
            f"model {row['model']:9} a_est/a_pom {row['a_est/a_pom, fitted']:.3f} (printed "
            f"{row['a_est/a_pom, printed']:.2f}), objective {row['objective, fitted']:.3g}"
        )
    followed = sum(locked(results).values())
    print(f"table 4's values lock the spool (a_spool = a_body) in {followed} of {len(SERIES)} series")
