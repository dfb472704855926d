"""Result page of the blind study: tables and the confusion matrix as a picture."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.figure import Figure

from spool_evaluation.results.page import markdown_table, save_picture, write_page

from .gap_summary import RECOVERED, BlindVerdict, confusion, share_of, targets

PAGE, PICTURE = "gap_study.md", "gap_confusion.png"
TITLE = "Blind study of the gap workflow"
#: What the tables count, for a reader who comes from elsewhere.
ABOUT = (
    "Records of a [second simulator](../../research/spool_blind/README.md) that shares no law and no step "
    "with the one that ships. What the figures mean, and what falls short: "
    "[how often it is right](../methods/gap.md#how-often-it-is-right)."
)


def write_study(rows: Sequence[BlindVerdict], folder: Path, command: str) -> Path:
    """Write ``gap_study.md`` and its picture into ``folder``; return the page."""
    save_picture(confusion_figure(rows), folder / PICTURE, dpi=150)
    return write_page(folder / PAGE, TITLE, command, page_parts(rows))


def page_parts(rows: Sequence[BlindVerdict]) -> list[str]:
    """Return the page's paragraphs and tables, Markdown."""
    times = [row.seconds for row in rows]
    computing = median(row.processor_seconds for row in rows)
    return [
        ABOUT,
        f"{len(rows)} cases. A case: median {median(times):.1f} s ({computing:.1f} s of computing), "
        f"longest {max(times):.1f} s.",
        markdown_table(
            ("question", "target", "found (95 % interval)", "met"),
            [(t.name, t.wanted, str(t.share), t.answer) for t in targets(rows)],
        ),
        f"![confusion matrix]({PICTURE})",
        "## By what was hidden",
        _by_hidden(rows),
        "## Parameters",
        _by_parameter(rows),
        "## What went wrong",
        _failures(rows),
    ]


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.2g}"


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None


def _by_hidden(rows: Sequence[BlindVerdict]) -> str:
    body = []
    hidden, _, _ = confusion(rows)
    for name in hidden:
        these = [row for row in rows if name in (row.hidden, row.kind)]
        visible = _median([row.visible for row in these])
        body.append((
            name,
            str(share_of(these, lambda row: row.right)),
            _percent(_median([row.before for row in these])),
            _percent(_median([row.after for row in these])),
            _percent(_median([row.floor for row in these])),
            "" if visible is None else f"{visible:.1f}",
        ))  # fmt: skip
    head = ("hidden", "right", "gap before, %", "after, %", "noise floor, %", "hidden over noise, rms")
    return markdown_table(head, body)


def _by_parameter(rows: Sequence[BlindVerdict]) -> str:
    errors: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        if row.right and row.kind == "effect":
            for name, error in row.errors.items():
                errors[name].append(error)
    body = []
    for name, found in sorted(errors.items()):
        sizes = [abs(error) for error in found]
        body.append((
            name,
            str(len(found)),
            f"{100.0 * median(found):+.1f}",
            f"{100.0 * median(sizes):.1f}",
            f"{100.0 * max(sizes):.1f}",
            f"{sum(size <= RECOVERED for size in sizes)}/{len(sizes)}",
        ))  # fmt: skip
    head = ("parameter", "cases", "median error, %", "median size, %", "largest, %", "within 10 %")
    return markdown_table(head, body)


def _failures(rows: Sequence[BlindVerdict]) -> str:
    body = [
        (
            str(row.seed),
            row.hidden,
            row.verdict + (f": {row.message}" if row.message else ""),
            "" if row.confidence is None else f"{row.confidence:.2f}",
            ", ".join(_percent(value) for value in (row.before, row.after, row.floor)),
            "" if row.visible is None else f"{row.visible:.1f}",
            row.condition,
        )
        for row in sorted(rows, key=lambda row: row.seed)
        if not row.right
    ]
    gap = "gap before, after, noise floor, %"
    head = ("seed", "hidden", "verdict", "confidence", gap, "hidden over noise", "condition")
    return markdown_table(head, body) if body else "Nothing."


def confusion_figure(rows: Sequence[BlindVerdict]) -> Figure:
    """Return the confusion matrix: rows are what was hidden, columns what was said."""
    hidden, verdicts, counts = confusion(rows)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    size = (2.8 + 0.42 * len(verdicts), 1.8 + 0.3 * len(hidden))
    figure = Figure(figsize=size, layout="constrained")
    axis = figure.subplots()
    axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            colour = "white" if shares[row, column] > 0.6 else "black"
            axis.text(column, row, str(count), ha="center", va="center", fontsize=8, color=colour)
    axis.set_xticks(range(len(verdicts)), verdicts, rotation=60, ha="right", fontsize=8)
    axis.set_yticks(range(len(hidden)), hidden, fontsize=8)
    axis.set_xlabel("said")
    axis.set_ylabel("hidden")
    return figure
