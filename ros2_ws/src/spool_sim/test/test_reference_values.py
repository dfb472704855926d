"""Reference values of every law, computed by hand from its equation at points away from special ones.

The comment above a row puts the row's numbers into the equation; the result comes from a calculator, never
from the code. A new law needs a row in LAWS with points on both sides of rest. `./spool python
tests/law_mutants.py` changes the laws one operation at a time and checks that these tests notice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from spool_sim.excitation import (
    Excitation,
    MachineOrders,
    Multisine,
    Recorded,
    Standstill,
    SteadySine,
    SteppedSine,
    SweptSine,
    from_mapping,
)
from spool_sim.lubrication import OilTable, fluid_friction_coefficient
from spool_sim.sensors import PAPER_CHAIN, FractionalDelay, MeasuringChain, Sensor, SensorChannel
from spool_sim.terms import TERMS, Term
from spool_sim.valve import OILS, Valve

#: Relative; values are given with seven digits.
EXACT = 1e-6
#: Displacement (m), velocity (m/s), time (s), force (N).
Point = tuple[float, float, float, float]


@dataclass(frozen=True)
class Law:
    """Values of a law, by hand.

    Attributes:
        term: name.
        values: parameters, all different so that exchanged ones show.
        points: forces while moving.
        rest: lowest and highest force that dry friction takes up at rest, N.
        levels: displacements at which the force has a kink, m.
    """

    term: str
    values: Mapping[str, float]
    points: tuple[Point, ...]
    rest: tuple[float, float] = (0.0, 0.0)
    levels: tuple[float, float] | None = None


LAWS = (
    # b v + [F_Ts + F_pmax e^(-sigma |v|)] sgn v:
    # 1.7 * 0.04 + 0.35 + 0.22 e^-2.4 = 0.068 + 0.35 + 0.0199580; -(1.7 * 0.013 + 0.35 + 0.22 e^-0.78)
    Law(
        "adhesion_friction",
        {"adhesion_drag": 1.7, "adhesion_dry_force": 0.35, "adhesion_force": 0.22, "adhesion_decay": 60.0},
        ((7e-4, 0.04, 0.8, 0.4379580), (7e-4, -0.013, 0.8, -0.4729493)),
        rest=(-0.57, 0.57),
    ),
    # F_forward for v > 0, -F_backward for v < 0
    Law(
        "asymmetric_friction",
        {"forward_force": 0.62, "backward_force": 0.41},
        ((7e-4, 0.03, 0.8, 0.62), (7e-4, -0.2, 0.8, -0.41)),
        rest=(-0.41, 0.62),
    ),
    # -F_0
    Law("constant_force", {"push": 0.8}, ((7e-4, 0.03, 0.8, -0.8), (-9e-4, -0.2, 0.3, -0.8))),
    Law("constant_force", {"push": -1.3}, ((7e-4, 0.03, 0.8, 1.3),)),
    # F_c sgn v
    Law(
        "coulomb_friction",
        {"coulomb_force": 0.45},
        ((7e-4, 0.03, 0.8, 0.45), (7e-4, -0.2, 0.8, -0.45)),
        rest=(-0.45, 0.45),
    ),
    # mu_0 N sgn v - K_V D v: 0.13 * 1.9 - 0.4 * 6.5 * 0.08 = 0.247 - 0.208; -0.247 + 0.4 * 6.5 * 0.03
    Law(
        "coulomb_hydrodynamic_friction",
        {"dry_coefficient": 0.13, "film_coefficient": 0.4, "film_drag": 6.5, "normal_load": 1.9},
        ((7e-4, 0.08, 0.8, 0.039), (7e-4, -0.03, 0.8, -0.169)),
        rest=(-0.247, 0.247),
    ),
    # k3 z^3: 2.5e7 * 1.728e-9; -2.5e7 * 2.9791e-8
    Law(
        "cubic_stiffness",
        {"cubic_coefficient": 2.5e7},
        ((1.2e-3, 0.03, 0.8, 0.0432), (-3.1e-3, -0.2, 0.3, -0.744775)),
    ),
    # c max(-1, r T (1 - e^(-t/T))) v: T = 40: 40 (1 - e^-0.75) = 21.10534, 7 * 0.03 * 21.10534 * -0.06
    Law(
        "damping_drift",
        {"viscous_coefficient": 7.0, "damping_drift_rate": 0.03, "damping_drift_time": 40.0},
        ((7e-4, -0.06, 30.0, -0.2659273), (7e-4, 0.06, 30.0, 0.2659273)),
    ),
    # a line for large T: 7 * (-0.02 * 12.5) * 0.06
    Law(
        "damping_drift",
        {"viscous_coefficient": 7.0, "damping_drift_rate": -0.02, "damping_drift_time": 1e7},
        ((7e-4, 0.06, 12.5, -0.105), (7e-4, -0.06, 12.5, 0.105)),
    ),
    # -0.5 * 21.1 is below -1: all of the drag is taken away, 7 * -1 * 0.06
    Law(
        "damping_drift",
        {"viscous_coefficient": 7.0, "damping_drift_rate": -0.5, "damping_drift_time": 40.0},
        ((7e-4, 0.06, 30.0, -0.42),),
    ),
    # b v + [F_od (1 - |v|/v_p)^4 + F_Ts] sgn v, bracket 0 above v_p: 1.7 * 0.02 + 0.3 * 0.6^4 + 0.35;
    # -(1.7 * 0.035 + 0.3 * 0.3^4 + 0.35); 1.7 * 0.08 + 0.35
    Law(
        "detachment_friction",
        {
            "detachment_force": 0.3,
            "detachment_velocity": 0.05,
            "detachment_drag": 1.7,
            "detachment_dry_force": 0.35,
        },
        ((7e-4, 0.02, 0.8, 0.42288), (7e-4, -0.035, 0.8, -0.41193), (7e-4, 0.08, 0.8, 0.486)),
        rest=(-0.65, 0.65),
    ),
    # sgn z max(0, K d (1 + chi d') + c d'), d = |z| - gap: d = 0.4 mm: 80 (1 + 0.7 * 0.25) + 12 * 0.25; the
    # same at the other stop, leaving it: -(80 (1 - 0.175) - 3); d = 0.1 mm at -2 m/s would pull: 20 (1 - 1.4)
    # - 24 < 0; 0.1 mm short of the stop; beyond it without speed: 2e5 * 1e-4; fast, but short of it
    Law(
        "end_stop",
        {"stop_gap": 3e-3, "stop_stiffness": 2e5, "stop_dissipation": 0.7, "stop_damping": 12.0},
        (
            (3.4e-3, 0.25, 0.8, 97.0), (-3.4e-3, 0.25, 0.8, -63.0), (3.1e-3, -2.0, 0.8, 0.0),
            (2.9e-3, 0.25, 0.8, 0.0), (-3.1e-3, 0.0, 0.8, -20.0), (2.99e-3, 1.5, 0.8, 0.0),
        ),
        levels=(-3e-3, 3e-3),
    ),
    # b v + [F_min + (F_s - F_min) / (1 + (v/v_s)^2)] sgn v: 2.5 * 0.05 + 0.3 + 0.25 / (1 + 2.5^2);
    # -(2.5 * 0.012 + 0.3 + 0.25 / (1 + 0.6^2))
    Law(
        "hess_soom_friction",
        {
            "hess_soom_drag": 2.5,
            "hess_soom_minimum": 0.3,
            "hess_soom_static": 0.55,
            "hess_soom_velocity": 0.02,
        },
        ((7e-4, 0.05, 0.8, 0.4594828), (7e-4, -0.012, 0.8, -0.5138235)),
        rest=(-0.55, 0.55),
    ),
    # k_t (d_k0 - a_k0) at rest, 0 while slipping: 120 * (0.0061 - 0.0035); nothing where a_k0 > d_k0
    Law(
        "microwedge_friction",
        {"contact_proportionality": 120.0, "microwedge_length": 6.1e-3, "microwedge_overlap": 3.5e-3},
        ((7e-4, 0.03, 0.8, 0.0), (7e-4, -0.2, 0.8, 0.0)),
        rest=(-0.312, 0.312),
    ),
    Law(
        "microwedge_friction",
        {"contact_proportionality": 120.0, "microwedge_length": 3.5e-3, "microwedge_overlap": 6.1e-3},
        (),
        rest=(0.0, 0.0),
    ),
    # [C1 sqrt|v| + C2 / (|v| + gamma)] N sgn v: (0.15 * 0.15 + 0.004 / 0.0345) * 1.9;
    # -(0.15 * 0.3 + 0.004 / 0.102) * 1.9; at rest 0.004 / 0.012 * 1.9
    Law(
        "mixed_friction",
        {
            "mixed_root_coefficient": 0.15,
            "mixed_inverse_coefficient": 0.004,
            "mixed_velocity": 0.012,
            "normal_load": 1.9,
        },
        ((7e-4, 0.0225, 0.8, 0.2630399), (7e-4, -0.09, 0.8, -0.1600098)),
        rest=(-0.6333333, 0.6333333),
    ),
    # b v + [F_min + (F_sp - F_min) e^(-(|v|/v_s)^p)] sgn v: 2.25^1.5 = 3.375: 1.7 * 0.045 + 0.3 + 0.25
    # e^-3.375; 0.64^1.5 = 0.512: -(1.7 * 0.0128 + 0.3 + 0.25 e^-0.512)
    Law(
        "pavelescu_friction",
        {
            "pavelescu_drag": 1.7, "pavelescu_minimum": 0.3, "pavelescu_static": 0.55,
            "pavelescu_velocity": 0.02, "pavelescu_exponent": 1.5,
        },
        ((7e-4, 0.045, 0.8, 0.3850545), (7e-4, -0.0128, 0.8, -0.4715839)),
        rest=(-0.55, 0.55),
    ),
    # 1.25^3 = 1.953125: 1.7 * 0.025 + 0.3 + 0.25 e^-1.953125
    Law(
        "pavelescu_friction",
        {
            "pavelescu_drag": 1.7, "pavelescu_minimum": 0.3, "pavelescu_static": 0.55,
            "pavelescu_velocity": 0.02, "pavelescu_exponent": 3.0,
        },
        ((7e-4, 0.025, 0.8, 0.3779575),),
        rest=(-0.55, 0.55),
    ),
    # -A sin(2 pi f t + phi): 13 * 0.9 = 11.7 turns: -0.6 sin(2 pi 0.7 + 0.5); 13 * 0.045 = 0.585 turns; after
    # three centuries 13 * (1e10 + 0.125) = ...1.625 turns: late times are exact
    Law(
        "periodic_force",
        {"force_frequency": 13.0, "force_amplitude": 0.6, "force_phase": 0.5},
        (
            (7e-4, 0.03, 0.9, 0.5896688), (-9e-4, -0.2, 0.045, 0.5156325),
            (7e-4, 0.03, 1e10 + 0.125, 0.5757298),
        ),
    ),
    # d v |v|: 18 * 0.09; -18 * 0.0225
    Law(
        "quadratic_damping",
        {"quadratic_coefficient": 18.0},
        ((7e-4, 0.3, 0.8, 1.62), (7e-4, -0.15, 0.8, -0.405)),
    ),
    # pi D l_u c_p mu / h_0 v + pi D l_u1 f_t1 p sgn v: pi * 0.018 * 0.0025 * 1.4 * 0.045 / 2e-6 = 4.4532076,
    # pi * 0.018 * 0.0012 * 0.06 * 2.5e5 = 1.0178760: 0.04 * 4.4532076 + 1.0178760; -0.3 * 4.4532076 -
    # 1.0178760
    Law(
        "seal_friction",
        {
            "seal_diameter": 0.018, "seal_width": 0.0025, "seal_correction": 1.4, "seal_viscosity": 0.045,
            "seal_film": 2e-6, "retainer_width": 0.0012, "retainer_friction": 0.06, "seal_pressure": 2.5e5,
        },
        ((7e-4, 0.04, 0.8, 1.1960043), (7e-4, -0.3, 0.8, -2.3538383)),
        rest=(-1.0178760, 1.0178760),
    ),
    # k z: 1500 * 2.1e-3; -1500 * 0.9e-3
    Law("spring", {"spring_stiffness": 1500.0}, ((2.1e-3, 0.03, 0.8, 3.15), (-9e-4, -0.2, 0.3, -1.35))),
    # -k min(b, max(-b, z)): -1500 * 0.4e-3 beyond the play; -1500 * 0.15e-3 within; 1500 * 0.4e-3
    Law(
        "spring_backlash",
        {"spring_stiffness": 1500.0, "backlash": 4e-4},
        ((1.1e-3, 0.03, 0.8, -0.6), (1.5e-4, 0.03, 0.8, -0.225), (-9e-4, -0.2, 0.3, 0.6)),
        levels=(-4e-4, 4e-4),
    ),
    # F_0 min(1, max(-1, z/w)): 2.2 * 0.4; 2.2; -2.2
    Law(
        "spring_preload",
        {"preload_force": 2.2, "preload_travel": 3e-5},
        ((1.2e-5, 0.03, 0.8, 0.88), (5e-4, 0.03, 0.8, 2.2), (-1e-3, -0.2, 0.3, -2.2)),
        levels=(-3e-5, 3e-5),
    ),
    # [F_c + (F_s - F_c) e^(-(|v|/v_s)^p)] sgn v: p = 2: 0.3 + 0.25 e^-2.25
    Law(
        "stribeck_friction",
        {"coulomb_force": 0.3, "static_force": 0.55, "stribeck_velocity": 0.02, "stribeck_exponent": 2.0},
        ((7e-4, 0.03, 0.8, 0.3263498), (7e-4, -0.03, 0.8, -0.3263498)),
        rest=(-0.55, 0.55),
    ),
    # p = 1.5: -(0.3 + 0.25 e^-3.375)
    Law(
        "stribeck_friction",
        {"coulomb_force": 0.3, "static_force": 0.55, "stribeck_velocity": 0.02, "stribeck_exponent": 1.5},
        ((7e-4, -0.045, 0.8, -0.3085545),),
        rest=(-0.55, 0.55),
    ),
    # p = 0.5: 0.64^0.5 = 0.8: 0.3 + 0.25 e^-0.8
    Law(
        "stribeck_friction",
        {"coulomb_force": 0.3, "static_force": 0.55, "stribeck_velocity": 0.02, "stribeck_exponent": 0.5},
        ((7e-4, 0.0128, 0.8, 0.4123322),),
        rest=(-0.55, 0.55),
    ),
    # b v + [F_min + F_sk e^(-|v|/v_k)] sgn v: 1.7 * 0.05 + 0.3 + 0.25 e^-2.5; -(1.7 * 0.013 + 0.3 + 0.25
    # e^-0.65)
    Law(
        "tustin_friction",
        {"tustin_drag": 1.7, "tustin_kinetic": 0.3, "tustin_excess": 0.25, "tustin_velocity": 0.02},
        ((7e-4, 0.05, 0.8, 0.4055212), (7e-4, -0.013, 0.8, -0.4526114)),
        rest=(-0.55, 0.55),
    ),
    # c v
    Law("viscous_friction", {"viscous_coefficient": 7.5}, ((7e-4, 0.04, 0.8, 0.3), (7e-4, -0.2, 0.8, -1.5))),
)  # fmt: skip
#: Laws of other arguments than displacement, velocity and time; their values have separate tests below.
ELSEWHERE = {"inertia", "play_friction", "presliding_friction"}


def force(entry: Term, values: Mapping[str, float], z: float, v: float, t: float) -> float:
    """Return the force (N) at one point; the acceleration is of no concern to these laws."""
    z_row, v_row, t_row = (np.array([number]) for number in (z, v, t))
    return float(entry.force(z_row, v_row, np.array([5.0]), values, t_row)[0])


def name_of(case: Law) -> str:
    return case.term


@pytest.mark.parametrize("case", LAWS, ids=name_of)
def test_force_while_moving_is_the_one_worked_out_by_hand(case: Law) -> None:
    for z, v, t, by_hand in case.points:
        found = force(TERMS[case.term], case.values, z, v, t)
        assert found == pytest.approx(by_hand, rel=EXACT, abs=1e-12)


@pytest.mark.parametrize("case", LAWS, ids=name_of)
def test_force_at_rest_and_kinks_are_those_worked_out_by_hand(case: Law) -> None:
    entry = TERMS[case.term]
    assert entry.at_rest(7e-4, case.values) == pytest.approx(case.rest, rel=EXACT, abs=1e-12)
    levels = entry.uncompiled("levels_law")
    found = None if levels is None else levels(*(case.values[p.name] for p in entry.parameters))
    assert found == (None if case.levels is None else pytest.approx(case.levels, rel=EXACT))


def test_at_zero_velocity_only_the_smooth_part_of_the_force_counts() -> None:
    push = next(case for case in LAWS if case.term == "constant_force")
    assert force(TERMS[push.term], push.values, 7e-4, 0.0, 0.8) == pytest.approx(-0.8)
    coulomb = next(case for case in LAWS if case.term == "coulomb_friction")
    assert force(TERMS[coulomb.term], coulomb.values, 7e-4, 0.0, 0.8) == 0.0


def test_without_times_a_law_counts_from_zero() -> None:
    periodic = next(case for case in LAWS if case.term == "periodic_force")
    rows = np.array([7e-4, 9e-4]), np.array([0.03, 0.04]), np.array([5.0, 6.0])
    # -0.6 sin(0.5)
    found = TERMS["periodic_force"].force(*rows, periodic.values)
    assert found == pytest.approx([-0.2876553] * 2, rel=EXACT)


@pytest.mark.parametrize("name", sorted(TERMS))
def test_every_law_has_values_that_show_each_of_its_parameters(name: str) -> None:
    """A law without a row fails here: add its values, worked out by hand, to LAWS."""
    if name in ELSEWHERE:
        return
    entry, cases = TERMS[name], [case for case in LAWS if case.term == name]
    assert any(v > 0.0 for case in cases for _, v, _, _ in case.points)
    assert any(v < 0.0 for case in cases for _, v, _, _ in case.points)
    for parameter in entry.parameters:
        assert any(_shows(entry, case, parameter.name) for case in cases), parameter.name


def _shows(entry: Term, case: Law, parameter: str) -> bool:
    other = {**case.values, parameter: 0.9 * case.values[parameter]}
    moved = [force(entry, other, z, v, t) - by_hand for z, v, t, by_hand in case.points]
    held = [a - b for a, b in zip(entry.at_rest(7e-4, other), case.rest, strict=True)]
    return max(map(abs, [*moved, *held])) > 1e-4 * max(abs(row[3]) for row in (*case.points, (0, 0, 0, 0.1)))


def test_inertia_is_mass_times_the_spool_s_own_acceleration() -> None:
    rows = np.array([7e-4, 0.0]), np.array([0.03, 0.0]), np.array([-3.5, 2.0])
    # 0.21 * -3.5; 0.21 * 2
    assert TERMS["inertia"].force(*rows, {"mass": 0.21}) == pytest.approx([-0.735, 0.42], rel=EXACT)


def test_dahl_s_force_after_a_slip_is_the_one_worked_out_by_hand() -> None:
    entry = TERMS["presliding_friction"]
    law = entry.uncompiled("memory_law")
    assert law is not None
    # From 0.1 N over 15 um forwards: 0.5 + (0.1 - 0.5) e^(-2e4 / 0.5 * 1.5e-5) = 0.5 - 0.4 e^-0.6
    assert law(0.1, 1.5e-5, 1.0, 0.5, 2e4) == pytest.approx(0.2804753, rel=EXACT)
    # From 0.1 N over 30 um backwards: -0.5 + (0.1 + 0.5) e^-1.2
    assert law(0.1, -3e-5, -1.0, 0.5, 2e4) == pytest.approx(-0.3192835, rel=EXACT)
    # Along a motion, from no force: 0; 0.5 (1 - e^-0.6) = 0.2255942; -0.5 + 0.7255942 e^-1.2
    z = np.array([0.0, 1.5e-5, -1.5e-5])
    values = {"dahl_force": 0.5, "dahl_stiffness": 2e4}
    found = entry.force(z, np.full(3, 0.02), np.full(3, 5.0), values)
    assert found == pytest.approx([0.0, 0.2255942, -0.2814552], rel=EXACT)
    assert entry.at_rest(0.0, values) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("start", "slip", "by_hand"),
    [
        # From 0 N in the middle of the play: 0.5 of 5e-7 N; to its end, then 2e4 N/m over 5 um; sliding.
        (0.0, 5e-5, 2.5e-7), (0.0, 1.05e-4, 0.1), (0.0, 1e-3, 0.5),
        # From -0.2 N, 10 um of give off, through the play of 200 um, 20 um of give on.
        (-0.2, 2.3e-4, 0.4), (-0.2, 1.1e-4, 0.0), (0.2, -1e-3, -0.5),
    ],
)  # fmt: skip
def test_the_force_after_play_is_the_one_worked_out_by_hand(
    start: float, slip: float, by_hand: float
) -> None:
    law = TERMS["play_friction"].uncompiled("memory_law")
    assert law is not None
    found = law(start, slip, math.copysign(1.0, slip), 0.5, 1e-4, 2e4)
    assert found == pytest.approx(by_hand, rel=EXACT, abs=1e-6)


def valve_of(**changes: Any) -> Valve:
    given: dict[str, Any] = {
        "id": "by_hand", "moving_mass": 0.25, "spool_mass": 0.24, "spring_stiffness": 2000.0,
        "land_diameter": 0.016, "land_length": 0.03, "radial_clearance": 12e-6, "dynamic_viscosity": 0.05,
        "oil": "HL68", "oil_temperature": 40.0,
    }  # fmt: skip
    return Valve(**{key: value for key, value in {**given, **changes}.items() if value is not None})


def test_valve_s_drag_frequency_and_damping_are_those_worked_out_by_hand() -> None:
    valve = valve_of()
    # pi d l mu / h = pi * 0.016 * 0.03 * 0.05 / 12e-6 = 2 pi
    assert valve.viscous_coefficient == pytest.approx(6.283185, rel=EXACT)
    assert valve.likely_viscous_coefficient == pytest.approx(6.283185, rel=EXACT)
    # sqrt(2000 / 0.25) / (2 pi) = 89.44272 / 6.283185
    assert valve.natural_frequency == pytest.approx(14.23525, rel=EXACT)
    # c / (2 sqrt(k m)) = 6.283185 / (2 sqrt(500))
    assert valve.damping_ratio == pytest.approx(0.1404963, rel=EXACT)
    # HL68 at 75 deg C has 17.13191 of its 68 mm^2/s (below): 0.05 * 17.13191 / 68
    assert valve.dynamic_viscosity_at(75.0) == pytest.approx(0.01259699, rel=EXACT)
    assert valve.at(75.0).viscous_coefficient == pytest.approx(1.582984, rel=EXACT)
    assert valve.at(75.0).viscous_coefficient == pytest.approx(1.582984, rel=EXACT)
    assert valve.likely_spool_mass == 0.24


def test_valve_of_an_unknown_film_is_taken_for_one_of_a_fifth_of_critical_damping() -> None:
    # 2 * 0.2 * sqrt(2000 * 0.25)
    bare = valve_of(radial_clearance=None, spool_mass=None)
    assert bare.likely_viscous_coefficient == pytest.approx(8.944272, rel=EXACT)
    assert bare.likely_spool_mass == 0.25


#: Kinematic viscosity (mm^2/s) at -10, 20 and 75 deg C by log10(log10(nu + 0.7)) = A - B log10(T). From the
#: catalogue points with log10(313.15) = 2.4957524 and log10(373.15) = 2.5718834, e.g. of HL68 with
#: log10(log10(68.7)) = 0.2640989 and log10(log10(9.4)) = -0.0118301: B = 0.2759290 / 0.0761310 = 3.624396,
#: A = 0.2640989 + B * 2.4957524 = 9.309695; at 20 deg C 10^(10^(A - B * 2.4670899)) - 0.7.
VISCOSITIES = {
    "HL68": (2822.818, 214.7607, 17.13191),
    "Azolla ZS22": (413.7222, 54.29258, 7.399872),
    "ISO VG 10": (99.97281, 20.44040, 4.156117),
    "ISO VG 15": (207.2835, 33.75368, 5.597439),
    "ISO VG 22": (416.8206, 54.39597, 7.387140),
    "ISO VG 32": (824.9266, 86.81286, 9.677382),
    "ISO VG 46": (1503.023, 134.5000, 12.72735),
    "ISO VG 68": (2791.379, 214.1424, 17.17611),
    "ISO VG 100": (4874.507, 334.2797, 23.34889),
}


@pytest.mark.parametrize("name", sorted(OILS))
def test_viscosity_of_an_oil_is_the_one_worked_out_by_hand(name: str) -> None:
    found = [OILS[name].kinematic_viscosity(celsius) for celsius in (-10.0, 20.0, 75.0)]
    assert found == pytest.approx(VISCOSITIES[name], rel=EXACT)


def test_oil_table_gives_the_ratio_of_the_viscosities() -> None:
    # Of HL68, from its 68 mm^2/s on and between the table's points: 2711.128 / 68; 208.2997 / 68; 16.83079 /
    # 68
    found = OilTable(valve_of()).ratio(np.array([-9.63, 20.46, 75.57]))
    assert found == pytest.approx([39.86953, 3.063230, 0.2475116], rel=2e-5)


def test_lubrication_quantities_are_those_worked_out_by_hand() -> None:
    # mu v A / (F_N h) = 0.05 * 0.36 * 0.002 / (1.5 * 2e-5)
    coefficient = fluid_friction_coefficient(
        dynamic_viscosity=0.05, speed=0.36, area=0.002, normal_load=1.5, film_thickness=2e-5
    )
    assert coefficient == pytest.approx(1.2, rel=EXACT)


RUN = {"start_frequency": 10.3, "stop_frequency": 33.0, "duration": 3.7, "amplitude": 3.0, "soft_start": 0.0}


def sequence(fade: float = 0.5, **more: Any) -> Excitation:
    """12 Hz of 5 m/s^2 for 3 s, 7 Hz of 2 m/s^2 for 2.5 s, 9.3 Hz of 4 m/s^2 for 4 s."""
    parts = [
        {
            "duration": duration,
            "excitation": {"kind": "steady_sine", "frequency": hertz, "amplitude": peak, "soft_start": 0.0},
        }
        for duration, hertz, peak in ((3.0, 12.0, 5.0), (2.5, 7.0, 2.0), (4.0, 9.3, 4.0))
    ]
    return from_mapping({"kind": "sequence", "fade": fade, "parts": parts, **more})


#: Excitation, and its acceleration (m/s^2) at some times (s).
EXCITATIONS: dict[str, tuple[Excitation, dict[float, float]]] = {
    "standstill": (Standstill(), {0.33: 0.0}),
    # 5 sin(2 pi 12 * 0.33 + 0.7)
    "steady": (SteadySine(frequency=12.0, amplitude=5.0, phase=0.7, soft_start=0.0), {0.33: 2.168849}),
    # after three centuries 13.25 * (1e10 + 0.5) = ...6.625 turns
    "late": (SteadySine(frequency=13.25, amplitude=5.0, soft_start=0.0), {1e10 + 0.5: -3.535534}),
    # at a quarter of the soft start: 0.5 - 0.5 cos(pi / 4) = 0.1464466 of 5 sin(2 pi 1.2 + 0.7); then all of
    # it
    "soft": (
        SteadySine(frequency=12.0, amplitude=5.0, phase=0.7, soft_start=0.4),
        {0.1: 0.6784010, 0.33 + 1.0: 2.168849},
    ),
    # at a quarter of a soft start of 0.08 s: 0.1464466 * 5 sin(2 pi 0.24 + 0.7)
    "short": (SteadySine(frequency=12.0, amplitude=5.0, phase=0.7, soft_start=0.08), {0.02: 0.5885570}),
    # 10 * 0.217 = 2.17 turns; a cycle has 3.1 + 5.27 + 3.41 = 11.78: 11.78 + 3.1 + 17 * 0.07 = 16.07;
    # 3.1 + 5.27 + 11 * 0.16 = 10.13; 3 * 11.78 + 10 * 0.11 = 36.44
    "stepped": (
        SteppedSine(frequencies=(10.0, 17.0, 11.0), dwell=0.31, amplitude=4.0, soft_start=0.0),
        {0.217: 3.505227, 1.31: 1.703117, 0.78: 2.915875, 2.9: 1.472498},
    ),
    # Turns 10.3 t + 0.5 (22.7 / 3.7) t^2, of a whole run 80.105: 16.77730 at 1.2 s; back 2 * 80.105 -
    # 39.91743 at 5.1 s; 2 * 80.105 + 11.75473 at 8.3 s; back 4 * 80.105 - 47.51676 at 12.2 s
    "up_down": (SweptSine(**RUN), {1.2: -2.955983, 5.1: 2.893336, 8.3: -0.6594006, 12.2: -1.713535}),
    # 80.105 + 20.43243; 2 * 80.105 + 11.75473
    "restart": (SweptSine(**RUN, repeat="restart"), {5.1: -0.6990976, 8.3: -0.6594006}),
    # 80.105 + 33 * 1.5; 80.105 + 33 * 0.06; before the start -10.3 * 0.33
    "hold": (
        SweptSine(**RUN, repeat="hold"),
        {1.2: -2.955983, 5.2: -1.838721, 3.76: 1.527124, -0.33: -1.778570},
    ),
    # Rate ln(33 / 10.3) / 3.7 = 0.3146929: 10.3 / 0.3146929 * (e^0.3776315 - 1) = 15.01750 turns;
    # back 2 * 72.13382 - 39.15227 at 4.9 s
    "logarithmic": (SweptSine(**RUN, scale="logarithmic"), {1.2: 0.3291594, 4.9: 1.989138}),
    # Each sine counts from its own start: 5 sin(2 pi 12.84); 0.1 s before and after a border the fade is at
    # 0.5 - 0.5 cos(0.3 pi) = 0.2061074 and 0.7938926, 0.2 s before it at 0.0244717; the last part goes on.
    # 0.9755283 * 5 sin(2 pi 33.6) + 0.0244717 * 2 sin(-2 pi 1.4);
    # 0.2061074 * 5 sin(2 pi 37.2) + 0.7938926 * 2 sin(2 pi 0.7);
    # 0.7938926 * 2 sin(2 pi 16.8) + 0.2061074 * 4 sin(-2 pi 0.93); 4 sin(2 pi 9.3 * 14.5)
    "sequence": (
        sequence(),
        {1.07: -4.221640, 2.8: -2.895774, 3.1: -0.5299747, 5.4: -1.159049, 20.0: -3.236068, 0.1: 4.755283},
    ),
    # Over after 9.5 s: 0.2061074 * 5 sin(-2 pi 1.2) + 0.7938926 * 4 sin(2 pi 36.27); 0.7938926 * 5 sin(2 pi
    # 1.2) + 0.2061074 * 4 sin(2 pi 38.13); of the first run nothing has been before: 5 sin(2 pi 1.2); 3.07 s
    # into the second run the fade is at 0.5 - 0.5 cos(0.64 pi) = 0.7128896: 0.2871104 * 5 sin(2 pi 36.84) +
    # 0.7128896 * 2 sin(2 pi 0.49)
    "repeated": (
        sequence(repeat=True),
        {1.07: -4.221640, 3.1: -0.5299747, 0.1: 4.755283, 9.4: 2.170431, 9.6: 4.376167, 12.57: -1.122551},
    ),
    # 5 sin(2 pi 35.88); 2 sin(2 pi 0.07)
    "unfaded": (sequence(fade=0.0), {2.99: -3.422736, 3.01: 0.8515586}),
}


@pytest.mark.parametrize("name", EXCITATIONS)
def test_body_acceleration_is_the_one_worked_out_by_hand(name: str) -> None:
    excitation, values = EXCITATIONS[name]
    found = excitation.acceleration(np.array(list(values)))
    assert found == pytest.approx(list(values.values()), rel=2e-6, abs=1e-9)


def test_highest_frequency_is_the_one_worked_out_by_hand() -> None:
    up = SweptSine(**RUN)
    down = SweptSine(**{**RUN, "start_frequency": 33.0, "stop_frequency": 10.0})
    assert Standstill().highest_frequency == 0.0
    assert SteadySine(frequency=12.0, amplitude=5.0).highest_frequency == 12.0
    assert (up.highest_frequency, down.highest_frequency) == (33.0, 33.0)
    assert sequence().highest_frequency == 12.0


def test_steps_of_a_range_are_those_worked_out_by_hand() -> None:
    given = {"dwell": 0.3, "amplitude": 4.0}
    up = SteppedSine(start_frequency=10.0, stop_frequency=17.0, frequency_step=3.0, **given)
    down = SteppedSine(start_frequency=17.0, stop_frequency=10.0, frequency_step=3.0, **given)
    assert up.steps.tolist() == [10.0, 13.0, 16.0]
    assert down.steps.tolist() == [17.0, 14.0, 11.0]
    assert (up.highest_frequency, down.highest_frequency) == (16.0, 17.0)


def test_shaft_of_a_machine_turns_as_worked_out_by_hand() -> None:
    # 10, 20 and 15 rev/s at 1, 3 and 4 s: 10 t before; 10 + 10 * 1 + 2.5 * 1^2; 10 + 30 + 20 * 0.05 - 2.5 *
    # 0.05^2; 10 + 30 + 17.5 + 15 * 2
    machine = MachineOrders(
        speed_profile=((1.0, 600.0), (3.0, 1200.0), (4.0, 900.0)),
        orders=((2.0, 3.0), (5.0, 0.0), (0.5, 1.5)), soft_start=0.0, seed=4,
    )  # fmt: skip
    found = machine.revolutions(np.array([0.5, 2.0, 3.05, 6.0]))
    assert found == pytest.approx([5.0, 22.5, 40.99375, 87.5], rel=EXACT)
    # The highest order that has an amplitude, 2, at 20 rev/s.
    assert machine.highest_frequency == 40.0
    assert machine.model_copy(update={"orders": ((3.0, 0.05),)}).highest_frequency == 60.0
    assert machine.model_copy(update={"orders": ()}).highest_frequency == 0.0
    # Orders 2 and 0.5, peaks 3 and 1.5, each from its drawn phase (turns) on, at 22.5 and 40.99375 turns
    first, _, last = np.random.default_rng(4).random(3).tolist()
    by_hand = [
        3.0 * math.sin(2.0 * math.pi * (2.0 * turns + first))
        + 1.5 * math.sin(2.0 * math.pi * (0.5 * turns + last))
        for turns in (22.5, 40.99375)
    ]
    assert machine.acceleration(np.array([2.0, 3.05])) == pytest.approx(by_hand, rel=EXACT)


def test_broadband_of_three_lines_is_the_one_worked_out_by_hand() -> None:
    machine = MachineOrders(
        speed_profile=((0.0, 0.0),), orders=(), broadband_rms=2.0, broadband_low=20.0, broadband_high=50.0,
        broadband_lines=3, soft_start=0.0, seed=4,
    )  # fmt: skip
    # One line in each third of the band, 20, 30 and 40 + 10 * place Hz, of a peak of 2 sqrt(2 / 3).
    drawn = np.random.default_rng(4).random(6).tolist()
    turns = [(20.0 + 10.0 * (k + drawn[k])) * 0.37 + drawn[3 + k] for k in range(3)]
    by_hand = sum(1.632993 * math.sin(2.0 * math.pi * turn) for turn in turns)
    assert machine.acceleration(np.array([0.37]))[0] == pytest.approx(by_hand, rel=EXACT)
    assert machine.highest_frequency == 50.0
    faint = machine.model_copy(update={"broadband_rms": 0.05})
    assert faint.acceleration(np.array([0.37]))[0] == pytest.approx(0.025 * by_hand, rel=EXACT)
    assert faint.highest_frequency == 50.0


def test_multisine_has_the_lines_and_the_power_worked_out_by_hand() -> None:
    sines = Multisine(low_frequency=9.9, high_frequency=11.3, lines=4, rms=2.0, period=4.0, soft_start=0.0)
    # Multiples of 1/4 Hz in the band: 40 to 45 of them; four evenly spread, 40, 41.67, 43.33, 45, rounded.
    assert sines.frequencies.tolist() == [10.0, 10.5, 10.75, 11.25]
    t = np.arange(400) / 100.0
    spectrum = 2.0 * np.abs(np.fft.rfft(sines.acceleration(t))) / t.size
    # 2 sqrt(2 / 4) each
    assert spectrum[[40, 42, 43, 45]] == pytest.approx([1.414214] * 4, rel=EXACT)
    assert np.delete(spectrum, [40, 42, 43, 45]).max() < 1e-9
    assert sines.highest_frequency == 11.3
    # More lines than the band holds: each once.
    many = sines.model_copy(update={"lines": 60})
    assert many.frequencies.tolist() == [10.0, 10.25, 10.5, 10.75, 11.0, 11.25]
    slow = many.model_copy(update={"low_frequency": 0.2, "high_frequency": 0.3})
    assert slow.frequencies.tolist() == [0.25]
    with pytest.raises(ValidationError, match="no multiple of 1 / period lies in the band"):
        Multisine(low_frequency=10.1, high_frequency=10.2, rms=2.0, period=4.0)
    # Sixty sines in phase would have a crest factor of sqrt(2 * 60) = 11.
    wide = Multisine(low_frequency=10.0, high_frequency=100.0, rms=2.0, period=4.0, soft_start=0.0)
    assert np.abs(wide.acceleration(np.arange(4000) / 1000.0)).max() < 2.0 * 2.2


def test_recorded_excitation_passes_through_its_samples_and_is_band_limited_between_them() -> None:
    sine = np.sin(2.0 * np.pi * 0.39 * np.arange(200) + 0.4)
    recorded = Recorded(samples=sine, sample_rate=500.0)
    found = recorded.acceleration(np.array([0.1, 0.2006, -0.01, 0.399]))
    # Sample 50: sin(2 pi 19.5 + 0.4); at 100.3: sin(2 pi 39.117 + 0.4); before the start; after the end at
    # 0.398 s
    assert found == pytest.approx([-0.3894183, 0.9065902, 0.0, 0.0], abs=2e-4)
    assert found[0] == pytest.approx(-0.3894183, rel=EXACT)
    assert recorded.acceleration(np.zeros(1))[0] == pytest.approx(sine[0], rel=EXACT)
    assert recorded.acceleration(np.array([0.398]))[0] == pytest.approx(sine[-1], rel=EXACT)
    assert recorded.duration == pytest.approx(0.398)


def test_sensor_reads_what_was_worked_out_by_hand() -> None:
    sensor = Sensor(gain_error=0.04, bias=-0.3, resolution=0.25, full_scale=5.0)
    # 1.04 * 1 - 0.3 = 0.74; 1.04 * -2.9 - 0.3 = -3.316; 1.04 * 6.1 - 0.3 = 6.044; steps of 0.25, rail at 5
    found = SensorChannel(sensor, 0).read(np.array([1.0, -2.9, 6.1, -7.0]))
    assert found == pytest.approx([0.75, -3.25, 5.0, -5.0], rel=EXACT)
    exact = SensorChannel(Sensor(gain_error=0.04, bias=-0.3, delay_samples=1.0), 0).read(
        np.array([1.0, -2.9])
    )
    assert exact == pytest.approx([-0.3, 0.74], rel=EXACT)
    fine = SensorChannel(Sensor(resolution=0.08), 0).read(np.array([1.01, -2.9]))
    assert fine == pytest.approx([1.04, -2.88], rel=EXACT)


def test_noise_of_a_sensor_has_its_rms() -> None:
    noise = SensorChannel(Sensor(noise=0.02), 3).read(np.zeros(40_000))
    # The rms of n draws varies by 1 / sqrt(2 n) = 0.35 %.
    assert float(noise.std()) == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize("delay", [0.0, 1.7, 2.0, 3.4, 6.9])
def test_delayed_cubic_is_the_cubic_of_the_earlier_time(delay: float) -> None:
    place = np.arange(30.0)
    # A polynomial of degree 5 through six samples is exact for a cubic: (n - delay)^3 - 4 (n - delay)
    channel, cubic = FractionalDelay(delay), place**3 - 4.0 * place
    found = np.concatenate([channel.apply(piece) for piece in np.split(cubic, [13, 14, 16])])
    by_hand = (place - delay) ** 3 - 4.0 * (place - delay)
    assert found[12:] == pytest.approx(by_hand[12:], rel=1e-9)


def test_delayed_impulse_is_made_of_lagrange_s_weights() -> None:
    # Six samples around the delayed instant: places 1 to 6 for 3.4, 0 to 5 for 1.7 (nothing is known before),
    # e.g. of place 3: (2.4 * 1.4 * -0.6 * -1.6 * -2.6) / (2 * 1 * -1 * -2 * -3) = -8.38656 / -12.
    impulse = np.eye(10)[0]
    by_hand = {
        3.4: [0.0, 0.011648, -0.09984, 0.69888, 0.46592, -0.08736, 0.010752, 0.0, 0.0, 0.0],
        1.7: [-0.01726725, 0.20967375, 0.9784775, -0.2258025, 0.06381375, -0.00889525, 0.0, 0.0, 0.0, 0.0],
        2.0: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    }
    for delay, weights in by_hand.items():
        assert FractionalDelay(delay).apply(impulse) == pytest.approx(weights, rel=EXACT, abs=1e-12)


def test_measuring_chain_reads_and_errs_as_worked_out_by_hand() -> None:
    chain = MeasuringChain(
        accelerometer=0.02, conditioner=0.015, oscilloscope=0.03, conditioner_gain=4.0, oscilloscope_gain=2.5
    )
    # 1.5 * 4 * 2.5; 15 (0.02 + 0.015 + 0.03)
    assert chain.reading(np.array([1.5, -1.5])) == pytest.approx([15.0, -15.0], rel=EXACT)
    assert chain.uncertainty(np.array([1.5, -1.5])) == pytest.approx([0.975, 0.975], rel=EXACT)
    assert chain.relative_uncertainty == pytest.approx(0.065, rel=EXACT)
    assert PAPER_CHAIN.relative_uncertainty == pytest.approx(0.05)
    generator = np.random.default_rng(0)
    errors = np.array([chain.sensor(generator, noise=0.1).gain_error for _ in range(4000)])
    # Three even distributions of these half widths: variance (0.02^2 + 0.015^2 + 0.03^2) / 3, mean 0.
    assert errors.std() == pytest.approx(0.02254625, rel=0.05)
    assert abs(errors.mean()) < 0.0015
    assert chain.sensor(generator, noise=0.1).noise == 0.1
