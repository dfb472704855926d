"""Names that people mistype."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from spool_core.text import did_you_mean

MODELS = ("fluid", "coulomb", "stribeck", "coulomb_hydrodynamic")


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("colomb", "coulomb"),
        ("Coulomb", "coulomb"),
        ("stribek", "stribeck"),
        ("coulomb-hydrodynamic", "coulomb_hydrodynamic"),
        ("folder/fluid.yaml", "fluid"),
    ],
)
def test_the_nearest_name_is_suggested(given: str, meant: str) -> None:
    assert did_you_mean(given, MODELS) == f"; did you mean {meant}?"


@pytest.mark.parametrize(
    ("given", "known"), [("", MODELS), ("magic", MODELS), ("x" * 10_000, MODELS), ("coulomb", ())]
)
def test_nothing_is_suggested_where_nothing_is_near(given: str, known: Sequence[str]) -> None:
    assert did_you_mean(given, known) == ""
