"""Laws as the paper prints them: values worked out by hand, and what is wrong with them."""

from __future__ import annotations

import numpy as np
import pytest
from spool_evaluation.paper.printed_laws import PRINTED
from spool_sim.excitation import SteadySine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.terms import term

#: Law, its values in order, and velocity (m/s) and force (N) at points, by hand.
VALUES = (
    # mu_0 N sgn v - K_V (mu / h) N v: 0.247 - 0.002 * 4000 * 1.9 * 0.08; -0.247 + 0.002 * 4000 * 1.9 * 0.03
    ("coulomb_hydrodynamic_friction", [0.13, 0.002, 4000.0, 1.9], [(0.08, -0.969), (-0.03, 0.209)]),
    # F_od (1 - |v|/v_p)^4 + b |v| + F_Ts sgn v: as above; 0.3 * 0.3^4 + 1.7 * 0.035 - 0.35; 1.7 * 0.08 - 0.35
    ("detachment_friction", [0.3, 0.05, 1.7, 0.35], [(0.02, 0.42288), (-0.035, -0.28807), (-0.08, -0.214)]),
    # the same without the sign on the third term: -2.5 * 0.012 - 0.3 + 0.25 / (1 + 0.6^2)
    ("hess_soom_friction", [2.5, 0.3, 0.55, 0.02], [(0.05, 0.4594828), (-0.012, -0.1461765)]),
    # k_t (d_k0 - a_k0) / (1 + 10^theta |v|^t): 0.312 / (1 + 1e4 * 9e-4)
    ("microwedge_friction", [120.0, 0.0061, 0.0035, 4.0, 2.0], [(0.03, 0.0312), (-0.03, 0.0312)]),
    # 0.312 / (1 + 1e5 * 1e-4)
    ("microwedge_friction", [120.0, 0.0061, 0.0035, 5.0, 4.0], [(-0.1, 0.02836364)]),
    # without the sign on the third term: -1.7 * 0.0128 - 0.3 + 0.25 e^-0.512
    ("pavelescu_friction", [1.7, 0.3, 0.55, 0.02, 1.5], [(0.045, 0.3850545), (-0.0128, -0.1719361)]),
)


@pytest.mark.parametrize(("name", "values", "points"), VALUES)
def test_a_printed_law_has_the_force_worked_out_by_hand(
    name: str, values: list[float], points: list[tuple[float, float]]
) -> None:
    entry = PRINTED[name]
    given = {parameter.name: value for parameter, value in zip(entry.parameters, values, strict=True)}
    velocity, by_hand = np.array(points).T
    found = entry.force(np.full(velocity.size, 7e-4), velocity, np.zeros(velocity.size), given)
    assert found == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.parametrize(
    "name", ["detachment_friction", "hess_soom_friction", "microwedge_friction", "pavelescu_friction"]
)
def test_a_printed_law_pushes_a_spool_at_rest_one_way(name: str) -> None:
    entry, still = PRINTED[name], np.array([-1e-6, 1e-6])
    given = {parameter.name: parameter.start for parameter in entry.parameters}
    assert sum(entry.force(still, still, still, given)) > 0.1
    assert sum(term(name).force(still, still, still, given)) == 0.0


def test_a_printed_law_moves_a_spool() -> None:
    laws = [*map(term, ("inertia", "spring", "viscous_friction")), PRINTED["microwedge_friction"]]
    motion = ComposedMotion(laws)
    body = SteadySine(frequency=20.0, amplitude=10.0).acceleration(half_step_times(0, 400, 2000.0, 4))
    table = motion.table({one.name: one.start for one in motion.parameters}, 400)
    found, _ = motion.advance(MotionState(), body, table, sample_period=5e-4, substeps=4)
    assert np.abs(found.displacement).max() > 1e-4
