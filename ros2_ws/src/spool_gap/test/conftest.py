"""Searches of these tests run to their end, so that no verdict depends on how busy the machine is."""

from __future__ import annotations

import math

import pytest


@pytest.fixture(autouse=True)
def _searched_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spool_gap.evidence.analyse.ALLOWED", math.inf)
