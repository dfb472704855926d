"""The study of the estimates as a table and a picture for the documentation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, cast

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from .estimation_summary import ALL, Estimated, summary

if TYPE_CHECKING:
    from .estimation import Row

PAGE, PICTURE = "estimation_study.md", "estimation_scores.png"


def write_page(rows: Sequence[Row], folder: Path, command: str) -> Path:
    """Write the table and the picture into ``folder``; return the page."""
    estimates = [entry for row in rows if row.converged for entry in row.estimates]
    figure = scores_figure(estimates)
    figure.savefig(folder / PICTURE, dpi=130)
    plt.close(figure)
    page = folder / PAGE
    page.write_text(page_text(rows, command), encoding="utf-8")
    return page


def page_text(rows: Sequence[Row], command: str) -> str:
    """Return the page, Markdown."""
    estimates = [entry for row in rows if row.converged for entry in row.estimates]
    failed = [row for row in rows if row.reason is not None]
    untold: dict[tuple[str, str], int] = {}
    for row in rows:
        for name in row.not_observable:
            untold[row.model, name] = untold.get((row.model, name), 0) + 1
    lines = [
        "# Study of the estimates",
        "",
        f"{len(rows)} simulated records of 20 s at 2 kHz, made and fitted by `{command}`; what they are: "
        "[estimation.md](estimation.md). "
        f"{len(failed)} without a result, {sum(not row.converged for row in rows)} that say they did not "
        "converge; those are not in the table. "
        f"A fit took {median(row.seconds for row in rows):.1f} s (median).",
        "",
        "Here truth and fit share one simulator, and the model fitted is the one that made the record: the "
        "table shows whether noise is turned into standard deviations rightly, not what an error of the "
        "simulation or a law that is missing does to the values. For that see the "
        "[sample records](estimation.md#does-it-hold), made by another simulator, and the "
        "[blind cases](gap_study.md).",
        "",
        "| model | quantity | fits | covered | share (95 % interval) | mean error | scatter "
        "| median standard deviation |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for entry in summary(estimates):
        low, high = 100 * entry["coverage_low"], 100 * entry["coverage_high"]
        share = f"{100 * entry['coverage']:.0f} % ({low:.0f} to {high:.0f})"
        whole = entry["model"] == ALL
        parts = (
            entry["model"],
            "all" if whole else f"`{entry['quantity']}`",
            str(entry["fits"]),
            str(entry["covered"]),
            share,
            "" if whole else f"{100 * entry['bias']:+.3f} %",
            "" if whole else f"{100 * entry['scatter']:.3f} %",
            "" if whole else f"{100 * entry['median_deviation']:.3f} %",
        )
        lines.append("| " + " | ".join(parts) + " |")
    lines += ["", f"![errors over their standard deviations]({PICTURE})", ""]
    if untold:
        lines += ["Parameters that a fit said it cannot tell, by number of records:", ""]
        lines += [f"- {model}: `{name}` in {count}" for (model, name), count in sorted(untold.items())]
    return "\n".join(lines) + "\n"


def scores_figure(estimates: Sequence[Estimated]) -> Figure:
    """Return the errors over their standard deviations, beside the normal distribution."""
    scores = np.clip([entry.score for entry in estimates], -6.0, 6.0)
    figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
    edges = np.linspace(-6.0, 6.0, 49)
    axes.hist(scores, bins=list(edges), density=True, color="#0072B2", alpha=0.7, label="estimates")
    place = np.linspace(-6.0, 6.0, 241)
    axes.plot(place, np.exp(-0.5 * place**2) / math.sqrt(2.0 * math.pi), color="black", label="normal")
    axes.set_xlabel("error / standard deviation")
    axes.set_ylabel("density")
    axes.legend(frameon=False)
    return cast(Figure, figure)
