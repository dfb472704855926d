"""Tables 3 to 7 of the paper with what the fits on made data give, and the same as CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from spool_core.uncertainty import PLUS_MINUS, Z_95
from spool_tools.operations.valve_sheet import SPEED, friction_coefficient

from .data import MODELS, SERIES, PrintedModel
from .fit import PaperFit
from .simulation import SteppedResponse

TableRow = dict[str, object]


def parameter_table(model: PrintedModel, fits: Mapping[tuple[int, str], PaperFit]) -> list[TableRow]:
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


def mean_table(fits: Mapping[tuple[int, str], PaperFit]) -> list[TableRow]:
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


def gap_table(
    fits: Mapping[tuple[int, str], PaperFit], free: Mapping[tuple[int, str], PaperFit]
) -> list[TableRow]:
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
    data: Mapping[int, SteppedResponse],
    fits: Mapping[tuple[int, str], PaperFit],
    printed: Mapping[tuple[int, str], SteppedResponse],
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
                row[f"{model.name}_fitted_m_s2"] = fits[key].amplitudes[step]
                at = printed[key].plan.frequencies
                if frequency in at:
                    amplitude = printed[key].spool_amplitudes[at.index(frequency)]
                    row[f"{model.name}_printed_values_m_s2"] = float(amplitude)
                else:
                    row[f"{model.name}_printed_values_m_s2"] = None
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
