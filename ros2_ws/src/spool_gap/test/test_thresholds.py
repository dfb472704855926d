"""Every number that decides states its unit, use and origin; a resonance needs a body that shakes."""

from __future__ import annotations

from dataclasses import Field, fields
from types import SimpleNamespace

import pytest
from spool_core.record_limits import Limits
from spool_estimator.identification.nuisances import Nuisance
from spool_gap.result import GapResult


@pytest.mark.parametrize("limit", fields(Limits), ids=lambda limit: limit.name)
def test_a_limit_states_its_unit_its_use_and_its_origin(limit: Field[float]) -> None:
    assert limit.default
    assert limit.metadata["unit"] in {"1", "s", "Hz", "ln"}
    assert len(limit.metadata["decides"].split()) > 3
    assert len(limit.metadata["origin"].split()) > 3


@pytest.mark.parametrize(("frequency", "found"), [(110.0, 110.0), (601.0, None)])
def test_a_mode_where_the_body_does_not_shake_is_no_resonance_of_the_valve(
    frequency: float, found: float | None
) -> None:
    mode = Nuisance("extra_mode", "spool", frequency, 1.0, "Hz", corrected=False, check="")
    result = SimpleNamespace(nuisances=(mode,), excited_to=150.0)
    assert GapResult.linear_anomaly.fget(result) == found  # type: ignore[attr-defined]
