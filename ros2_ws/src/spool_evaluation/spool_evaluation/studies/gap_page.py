"""The blind study as a page of text and a picture."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from .gap_summary import RECOVERED, Row, confusion, share_of, targets

PICTURE = "confusion.png"


def write_page(rows: Sequence[Row], folder: Path, command: str) -> Path:
    """Write ``confusion.md`` and its picture into ``folder``; return the page."""
    figure = confusion_figure(rows)
    figure.savefig(folder / PICTURE, dpi=150)
    plt.close(figure)
    page = folder / "confusion.md"
    page.write_text(page_text(rows, command))
    return page


def page_text(rows: Sequence[Row], command: str) -> str:
    """Return the page, Markdown."""
    times = [row.seconds for row in rows]
    computing = median(row.processor_seconds for row in rows)
    parts = [
        "# The gap workflow over blind cases",
        f"{len(rows)} cases, made by `{command}`. "
        f"A case: median {median(times):.1f} s ({computing:.1f} s of computing), longest {max(times):.1f} s.",
        _table(
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
    return "\n\n".join(parts) + "\n"


def _table(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in body)]
    return "\n".join(f"| {line} |" for line in lines)


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.2g}"


def _middle(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None


def _by_hidden(rows: Sequence[Row]) -> str:
    body = []
    hidden, _, _ = confusion(rows)
    for name in hidden:
        these = [row for row in rows if name in (row.hidden, row.kind)]
        visible = _middle([row.visible for row in these])
        body.append((
            name,
            str(share_of(these, lambda row: row.right)),
            _percent(_middle([row.before for row in these])),
            _percent(_middle([row.after for row in these])),
            _percent(_middle([row.floor for row in these])),
            "" if visible is None else f"{visible:.1f}",
        ))  # fmt: skip
    head = ("hidden", "right", "gap before, %", "after, %", "floor, %", "hidden over noise, rms")
    return _table(head, body)


def _by_parameter(rows: Sequence[Row]) -> str:
    errors: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        if row.right and row.kind == "effect":
            for name, error in row.errors.items():
                errors[name].append(error)
    body = [
        (
            name,
            str(len(found)),
            f"{100.0 * median(found):+.1f}",
            f"{100.0 * median(abs(error) for error in found):.1f}",
            f"{100.0 * max(abs(error) for error in found):.1f}",
            f"{sum(abs(error) <= RECOVERED for error in found)}/{len(found)}",
        )
        for name, found in sorted(errors.items())
    ]
    head = ("parameter", "cases", "median error, %", "median size, %", "largest, %", "within 10 %")
    return _table(head, body)


def _failures(rows: Sequence[Row]) -> str:
    wrong = [row for row in sorted(rows, key=lambda row: row.seed) if not row.right]
    if not wrong:
        return "Nothing."
    return _table(
        (
            "seed",
            "hidden",
            "verdict",
            "confidence",
            "gap before, after, floor %",
            "hidden over noise",
            "condition",
        ),
        [
            (
                str(row.seed),
                row.hidden,
                row.verdict + (f": {row.message}" if row.message else ""),
                "" if row.confidence is None else f"{row.confidence:.2f}",
                ", ".join(_percent(value) for value in (row.before, row.after, row.floor)),
                "" if row.visible is None else f"{row.visible:.1f}",
                row.condition,
            )
            for row in wrong
        ],
    )


def confusion_figure(rows: Sequence[Row]) -> Figure:
    """Return the confusion matrix: rows are what was hidden, columns what was said."""
    hidden, verdicts, counts = confusion(rows)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure: Figure
    figure, axis = plt.subplots(
        figsize=(2.8 + 0.42 * len(verdicts), 1.8 + 0.3 * len(hidden)), layout="constrained"
    )
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
