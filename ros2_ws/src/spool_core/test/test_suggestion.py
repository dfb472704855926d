"""Names that people mistype."""

from __future__ import annotations

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


@pytest.mark.parametrize("given", ["", "magic", "x" * 10_000])
def test_nothing_is_suggested_where_nothing_is_near(given: str) -> None:
    assert did_you_mean(given, MODELS) == ""


def test_nothing_is_suggested_where_nothing_is_known() -> None:
    assert did_you_mean("coulomb", ()) == ""
