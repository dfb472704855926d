"""Reliability of confidences: how often verdicts of a confidence are right, and the Brier score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from spool_evaluation.results.proportion import Proportion

from .summary import NONE, RIGHT, UNEXPLAINED, FieldVerdict

#: Verdicts of a decile from which its share says anything.
ENOUGH = 20


@dataclass(frozen=True, slots=True)
class Decile:
    """Decile of the confidences from ``low`` to ``low`` + 0.1: their ``mean``, and the ``share`` right."""

    low: float
    mean: float
    share: Proportion

    @property
    def agrees(self) -> bool:
        """Whether the mean confidence lies within the interval of the share right."""
        low, high = self.share.interval
        return low <= self.mean <= high


@dataclass(frozen=True, slots=True)
class Brier:
    """Brier scores of ``count`` verdicts: mean square of confidence less outcome, 0 is best.

    ``base_rate`` is the score of who always says the share that is right.
    """

    verdicts: str
    count: int
    score: float
    base_rate: float


def deciles(rows: Sequence[FieldVerdict]) -> list[Decile]:
    """Return the deciles that have verdicts, the least confident first."""
    found = []
    for tenth in range(10):
        these = [row for row in _sure(rows) if min(9, int(10.0 * (row.confidence or 0.0) + 1e-9)) == tenth]
        if these:
            mean = sum(row.confidence or 0.0 for row in these) / len(these)
            share = Proportion(sum(row.outcome == RIGHT for row in these), len(these))
            found.append(Decile(tenth / 10.0, mean, share))
    return found


def brier_scores(rows: Sequence[FieldVerdict]) -> list[Brier]:
    """Return the scores of all verdicts, and by kind of verdict."""
    kinds = {
        "all": _sure(rows),
        "`none`": [row for row in _sure(rows) if row.verdict == NONE],
        "`unexplained`": [row for row in _sure(rows) if row.verdict == UNEXPLAINED],
        "names": [row for row in _sure(rows) if row.said and UNEXPLAINED not in row.said],
        "names with `unexplained`": [
            row for row in _sure(rows) if UNEXPLAINED in row.said and len(row.said) > 1
        ],
    }
    return [_brier(name, these) for name, these in kinds.items() if these]


def _brier(name: str, rows: Sequence[FieldVerdict]) -> Brier:
    hits = [float(row.outcome == RIGHT) for row in rows]
    base = sum(hits) / len(hits)
    pairs = zip(rows, hits, strict=True)
    score = sum(((row.confidence or 0.0) - hit) ** 2 for row, hit in pairs) / len(hits)
    return Brier(name, len(hits), score, base * (1.0 - base))


def _sure(rows: Sequence[FieldVerdict]) -> list[FieldVerdict]:
    return [row for row in rows if row.confidence is not None]


def reliability_figure(rows: Sequence[FieldVerdict]) -> Figure:
    """Return the reliability diagram: share right over mean confidence, with 95 % intervals and counts."""
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=1.0, linestyle="--")
    for decile in deciles(rows):
        low, high = decile.share.interval
        value = decile.share.value or 0.0
        axis.plot([decile.mean, decile.mean], [low, high], color="tab:blue", linewidth=1.5)
        axis.plot(decile.mean, value, "o", color="tab:blue")
        axis.annotate(str(decile.share.of), (decile.mean, high), ha="center", va="bottom", fontsize=8)
    axis.set_xlim(0.0, 1.02)
    axis.set_ylim(0.0, 1.08)
    axis.set_xlabel("confidence, mean of a decile")
    axis.set_ylabel("share right")
    return figure
