"""Tables of a fit: as JSON, and as rows of text for a terminal and a page."""

from __future__ import annotations

import math
from typing import Any

from rich.console import Console
from rich.table import Table
from spool_core.uncertainty import PLUS_MINUS, UNKNOWN, exact, interval, number, unit_text
from spool_estimator.identification.fit_result import Fit

from .validated_fit import ValidatedFit, damping_ratio, natural_frequency


def to_dictionary(validated: ValidatedFit) -> dict[str, Any]:
    """Return what ``fit --json`` writes; NaN where something is not known."""
    found, data = validated.fit, validated.data
    fitted = found.agreement
    return {
        "records": [str(path) for path in data.paths],
        "held_out_records": [str(path) for path in data.held_paths],
        "valve": found.valve,
        "model": found.model.name,
        "terms": [term.name for term in found.model.terms],
        "converged": found.converged,
        "reason": found.reason,
        "warnings": [*data.doubts, *found.warnings],
        "parameters": {quantity.name: quantity.to_dict() for quantity in found.parameters},
        "combinations": {quantity.name: quantity.to_dict() for quantity in found.combinations},
        "not_observable": list(found.not_observable),
        "at_bound": list(found.at_bound),
        "held": {
            name: {"value": value, "unit": found.model.parameter(name).unit}
            for name, value in found.held.items()
        },
        "correlation": {"parameters": list(found.observable), "matrix": found.correlation.tolist()},
        "objective": math.nan if fitted is None else fitted.objective,
        "nrmse": validated.training_error,
        "nrmse_held_out": validated.held_out_error,
        "amplitude_ratio": math.nan if fitted is None else fitted.amplitude_ratio,
        "amplitude_ratios": {
            "frequency_Hz": [] if fitted is None else fitted.frequencies.tolist(),
            "ratio": [] if fitted is None else fitted.amplitude_ratios.tolist(),
        },
        "natural_frequency_Hz": natural_frequency(found),
        "damping_ratio": damping_ratio(found),
        "information_criterion": found.information_criterion,
        "effective_samples": found.effective_samples,
        "seconds": math.nan if fitted is None else fitted.seconds,
        "seconds_held_out": 0.0 if validated.held_out is None else validated.held_out.seconds,
        "samples": 0 if fitted is None else fitted.samples,
    }


def parameter_rows(found: Fit) -> list[dict[str, str]]:
    """Return a row of text for each parameter: what was fitted, what acts together, what was held."""
    rows = []
    for quantity in (*found.parameters, *found.combinations):
        note = "at its bound" if quantity.name in found.at_bound else ""
        if not math.isfinite(quantity.value):
            note = "the record does not tell it"
        shown = interval(quantity.value, quantity.standard_deviation)
        rows.append(
            {
                "parameter": quantity.name.replace("_", " "),
                "value": shown.value,
                PLUS_MINUS: shown.half_width,
                "unit": quantity.unit,
                "": note,
            }
        )
    for name, value in found.held.items():
        unit = found.model.parameter(name).unit
        rows.append(
            {
                "parameter": name.replace("_", " "),
                "value": exact(value),
                PLUS_MINUS: "",
                "unit": unit,
                "": "held",
            }
        )
    return rows


def quality_rows(validated: ValidatedFit) -> list[dict[str, str]]:
    """Return a row of text for each number that says how good the fit is."""
    found = validated.fit
    fitted = found.agreement
    if fitted is None:
        return []
    rows = {
        "objective (33)": f"{fitted.objective:.5g}",
        "a_est/a_pom, mean of 10 to 100 Hz": number(fitted.amplitude_ratio),
        "error on the fitted data, nrmse": number(validated.training_error),
        "error on held-out data, nrmse": number(validated.held_out_error),
        "undamped natural frequency": _with_unit(natural_frequency(found), "Hz"),
        "damping ratio": _with_unit(damping_ratio(found), ""),
        "data": f"{fitted.seconds:.1f} s fitted, "
        f"{0.0 if validated.held_out is None else validated.held_out.seconds:.1f} s held out",
        "descent": "converged" if found.converged else "NOT converged: distrust the numbers",
    }
    return [{"what": what, "value": value} for what, value in rows.items()]


def correlated(found: Fit, least: float = 0.9) -> list[tuple[str, str, float]]:
    """Return pairs of parameters that the record hardly distinguishes, with their correlation."""
    size = len(found.observable)
    return [
        (found.observable[i], found.observable[j], float(found.correlation[i, j]))
        for i in range(size)
        for j in range(i + 1, size)
        if abs(found.correlation[i, j]) >= least
    ]


def print_fit(validated: ValidatedFit, console: Console) -> None:
    """Show a fit as the paper's tables 3 to 6 have it."""
    found = validated.fit
    console.print(f"{found.model.name} fitted to {validated.data.name} ({found.valve})", highlight=False)
    table = Table("parameter", box=None, pad_edge=False)
    for column, justify in (("value", "right"), (PLUS_MINUS, "right"), ("unit", "left"), ("", "left")):
        table.add_column(column, justify="right" if justify == "right" else "left")
    for row in parameter_rows(found):
        table.add_row(*row.values())
    console.print(table)
    quality = Table("", "", box=None, pad_edge=False, show_header=False)
    for row in quality_rows(validated):
        quality.add_row(row["what"], row["value"])
    console.print(quality)
    for first, second, value in correlated(found):
        text = f"{first} and {second} are correlated by {value:+.3f}"
        console.print(text.replace("_", " "), highlight=False, soft_wrap=True)
    for warning in found.warnings:
        console.print(f"warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)


def _with_unit(value: float, unit: str) -> str:
    return f"{number(value)}{unit_text(unit)}" if math.isfinite(value) else UNKNOWN
