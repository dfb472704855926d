"""Confidence of a verdict: how often verdicts of such signs are right, by logistic regression.

The regression was fitted to verdicts on simulated records behind the faults of real measuring chains, whose
truth is known (`./spool study field` over its calibration window). It lies in ``confidence_rule.json``.

Sources: J. Platt,
Probabilistic outputs for support vector machines, 1999; A. Niculescu-Mizil and R. Caruana, Predicting good
probabilities with supervised learning, ICML 2005.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from scipy.special import expit

NONE, UNEXPLAINED = "none", "unexplained"
#: Kinds of verdict, each with a regression of its own.
NAMES, PARTLY = "names", "names and unexplained"
#: What a sign says, with its unit, for the note that a record lies outside of the calibration.
WORDS = {
    "sample_rate": ("samples a second", "Hz"),
    "duration": ("length of the record", "s"),
    "power": ("logarithm of what is left over white noise", "1"),
}


@dataclass(frozen=True, slots=True)
class Confidence:
    """Confidence of a verdict, 0 to 1, and why it is capped, empty where it is not."""

    value: float
    note: str = ""


def kind_of(verdict: str) -> str:
    """Return the kind of ``verdict``: ``none``, ``unexplained``, names, or names with something left."""
    if verdict in (NONE, UNEXPLAINED):
        return verdict
    return PARTLY if UNEXPLAINED in verdict.split("+") else NAMES


def calibrated(verdict: str, signs: Mapping[str, float]) -> Confidence:
    """Return the confidence of ``verdict`` with ``signs``: those of the rule's regressions and its ranges.

    Outside of the ranges of the calibration, nobody knows the frequency: it is at most that of its kind.
    """
    rule = _rule()
    own = rule["kinds"][kind_of(verdict)]
    score = own["intercept"]
    for name, (mean, spread, weight) in own["weights"].items():
        # No farther out than the calibration saw.
        low, high = own["ranges"][name]
        score += weight * (min(max(signs[name], low), high) - mean) / spread
    # By Laplace's rule of succession: no frequency is known better than by the cases that showed it.
    most = (own["of"] + 1.0) / (own["of"] + 2.0)
    value = min(max(float(expit(score)), 1.0 - most), most)
    outside = [
        f"{WORDS[name][0]} {signs[name]:.4g} {WORDS[name][1]}, calibrated for {low:.4g} to {high:.4g}"
        for name, (low, high) in rule["ranges"].items()
        if not low <= signs[name] <= high
    ]
    if not outside:
        return Confidence(value)
    capped = min(value, own["right"] / own["of"])
    return Confidence(capped, f"outside of what it was calibrated on: {', '.join(outside)}")


def uncalibrated(value: float, of_what: str) -> Confidence:
    """Return ``value`` of a verdict on what no calibration holds, at most the share right of all kinds."""
    kinds = _rule()["kinds"].values()
    share = sum(kind["right"] for kind in kinds) / sum(kind["of"] for kind in kinds)
    return Confidence(min(value, share), f"not calibrated for {of_what}")


def logarithm(value: float) -> float:
    """Return the logarithm of 1 + ``value`` where that is above zero, else 0: a sign of evidence."""
    return math.log1p(max(0.0, value)) if math.isfinite(value) else 0.0


@cache
def _rule() -> dict[str, Any]:
    text = files(__package__).joinpath("confidence_rule.json").read_text(encoding="utf-8")
    rule: dict[str, Any] = json.loads(text)
    return rule
