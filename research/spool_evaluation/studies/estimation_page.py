"""Result page of the coverage study: a table and a picture."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.figure import Figure

from spool_evaluation.results.page import markdown_table, save_picture, write_page

from .estimation_summary import ALL, Estimated, RecordFit, summary

PAGE, PICTURE = "estimation_study.md", "estimation_scores.png"
TITLE = "Coverage of the intervals of offline fits"
LIMITS = (
    "Here truth and fit share one simulator, and the model fitted is the one that made the record: the table "
    "shows whether noise is turned into standard deviations rightly, not what an error of the simulation or "
    "a law that is missing does to the values. For that see the [sample records](estimation_records.md), "
    "made by another simulator, and the [blind cases](gap_study.md)."
)


def write_study(rows: Sequence[RecordFit], folder: Path, command: str) -> Path:
    """Write the table and the picture into ``folder``; return the page."""
    estimates = [entry for row in rows if row.converged for entry in row.estimates]
    save_picture(scores_figure(estimates), folder / PICTURE)
    return write_page(folder / PAGE, TITLE, command, page_parts(rows, estimates))


def page_parts(rows: Sequence[RecordFit], estimates: Sequence[Estimated]) -> list[str]:
    """Return the page's paragraphs and its table, Markdown."""
    failed = sum(row.reason is not None for row in rows)
    unobservable = Counter((row.model, name) for row in rows for name in row.not_observable)
    parts = [
        f"{len(rows)} simulated records of 20 s at 2 kHz; what they are: "
        "[how it is tested](../methods/estimation.md#does-it-hold). "
        f"{failed} without a result, {sum(not row.converged for row in rows)} that say they did not "
        "converge; those are not in the table. "
        f"A fit took {median(row.seconds for row in rows):.1f} s (median).",
        LIMITS,
        coverage_table(estimates),
        f"![errors over their standard deviations]({PICTURE})",
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
