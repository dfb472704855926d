"""Calibration of confidences: logistic regression of what is right on the signs of verdicts, kind by kind.

The penalty keeps weights small where few verdicts are seen: with unit variance of the signs, a weight of 1 is
as likely beforehand as one standard deviation of a normal distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_expit
from spool_core.numbers import Array
from spool_gap.report.confidence import NAMES, NONE, PARTLY, UNEXPLAINED, WORDS, kind_of

from .summary import FAILED, REFUSED, RIGHT, FieldVerdict

#: Signs of each kind of verdict; few, since a kind has some tens of verdicts.
SIGNS = {
    NONE: ("power", "predictable", "level", "nuisances"),
    NAMES: ("margin", "importance", "power", "predictable", "names", "nuisances"),
    PARTLY: ("margin", "importance", "predictable", "share", "nuisances"),
    UNEXPLAINED: ("power", "predictable", "share", "nuisances"),
}


def confidence_rule(rows: Sequence[FieldVerdict], origin: str) -> dict[str, Any]:
    """Return the rule that ``spool_gap.report.confidence`` reads, fitted to ``rows``.

    ``origin``: how it was made, for who wants to make it again.
    """
    judged = [row for row in rows if row.verdict not in (REFUSED, FAILED) and row.signs]
    ranges = {
        name: [min(row.signs[name] for row in judged), max(row.signs[name] for row in judged)]
        for name in WORDS
    }
    kinds = {}
    for kind, names in SIGNS.items():
        these = [row for row in judged if kind_of(row.verdict) == kind]
        kinds[kind] = _regression(these, names)
    return {"origin": origin, "cases": len(judged), "ranges": ranges, "kinds": kinds}


def _regression(rows: Sequence[FieldVerdict], names: Sequence[str]) -> dict[str, Any]:
    hits = np.array([row.outcome == RIGHT for row in rows], dtype=np.float64)
    signs = np.array([[row.signs[name] for name in names] for row in rows]).reshape(len(rows), len(names))
    mean, spread = signs.mean(axis=0), np.maximum(signs.std(axis=0), 1e-6)
    scaled = (signs - mean) / spread

    def cost(numbers: Array) -> float:
        score = numbers[0] + scaled @ numbers[1:]
        likelihood = float(np.sum(hits * log_expit(score) + (1.0 - hits) * log_expit(-score)))
        return 0.5 * float(numbers[1:] @ numbers[1:]) + 0.02 * float(numbers[0] ** 2) - likelihood

    best = minimize(cost, np.zeros(1 + len(names)), method="BFGS").x
    weights = {
        name: [float(mean[place]), float(spread[place]), float(best[1 + place])]
        for place, name in enumerate(names)
    }
    ranges = {name: [float(row.min()), float(row.max())] for name, row in zip(names, signs.T, strict=True)}
    return {
        "right": int(hits.sum()),
        "of": len(rows),
        "intercept": float(best[0]),
        "weights": weights,
        "ranges": ranges,
    }
