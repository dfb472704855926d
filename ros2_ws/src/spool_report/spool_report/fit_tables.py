"""Fits and comparisons as JSON, as rows of text, and as a model file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from spool_core import uncertainty
from spool_core.errors import InputError
from spool_core.files import load_yaml
from spool_core.numbers import Array
from spool_core.uncertainty import LEGEND, PLUS_MINUS, Quantity, by_name, interval, number, percent
from spool_estimator.identification.determination import ONE_SIDED, sentences
from spool_estimator.identification.fit_result import Fit
from spool_estimator.identification.free_run import USUAL
from spool_sim.model import Model, model_from_mapping

from spool_report.outputs import check_output, write_file
from spool_report.ranking import FittedSeries, Ranking, ValidatedFit, damping_ratio, natural_frequency
from spool_report.terminal import Table, captions, spoken

#: Characters of a model's name that its file keeps; with what is added it stays below the 100 that are read.
LONGEST_NAME = 93
#: Relative difference up to which a file states the number that was reported.
AGREEMENT = 1e-6
#: Correlation from which two parameters are hardly distinguished.
ALIKE = 0.9


def to_dictionary(validated: ValidatedFit) -> dict[str, Any]:
    """Return what ``fit --json`` writes; NaN where something is not known."""
    found, data = validated.fit, validated.data
    fitted = found.agreement
    return {
        "records": data.paths,
        "held_out_records": data.held_paths,
        "valve": found.valve,
        "model": found.model.name,
        "terms": [term.name for term in found.model.terms],
        "converged": found.converged,
        "stopped_early": found.stopped_early,
        "reason": found.reason,
        "warnings": [*data.doubts, *found.warnings],
        "parameters": by_name(found.parameters),
        "combinations": by_name(found.combinations),
        "not_observable": found.not_observable,
        "at_bound": found.at_bound,
        "determined": by_name(found.determinations),
        "held": {
            name: {"value": value, "unit": found.model.parameter(name).unit}
            for name, value in found.held.items()
        },
        "observation": {
            "kind": found.observation.kind,
            "order": found.observation.order,
            "corner_Hz": found.observation.corner / data.fitted[0].sample_period,
            "body_corner_Hz": found.observation.of_body().corner / data.fitted[0].sample_period,
            "shape": found.observation.shape or 0.0,
        },
        "correlation": {"parameters": found.observable, "matrix": found.correlation},
        "objective": math.nan if fitted is None else fitted.objective,
        "nrmse": validated.training_error,
        "nrmse_held_out": validated.held_out_error,
        "amplitude_ratio": math.nan if fitted is None else fitted.amplitude_ratio,
        "amplitude_ratios": {
            "frequency_Hz": () if fitted is None else fitted.frequencies,
            "ratio": () if fitted is None else fitted.amplitude_ratios,
        },
        "natural_frequency_Hz": natural_frequency(found),
        "damping_ratio": damping_ratio(found),
        "information_criterion": found.information_criterion,
        "effective_samples": found.effective_samples,
        "seconds": math.nan if fitted is None else fitted.seconds,
        "seconds_held_out": 0.0 if validated.held_out is None else validated.held_out.seconds,
        "samples": 0 if fitted is None else fitted.samples,
    }


def parameter_table(found: Fit) -> Table:
    """Return a row for each parameter: what was fitted, what acts together, what was held."""
    rows = []
    bounds = {one.name: one.bound for one in found.determinations if one.verdict == ONE_SIDED}
    for quantity in (*found.parameters, *found.combinations):
        note = "at its bound" if quantity.name in found.at_bound else ""
        if not math.isfinite(quantity.value):
            note = bounds.get(quantity.name, "the record does not determine it")
        shown = interval(quantity.value, quantity.standard_deviation)
        rows.append((spoken(quantity.name), shown.value, shown.half_width, quantity.unit, note))
    for name, value in found.held.items():
        rows.append((spoken(name), uncertainty.exact(value), "", found.model.parameter(name).unit, "fixed"))
    return Table(("parameter", "value", PLUS_MINUS, "unit", ""), rows, ("value", PLUS_MINUS))


def quality_table(validated: ValidatedFit) -> Table:
    """Return a row for each number that says how good the fit is."""
    found = validated.fit
    fitted = found.agreement
    rows = [] if fitted is None else [
        ("objective, weighted squared error", f"{fitted.objective:.5g}"),
        ("mean amplitude ratio, model/measured, 10 to 100 Hz", number(fitted.amplitude_ratio)),
        ("error on the fitted data, of the spool's rms", percent(validated.training_error, 3)),
        ("error on held-out data, of the spool's rms", percent(validated.held_out_error, 3)),
        ("undamped natural frequency", _with_unit(natural_frequency(found), "Hz")),
        ("damping ratio", _with_unit(damping_ratio(found), "")),
        ("data", f"{fitted.seconds:.1f} s fitted, "
         f"{0.0 if validated.held_out is None else validated.held_out.seconds:.1f} s held out"),
        ("filter of the logger", "not visible: no force jumps"
         if found.observation == USUAL
         else found.observation.sentence(1.0 / validated.data.fitted[0].sample_period)),
        ("optimisation", "converged" if found.converged else "NOT converged: do not use the numbers"),
    ]  # fmt: skip
    return Table(("what", "value"), rows)


def correlations(found: Fit) -> list[str]:
    """Return a line for each pair of parameters that the record hardly distinguishes."""
    return [
        spoken(f"correlation of {first} and {second}: {value:+.3f}")
        for (row, first), (column, second) in combinations(enumerate(found.observable), 2)
        if abs(value := float(found.correlation[row, column])) >= ALIKE
    ]


def print_fit(validated: ValidatedFit, console: Console) -> None:
    """Show a fit as the paper's tables 3 to 6 have it."""
    found = validated.fit
    console.print(f"{found.model.name} fitted to {validated.data.name} ({found.valve})", highlight=False)
    for line in sentences(found.determinations):
        console.print(line, highlight=False, soft_wrap=True)
    parameter_table(found).show(console)
    quality_table(validated).show(console, header=False)
    for line in correlations(found):
        console.print(line, highlight=False, soft_wrap=True)
    for warning in found.warnings:
        console.print(f"warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)


def comparison_dictionary(series: Sequence[FittedSeries], ranking: Ranking) -> dict[str, Any]:
    """Return what ``compare --json`` writes; NaN where something is not known."""
    return {
        "preferred": ranking.preferred,
        "equal": ranking.equal,
        "verdict": " ".join(ranking.sentences),
        "ranking": [
            {
                "model": entry.model,
                "parameters": entry.parameters,
                "error": {"value": entry.error, "unit": "m/s^2"},
                "error_over_least": entry.excess + 1.0,
                "information_criterion": entry.criterion,
                "information_criterion_behind": entry.criterion - ranking.least_criterion,
                "objective": entry.objective,
                "amplitude_ratio": entry.amplitude_ratio,
                "nrmse": entry.training_error,
                "nrmse_held_out": entry.held_out_error,
                "reason": entry.reason,
                "doubt": entry.doubt,
            }
            for entry in ranking.ranks
        ],
        "series": [
            {
                "records": one.data.paths,
                "held_out_records": one.data.held_paths,
                "valve": one.data.valve.id,
                "models": {validated.name: to_dictionary(validated) for validated in one.validated},
            }
            for one in series
        ],
    }


def series_table(one: FittedSeries) -> Table:
    """Return a row for each model: how well it holds, as in the paper's tables 3 to 6."""
    rows = [
        (
            spoken(validated.name),
            _number(math.nan if agreement is None else agreement.objective, ".4g"),
            _number(math.nan if agreement is None else agreement.amplitude_ratio, ".4f"),
            percent(validated.training_error, 3),
            percent(validated.held_out_error, 3),
        )
        for validated in one.validated
        for agreement in (validated.fit.agreement,)
    ]
    columns = ("model", "objective", "amplitude ratio", "error fitted", "error held out")
    return Table(columns, rows, columns[1:])


def parameter_lines(validated: ValidatedFit) -> list[str]:
    """Return the fitted parameters, a line each; those that only act together as their combination."""
    found = validated.fit
    if found.reason is not None:
        return [f"no result: {found.reason}"]
    lines = []
    for quantity in (*found.parameters, *found.combinations):
        if math.isfinite(quantity.value):
            value = uncertainty.with_interval(quantity.value, quantity.standard_deviation, quantity.unit)
            bound = ", at its bound" if quantity.name in found.at_bound else ""
            lines.append(f"{spoken(quantity.name)} {value}{bound}")
    if found.not_observable:
        lines.append(f"not determined: {', '.join(map(spoken, found.not_observable))}")
    if not found.converged:
        lines.append("NOT converged")
    return lines


def ranking_table(ranking: Ranking) -> Table:
    """Return a row for each model, best first; means over the series, as the paper's table 7."""
    rows = [
        (
            spoken(entry.model),
            str(entry.parameters or ""),
            _number(entry.error, ".4g"),
            ""
            if math.isnan(entry.excess)
            else f"{100.0 * entry.excess:+.1f} %"
            if entry.excess < 1.0
            else f"x {1.0 + entry.excess:.3g}",
            _number(entry.criterion - ranking.least_criterion, "+.0f"),
            _number(entry.objective, ".3g"),
            _number(entry.amplitude_ratio, ".3f"),
            percent(entry.held_out_error, 3),
        )
        for entry in ranking.ranks
    ]
    columns = ("model", "parameters", "off jumps", "excess", "BIC", "objective", "ratio", "error")
    return Table(columns, rows, columns[1:])


def determined_lines(one: FittedSeries) -> list[str]:
    """Return what a series determines of each model at its start values, a line each."""
    return [
        f"{spoken(validated.name)}, before the fit: {'; '.join(line.rstrip('.') for line in known)}"
        for validated in one.validated
        if (known := sentences(validated.fit.determinations))
    ]


def print_comparison(series: Sequence[FittedSeries], ranking: Ranking, console: Console) -> None:
    """Show parameters of each series, the ranking over all, and what it means."""
    for one in series:
        console.print(f"[bold]{one.data.name}[/bold] ({one.data.valve.id})", highlight=False)
        for validated in one.validated:
            text = f"  {spoken(validated.name)}: {', '.join(parameter_lines(validated))}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        for line in determined_lines(one):
            console.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)
        series_table(one).show(console)
    console.print(LEGEND, markup=False, highlight=False, soft_wrap=True)
    console.print("[bold]Ranking[/bold]", highlight=False)
    ranking_table(ranking).show(console)
    console.print(captions("compare")["ranking"], markup=False, highlight=False, soft_wrap=True)
    for sentence in ranking.sentences:
        console.print(sentence, markup=False, highlight=False, soft_wrap=True)


def save_model(
    path: Path,
    model: Model,
    name: str,
    values: Mapping[str, float],
    fitted: Sequence[Quantity],
    comment: str,
    correlated: tuple[Sequence[str], Array] = ((), np.empty((0, 0))),
) -> None:
    """Write ``model`` with ``values``.

    Args:
        path: to write.
        model: its terms are written.
        name: of the model in the file.
        values: by parameter, in its unit; parameters that are not among them are left out.
        fitted: what was fitted; the deviations of these stand next to their values.
        comment: first line, says where it comes from.
        correlated: names and matrix of the correlations, shape (p, p); without them the file states no
            uncertainty that a program could use.

    Raises:
        InputError: the file cannot be written or is there already, a reader would refuse it, or it would
            state another value than ``fitted``.
    """
    known = {quantity.name: quantity for quantity in fitted}
    stated = {parameter.name for parameter in model.parameters if parameter.name in values}
    apart = ", ".join(quantity.name for quantity in fitted if quantity.name not in stated)
    lines = [
        f"# {' '.join(comment.split())}",
        *([f"# of the record, not of this model: {apart}"] if apart else []),
        f"name: {name}",
        f"terms: [{', '.join(term.name for term in model.terms)}]",
        "parameters:",
    ]
    for parameter in model.parameters:
        if parameter.name in values:
            found = known.get(parameter.name)
            note = "held" if found is None else "one choice of several that act alike"
            if found is not None and math.isfinite(found.value):
                note = uncertainty.width(found.value, found.standard_deviation)
            lines.append(f"  {parameter.name}: {float(values[parameter.name])!r}  # {parameter.unit}, {note}")
    names, matrix = correlated
    kept = [
        place
        for place, one in enumerate(names)
        if one in values and one in known and math.isfinite(known[one].standard_deviation)
    ]
    if kept:
        deviations = [float(known[names[place]].standard_deviation) for place in kept]
        lines += [
            "uncertainty:  # standard deviations, and the correlation matrix row by row",
            f"  parameters: [{', '.join(names[place] for place in kept)}]",
            f"  std: {deviations}",
            "  correlation:",
            *(f"    - {matrix[place, kept].tolist()}" for place in kept),
        ]
    text = "\n".join(lines) + "\n"
    check_output(path, "--save-model")
    where = f"--save-model {path}: not written"
    written = model_from_mapping(load_yaml(text), where)
    for one in fitted:
        if one.name in stated and math.isfinite(one.value):
            value = written.values[one.name]
            if abs(value - one.value) > AGREEMENT * abs(one.value):
                raise InputError(f"{where}: {one.name}: {one.value:g} {one.unit} was found, not {value:g}")
    write_file(path, text, "--save-model")


def _with_unit(value: float, unit: str) -> str:
    return f"{number(value)}{uncertainty.unit_text(unit)}" if math.isfinite(value) else uncertainty.UNKNOWN


def _number(value: float, digits: str) -> str:
    return f"{value:{digits}}" if math.isfinite(value) else "?"
