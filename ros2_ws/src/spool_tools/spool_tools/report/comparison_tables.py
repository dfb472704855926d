"""Tables of a comparison: as JSON, and as rows of text for a terminal and a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from spool_core.uncertainty import LEGEND, with_interval

from .fit_tables import to_dictionary
from .ranking import WORTH, FittedSeries, Ranking
from .validated_fit import ValidatedFit


def comparison_dictionary(series: Sequence[FittedSeries], ranking: Ranking) -> dict[str, Any]:
    """Return what ``compare --json`` writes; NaN where something is not known."""
    best = min(
        (entry.criterion for entry in ranking.ranks if math.isfinite(entry.criterion)), default=math.nan
    )
    return {
        "preferred": ranking.preferred,
        "equal": list(ranking.equal),
        "verdict": " ".join(ranking.sentences),
        "ranking": [
            {
                "model": entry.model,
                "parameters": entry.parameters,
                "error": {"value": entry.error, "unit": "m/s^2"},
                "error_over_least": entry.excess + 1.0,
                "information_criterion": entry.criterion,
                "information_criterion_behind": entry.criterion - best,
                "objective": entry.objective,
                "amplitude_ratio": entry.amplitude_ratio,
                "nrmse": entry.training_error,
                "nrmse_held_out": entry.held_out_error,
                "reason": entry.reason,
            }
            for entry in ranking.ranks
        ],
        "series": [
            {
                "records": [str(path) for path in one.data.paths],
                "held_out_records": [str(path) for path in one.data.held_paths],
                "valve": one.data.valve.id,
                "models": {validated.name: to_dictionary(validated) for validated in one.validated},
            }
            for one in series
        ],
    }


def series_rows(one: FittedSeries) -> list[dict[str, str]]:
    """Return a row of text for each model: how well it holds, as in the paper's tables 3 to 6."""
    return [
        {
            "model": validated.name.replace("_", " "),
            "objective (33)": _number(math.nan if agreement is None else agreement.objective, ".4g"),
            "a_est/a_pom": _number(math.nan if agreement is None else agreement.amplitude_ratio, ".4f"),
            "nrmse": _number(validated.training_error, ".4f"),
            "held out": _number(validated.held_out_error, ".4f"),
        }
        for validated in one.validated
        for agreement in (validated.fit.agreement,)
    ]


def parameter_lines(validated: ValidatedFit) -> list[str]:
    """Return the fitted parameters, a line each; those that only act together as their combination."""
    found = validated.fit
    if found.reason is not None:
        return [f"no result: {found.reason}"]
    lines = []
    for quantity in (*found.parameters, *found.combinations):
        if math.isfinite(quantity.value):
            value = with_interval(quantity.value, quantity.standard_deviation, quantity.unit)
            bound = ", at its bound" if quantity.name in found.at_bound else ""
            name = quantity.name.replace("_", " ")
            lines.append(f"{name} {value}{bound}")
    untold = [name.replace("_", " ") for name in found.not_observable]
    if untold:
        lines.append(f"not told: {', '.join(untold)}")
    if not found.converged:
        lines.append("NOT converged")
    return lines


def ranking_rows(ranking: Ranking) -> list[dict[str, str]]:
    """Return a row of text for each model, best first; means over the series, as the paper's table 7."""
    best = min(
        (entry.criterion for entry in ranking.ranks if math.isfinite(entry.criterion)), default=math.nan
    )
    return [
        {
            "model": entry.model.replace("_", " "),
            "par.": str(entry.parameters or ""),
            "error": _number(entry.error, ".4g"),
            "more": _more(entry.excess),
            "BIC": _number(entry.criterion - best, "+.0f"),
            "(33)": _number(entry.objective, ".3g"),
            "ratio": _number(entry.amplitude_ratio, ".3f"),
            "held out": _number(entry.held_out_error, ".4f"),
        }
        for entry in ranking.ranks
    ]


def print_comparison(series: Sequence[FittedSeries], ranking: Ranking, console: Console) -> None:
    """Show parameters of each series, the ranking over all, and what it means."""
    for one in series:
        console.print(f"[bold]{one.data.name}[/bold] ({one.data.valve.id})", highlight=False)
        for validated in one.validated:
            text = f"  {validated.name.replace('_', ' ')}: {', '.join(parameter_lines(validated))}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        _print(series_rows(one), console)
    console.print(LEGEND, markup=False, highlight=False, soft_wrap=True)
    console.print("[bold]Ranking[/bold]", highlight=False)
    _print(ranking_rows(ranking), console)
    for sentence in ranking.sentences:
        console.print(sentence, markup=False, highlight=False, soft_wrap=True)


#: What the columns of the ranking mean.
COLUMNS = (
    "par.: parameters that were fitted.",
    "error: what the free run leaves over, rms, m/s², on held-out data where there are any. A few samples "
    "around every jump of dry friction are left out, the same for all models.",
    f"more: beyond the least error. Within {100.0 * WORTH:g} % models do equally well, and the one with the "
    "fewest parameters comes first.",
    "BIC: Bayesian information criterion on the fitted data (Whittle's likelihood, every sample), behind the "
    "best.",
    "(33), ratio, held out: the paper's objective and mean amplitude ratio a_est/a_pom, and the nrmse on "
    "held-out data, every sample counted; means over the series.",
)


def _more(excess: float) -> str:
    if math.isnan(excess):
        return ""
    return f"{100.0 * excess:+.1f} %" if excess < 1.0 else f"x {1.0 + excess:.3g}"


def _print(rows: Sequence[dict[str, str]], console: Console) -> None:
    table = Table(box=None, pad_edge=False)
    for column in rows[0]:
        table.add_column(column, justify="left" if column == "model" else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row.values())
    console.print(table)


def _number(value: float, digits: str) -> str:
    return f"{value:{digits}}" if math.isfinite(value) else "?"
