"""Calibration: the regression finds the probability that made the cases, and few cases keep it modest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spool_evaluation.studies.field.calibration import SIGNS, confidence_rule
from spool_evaluation.studies.field.summary import FieldVerdict
from spool_gap.report.confidence import NAMES

ALL = sorted({name for names in SIGNS.values() for name in names})


def verdicts(count: int, slope: float) -> list[FieldVerdict]:
    """Return verdicts right with the probability 1 / (1 + exp(-slope margin)), and one of each kind."""
    draw = np.random.default_rng(5)
    found = []
    for number in range(count):
        margin = float(draw.standard_normal())
        right = draw.random() < 1.0 / (1.0 + math.exp(-slope * margin))
        signs = dict.fromkeys(ALL, 0.0) | {"margin": margin, "sample_rate": 2e3, "duration": 40.0}
        verdict = "end_stop" if right else "spring_preload"
        found.append(
            FieldVerdict(
                number, "calibration", "effect", "end_stop", ("end_stop",), {}, (), verdict, signs=signs
            )
        )
    for verdict in ("none", "unexplained", "end_stop+unexplained"):
        signs = dict.fromkeys(ALL, 0.0) | {"sample_rate": 2e3, "duration": 40.0}
        found.append(FieldVerdict(0, "calibration", "none", "none", ("none",), {}, (), verdict, signs=signs))
    return found


def test_the_slope_that_made_the_cases_is_found() -> None:
    rule = confidence_rule(verdicts(3000, 2.0), "test")["kinds"][NAMES]
    mean, spread, weight = rule["weights"]["margin"]
    assert weight / spread == pytest.approx(2.0, rel=0.1)
    assert abs(rule["intercept"] + weight * -mean / spread) < 0.15
    assert rule["of"] == 3000


def test_few_cases_that_are_all_right_give_no_certainty() -> None:
    rule = confidence_rule(verdicts(8, 50.0), "test")["kinds"][NAMES]
    assert abs(rule["weights"]["margin"][2]) < 3.0
