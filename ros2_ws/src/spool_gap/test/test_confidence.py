"""Confidence: a frequency where it was calibrated, no more than the share right of its kind elsewhere."""

from __future__ import annotations

import json
from importlib.resources import files

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_gap.report.confidence import calibrated, kind_of, uncalibrated

RULE = json.loads(files("spool_gap.report").joinpath("confidence_rule.json").read_text())
VERDICTS = ("none", "coulomb_friction", "coulomb_friction+end_stop+unexplained", "unexplained")


def signs(**changed: float) -> dict[str, float]:
    """Return the signs of a verdict in the middle of the calibration."""
    own = {name: mean for kind in RULE["kinds"].values() for name, (mean, _, _) in kind["weights"].items()}
    middle = {name: 0.5 * (low + high) for name, (low, high) in RULE["ranges"].items()}
    return {**own, **middle, **changed}


def test_each_kind_of_verdict_was_calibrated_on_some_tens_of_cases() -> None:
    assert [kind_of(verdict) for verdict in VERDICTS] == list(RULE["kinds"])
    assert all(kind["of"] >= 5 for kind in RULE["kinds"].values())
    assert sum(kind["of"] for kind in RULE["kinds"].values()) == RULE["cases"] >= 80


@given(st.sampled_from(VERDICTS), st.floats(-1e3, 1e3), st.floats(0.0, 1.0), st.floats(0.0, 9.0))
def test_no_confidence_exceeds_what_so_few_cases_can_show(
    verdict: str, margin: float, share: float, nuisances: float
) -> None:
    found = calibrated(verdict, signs(margin=margin, predictable=share, nuisances=nuisances))
    cases = RULE["kinds"][kind_of(verdict)]["of"]
    assert 1.0 / (cases + 2.0) <= found.value <= (cases + 1.0) / (cases + 2.0)
    assert found.note == ""


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.parametrize(("name", "value"), [("sample_rate", 200.0), ("duration", 4000.0)])
def test_outside_of_the_calibration_it_is_capped_and_says_what_is_unknown(
    verdict: str, name: str, value: float
) -> None:
    found = calibrated(verdict, signs(**{name: value}))
    kind = RULE["kinds"][kind_of(verdict)]
    assert found.value <= kind["right"] / kind["of"]
    assert f"{value:.4g}" in found.note


def test_a_force_record_s_confidence_is_capped_at_the_share_right_of_all() -> None:
    right = sum(kind["right"] for kind in RULE["kinds"].values())
    found = uncalibrated(0.99, "force records")
    assert found.value == pytest.approx(right / RULE["cases"])
    assert "force records" in found.note
