"""Every number that decides what is named tells its unit, its use and where it comes from."""

from __future__ import annotations

import pytest
from spool_gap.checks import described


@pytest.mark.parametrize("name", sorted(described()))
def test_a_threshold_tells_its_unit_its_use_and_its_origin(name: str) -> None:
    value, unit, decides, origin = described()[name]
    assert value
    assert unit in {"1", "s", "ln"}
    assert len(decides.split()) > 3
    assert len(origin.split()) > 3 or origin == "95 % interval"
