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


def first(drag: float, dry: float, **more: float) -> str:
    return rank_friction(moved("viscous_coefficient", drag), moved("coulomb_force", dry), 0.05, **more)[
        0
    ].name


@pytest.mark.parametrize(
    ("drag", "dry", "cause"),
    [
        (-1.5, 0.0, "wear"),
        (-1.5, 0.1, "wear"),
        (-1.5, -0.1, "wear"),
        (0.0, 1.2, "oil_contamination"),
        (0.4, 1.2, "oil_contamination"),
        (-0.8, 1.5, "oil_contamination"),
        (1.5, 0.0, "oil_viscosity"),
        (0.0, -1.5, "unknown"),
    ],
)
def test_what_moved_points_to_the_cause(drag: float, dry: float, cause: str) -> None:
    assert first(drag, dry) == cause


@given(drag=st.floats(-5.0, 5.0), dry=st.floats(-5.0, 5.0), velocity=st.floats(1e-4, 1.0))
def test_shares_are_ranked_and_add_to_one(drag: float, dry: float, velocity: float) -> None:
    ranked = rank_friction(moved("viscous_coefficient", drag), moved("coulomb_force", dry), velocity)
    assert sum(cause.share for cause in ranked) == pytest.approx(1.0)
    assert [cause.share for cause in ranked] == sorted((cause.share for cause in ranked), reverse=True)
    assert {cause.parameter for cause in ranked} <= {"viscous_coefficient", "coulomb_force"}


def test_a_drag_that_falls_as_the_oil_warms_is_the_oils_where_nothing_was_referred() -> None:
    drag = moved("viscous_coefficient", -1.5, referred=False)
    dry = moved("coulomb_force", 0.0)
    assert rank_friction(drag, dry, 0.05, warmer=8.0)[0].name == "oil_viscosity"
    assert rank_friction(drag, dry, 0.05, warmer=0.5)[0].name == "wear"
    assert rank_friction(drag, dry, 0.05, warmer=-8.0)[0].name == "wear"
    assert rank_friction(drag, dry, 0.05, warmer=math.nan)[0].name == "wear"
