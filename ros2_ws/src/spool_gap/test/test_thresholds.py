"""Every number that decides states its unit, use and origin; a resonance needs a body that shakes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from spool_estimator.identification.nuisances import Nuisance
from spool_gap.checks import described
from spool_gap.result import GapResult


@pytest.mark.parametrize("name", sorted(described()))
def test_a_threshold_tells_its_unit_its_use_and_its_origin(name: str) -> None:
    value, unit, decides, origin = described()[name]
    assert value
    assert unit in {"1", "s", "ln"}
    assert len(decides.split()) > 3
    assert len(origin.split()) > 3 or origin == "95 % interval"


@pytest.mark.parametrize(("frequency", "found"), [(110.0, 110.0), (601.0, None)])
def test_a_mode_where_the_body_does_not_shake_is_no_resonance_of_the_valve(
    frequency: float, found: float | None
) -> None:
    mode = Nuisance("extra_mode", "spool", frequency, 1.0, "Hz", corrected=False, check="")
    result = SimpleNamespace(nuisances=(mode,), excited_to=150.0)
    assert GapResult.linear_anomaly.fget(result) == found  # type: ignore[attr-defined]
