"""Numbers with which one sliding law acts like another over the speeds of a record."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_gap.fitting.equivalent_start import acting_alike, friction, slides
from spool_gap.registry import EFFECTS
from spool_gap.simulation.point import Point
from spool_sim.terms import term

SPEEDS = np.linspace(0.002, 0.15, 400)


def point(law: str, **numbers: float) -> Point:
    values = {p.name: p.start for p in term(law).parameters}
    return Point((law,), {**values, "viscous_coefficient": 4.0, **numbers})


def test_presliding_friction_remembers_and_a_spring_does_not_slide() -> None:
    assert slides("coulomb_friction")
    assert not slides("presliding_friction")
    assert not slides("spring")


@settings(deadline=None, max_examples=20)
@given(
    force=st.floats(0.05, 1.0),
    excess=st.floats(1.1, 2.0),
    velocity=st.floats(0.01, 0.06),
    drag=st.floats(1.0, 10.0),
)
def test_mixed_friction_takes_the_shape_of_a_stribeck_curve(
    force: float, excess: float, velocity: float, drag: float
) -> None:
    """Within 3 % of the friction, rms: that is why records confuse them."""
    like = point(
        "stribeck_friction",
        coulomb_force=force,
        static_force=excess * force,
        stribeck_velocity=velocity,
        stribeck_exponent=1.0,
        viscous_coefficient=drag,
    )
    start = point("mixed_friction", viscous_coefficient=drag)
    own = EFFECTS["mixed_friction"].fitted
    found = acting_alike(like, "stribeck_friction", start, "mixed_friction", own, SPEEDS)
    wanted = friction("stribeck_friction", like, SPEEDS)
    apart = friction("mixed_friction", found, SPEEDS) / wanted - 1.0
    assert np.sqrt(np.mean(apart**2)) < 0.03


@pytest.mark.parametrize("law", ["mixed_friction", "stribeck_friction"])
def test_speeds_to_try_reach_over_those_of_a_record(law: str) -> None:
    """Held while the other numbers act alike, so each belongs to the law."""
    choices = EFFECTS[law].speeds_to_try(0.2)
    values = [value for choice in choices for value in choice.values()]
    assert {name for choice in choices for name in choice} <= set(EFFECTS[law].fitted)
    assert len(values) == len(choices)
    assert max(values) > 10.0 * min(values)
    assert all(0.001 < value < 0.2 for value in values)


@settings(deadline=None, max_examples=20)
@given(force=st.floats(0.05, 1.0), drag=st.floats(1.0, 10.0))
def test_what_contains_a_law_can_act_exactly_like_it(force: float, drag: float) -> None:
    like = point("coulomb_friction", coulomb_force=force, viscous_coefficient=drag)
    start = point("stribeck_friction", viscous_coefficient=2.0 * drag)
    own = EFFECTS["stribeck_friction"].fitted
    found = acting_alike(like, "coulomb_friction", start, "stribeck_friction", own, SPEEDS)
    wanted = friction("coulomb_friction", like, SPEEDS)
    assert friction("stribeck_friction", found, SPEEDS) == pytest.approx(wanted, rel=2e-3)
    bounds = {p.name: (p.low, p.high) for p in term("stribeck_friction").parameters}
    assert all(low <= found.values[name] <= high for name, (low, high) in bounds.items())
