from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_monitor.detectors.friction_drift import rank_friction
from spool_monitor.parameter_drift import ParameterDrift
from spool_monitor.state_file import Baseline


def moved(parameter: str, share: float, *, referred: bool = True) -> ParameterDrift:
    """Return a parameter that changed by ``share`` of what matters, from a start value of 2."""
    relative = parameter == "viscous_coefficient"
    made = ParameterDrift(parameter, 0.2 if relative else 0.1, relative, Baseline(3.0))
    made.baseline.value, made.baseline.spread = 2.0, 0.0
    made.referred = referred
    made._smoothed = share
    return made


@pytest.mark.parametrize(
    ("parameter", "share", "cause"),
    [
        ("viscous_coefficient", -1.5, "wear"),
        ("viscous_coefficient", 1.5, "oil_viscosity"),
        ("coulomb_force", 1.2, "oil_contamination"),
        ("coulomb_force", -1.5, "unknown"),
    ],
)
def test_what_moved_points_to_the_cause(parameter: str, share: float, cause: str) -> None:
    assert next(iter(rank_friction(moved(parameter, share)))) == cause


@given(
    parameter=st.sampled_from(["viscous_coefficient", "coulomb_force"]),
    share=st.floats(-5.0, 5.0),
    warmer=st.floats(-50.0, 50.0) | st.just(math.nan),
    referred=st.booleans(),
)
def test_probabilities_are_ranked_and_add_to_one(
    parameter: str, share: float, warmer: float, *, referred: bool
) -> None:
    ranked = list(rank_friction(moved(parameter, share, referred=referred), warmer).values())
    assert sum(ranked) == pytest.approx(1.0)
    assert ranked == sorted(ranked, reverse=True)


def test_a_drag_that_falls_as_the_oil_warms_is_the_oils_where_nothing_was_referred() -> None:
    drag = moved("viscous_coefficient", -1.5, referred=False)
    first = {warmer: next(iter(rank_friction(drag, warmer))) for warmer in (8.0, 0.5, -8.0)}
    assert first == {8.0: "oil_viscosity", 0.5: "wear", -8.0: "wear"}
    assert next(iter(rank_friction(drag, math.nan))) == "wear"
