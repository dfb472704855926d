"""A fit judged on held-out data, as JSON, as a table and as a model file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from spool_identification.agreement import free_run_agreement
from spool_identification.fit import fit
from spool_identification.fit_result import Agreement, Fit, FitSettings
from spool_sim.model import Model
from spool_stream.errors import InputError
from spool_stream.quantity import Quantity
from spool_stream.uncertainty import PLUS_MINUS, UNKNOWN, exact, interval, number, unit_text, width

from spool_tools.console.outputs import write_file
from spool_tools.input.fit_data import Data

#: How many times a descent that has not converged goes on.
ROUNDS = 2


@dataclass(frozen=True, slots=True)
class Judged:
    """A fit and how it does on data that it has not seen, ``None`` where there are none."""

    data: Data
    fit: Fit
    held_out: Agreement | None

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.fit.model.name

    @property
    def training_error(self) -> float:
        """Nrmse on the fitted data, NaN without a result."""
        return math.nan if self.fit.agreement is None else self.fit.agreement.nrmse

    @property
    def held_out_error(self) -> float:
        """Nrmse on held-out data, NaN without any."""
        return math.nan if self.held_out is None else self.held_out.nrmse


def fit_and_judge(data: Data, model: Model, settings: FitSettings) -> Judged:
    """Return ``model`` fitted to the data and its agreement with what was held out.

    Raises:
        InputError: the settings do not fit the model.
    """
    found = _converged(data, model, settings)
    if found.agreement is None or not data.held_out:
        return Judged(data, found, None)
    try:
        held_out = free_run_agreement(
            data.held_out, model, data.valve, found.values, sensor=found.sensor, run_in=settings.run_in,
            low_cut=settings.low_cut, compensate_oil=settings.compensate_oil,
        )  # fmt: skip
    except InputError:  # every held-out stretch is shorter than what settling takes
        return Judged(data, found, None)
    return Judged(data, found, held_out)


def _converged(data: Data, model: Model, settings: FitSettings) -> Fit:
    """Return a fit that goes on from where it stopped until it converges, ``ROUNDS`` times at most."""
    found = fit(data.fitted, model, data.valve, settings)
    for _ in range(ROUNDS):
        if found.converged or found.reason is not None:
            break
        # Bounds are of the model: what is fitted lies within them.
        reached = {name: value for name, value in found.values.items() if name not in found.held}
        further = fit(data.fitted, model, data.valve, replace(settings, start=reached, starts=1))
        if further.agreement is None:
            break
        found = further
    return found


def to_dictionary(judged: Judged) -> dict[str, Any]:
    """Return what ``fit --json`` writes; NaN where something is not known."""
    found, data = judged.fit, judged.data
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
        "parameters": {quantity.name: _quantity(quantity) for quantity in found.parameters},
        "combinations": {quantity.name: _quantity(quantity) for quantity in found.combinations},
        "not_observable": list(found.not_observable),
        "at_bound": list(found.at_bound),
        "held": {
            name: {"value": value, "unit": found.model.parameter(name).unit}
            for name, value in found.held.items()
        },
        "correlation": {"parameters": list(found.observable), "matrix": found.correlation.tolist()},
        "objective": math.nan if fitted is None else fitted.objective,
        "nrmse": judged.training_error,
        "nrmse_held_out": judged.held_out_error,
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
        "seconds_held_out": 0.0 if judged.held_out is None else judged.held_out.seconds,
        "samples": 0 if fitted is None else fitted.samples,
    }


def natural_frequency(found: Fit) -> float:
    """Return the undamped natural frequency, Hz, NaN where the stiffness is not known."""
    mass, stiffness = found.values.get("mass", math.nan), found.values.get("spring_stiffness", math.nan)
    if found.reason is not None or "spring_stiffness" in found.not_observable:
        return math.nan
    return math.sqrt(stiffness / mass) / (2.0 * math.pi)


def damping_ratio(found: Fit) -> float:
    """Return the share of critical damping of the viscous drag alone, NaN where it is not known."""
    drag = found.values.get("viscous_coefficient", math.nan)
    frequency = natural_frequency(found)
    if "viscous_coefficient" in found.not_observable or not frequency > 0.0:
        return math.nan
    return drag / (4.0 * math.pi * frequency * found.values["mass"])


def _quantity(quantity: Quantity) -> dict[str, Any]:
    return {"value": quantity.value, "std": quantity.standard_deviation, "unit": quantity.unit}


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


def quality_rows(judged: Judged) -> list[dict[str, str]]:
    """Return a row of text for each number that says how good the fit is."""
    found = judged.fit
    fitted = found.agreement
    if fitted is None:
        return []
    rows = {
        "objective (33)": f"{fitted.objective:.5g}",
        "a_est/a_pom, mean of 10 to 100 Hz": number(fitted.amplitude_ratio),
        "error on the fitted data, nrmse": number(judged.training_error),
        "error on held-out data, nrmse": number(judged.held_out_error),
        "undamped natural frequency": _with_unit(natural_frequency(found), "Hz"),
        "damping ratio": _with_unit(damping_ratio(found), ""),
        "data": f"{fitted.seconds:.1f} s fitted, "
        f"{0.0 if judged.held_out is None else judged.held_out.seconds:.1f} s held out",
        "descent": "converged" if found.converged else "NOT converged: distrust the numbers",
    }
    return [{"what": what, "value": value} for what, value in rows.items()]


def correlated(found: Fit, least: float = 0.9) -> list[tuple[str, str, float]]:
    """Return pairs of parameters that the record hardly tells apart, with their correlation."""
    size = len(found.observable)
    return [
        (found.observable[i], found.observable[j], float(found.correlation[i, j]))
        for i in range(size)
        for j in range(i + 1, size)
        if abs(found.correlation[i, j]) >= least
    ]


def print_fit(judged: Judged, console: Console) -> None:
    """Show a fit as the paper's tables 3 to 6 have it."""
    found = judged.fit
    console.print(f"{found.model.name} fitted to {judged.data.name} ({found.valve})", highlight=False)
    table = Table("parameter", box=None, pad_edge=False)
    for column, justify in (("value", "right"), (PLUS_MINUS, "right"), ("unit", "left"), ("", "left")):
        table.add_column(column, justify="right" if justify == "right" else "left")
    for row in parameter_rows(found):
        table.add_row(*row.values())
    console.print(table)
    quality = Table("", "", box=None, pad_edge=False, show_header=False)
    for row in quality_rows(judged):
        quality.add_row(row["what"], row["value"])
    console.print(quality)
    for first, second, value in correlated(found):
        text = f"{first} and {second} are correlated by {value:+.3f}"
        console.print(text.replace("_", " "), highlight=False, soft_wrap=True)
    for warning in found.warnings:
        console.print(f"warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)


def _with_unit(value: float, unit: str) -> str:
    return f"{number(value)}{unit_text(unit)}" if math.isfinite(value) else UNKNOWN


def model_text(found: Fit, source: str) -> str:
    """Return the fitted model as YAML that simulator and estimator load; ``source`` says where it is from.

    Raises:
        InputError: the fit has no result.
    """
    if found.reason is not None:
        raise InputError(f"{source}: no model to save: {found.reason}")
    said: Mapping[str, Quantity] = {quantity.name: quantity for quantity in found.parameters}
    lines = [
        f"# {found.model.name}, fitted to {source}",
        f"name: {found.model.name[:93]}_fitted",
        f"terms: [{', '.join(term.name for term in found.model.terms)}]",
        "parameters:",
    ]
    for parameter in found.model.parameters:
        quantity = said.get(parameter.name)
        note = "held" if quantity is None else width(quantity.value, quantity.standard_deviation)
        if quantity is not None and not math.isfinite(quantity.value):
            note = "one choice of several that act alike"
        lines.append(f"  {parameter.name}: {found.values[parameter.name]!r}  # {parameter.unit}, {note}")
    return "\n".join(lines) + "\n"


def save_model(path: Path, found: Fit, source: str) -> None:
    """Write the fitted model to ``path``.

    Raises:
        InputError: the fit has no result, or the file cannot be written or is there already.
    """
    text = model_text(found, source)
    write_file(path, text, "--save-model")
