"""Reference values of every effect, computed by hand from its equation at points away from special ones.

Forces: the signature along a motion of five samples, and the parameters that follow from coefficients.
Measuring chain: gain and phase of a sine that a channel reads. Comments put the numbers into the equations.
A new effect needs a row. `./spool python tests/law_mutants.py` changes the effects one operation at a time
and checks that these tests notice.
"""

from __future__ import annotations

import cmath
from collections.abc import Mapping
from typing import cast

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_estimator.identification.chain import CHAIN_PARTS
from spool_estimator.identification.spectra import ZeroPhase, quiet, relative_motion
from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Motion, Scale, SensorEffect, scan

#: Relative; values are given with seven digits.
EXACT = 1e-6
#: Of a record's middle: what mirror images at its ends leave there.
MIDDLE = 2e-3
MOTION = Motion(
    displacement=np.array([1.2e-3, -0.7e-3, 0.3e-3, -1.5e-3, 0.5e-3]),
    velocity=np.array([0.05, -0.03, 4e-4, -0.12, -1e-4]),
    acceleration=np.array([2.0, -3.0, -4.0, 5.0, 0.1]),
    time=np.array([0.3, 0.9, 1.4, 2.2, 2.9]),
    period=5e-4,
    velocity_noise=1e-4,
    mass=0.18,
    stiffness=1500.0,
    damping=4.0,
    peaks=(13.0,),
)
#: Over half a sample's acceleration, 0.00025 |a|, or twice the noise: 0.0004 / 0.001 and -0.0001 / 0.0002.
SIGN = [1.0, -1.0, 0.4, -1.0, -0.5]

#: Effect, the numbers in which it is not linear, and its columns along MOTION.
SIGNATURES: tuple[tuple[str, Mapping[str, float], list[list[float]]], ...] = (
    ("asymmetric_friction", {}, [SIGN, [1.0, 1.0, 0.4, 1.0, 0.5]]),
    ("constant_force", {}, [[-1.0] * 5]),
    ("coulomb_friction", {}, [SIGN]),
    # z^3
    ("cubic_stiffness", {}, [[1.728e-9, -3.43e-10, 2.7e-11, -3.375e-9, 1.25e-10]]),
    # T (1 - e^(-t / T)) v: 40 (1 - e^-0.0075) * 0.05 ...
    (
        "damping_drift",
        {"damping_drift_time": 40.0},
        [[0.01494389, -0.02669852, 5.503133e-4, -0.2568713, -2.797370e-4]],
    ),
    # sgn z max(0, |z| - 0.6 mm)
    ("end_stop", {"stop_gap": 6e-4}, [[6e-4, -1e-4, 0.0, -9e-4, 0.0]]),
    # sign sqrt |v|; sign / (|v| + 0.01)
    (
        "mixed_friction",
        {"mixed_velocity": 0.01},
        [
            [0.2236068, -0.1732051, 0.008, -0.3464102, -0.005],
            [16.66667, -25.0, 38.46154, -7.692308, -49.50495],
        ],
    ),
    # -sin(2 pi 13 t); -cos(2 pi 13 t): 3.9, 11.7, 18.2, 28.6 and 37.7 turns
    (
        "periodic_force",
        {"force_frequency": 13.0},
        [
            [0.5877853, 0.9510565, -0.9510565, 0.5877853, 0.9510565],
            [-0.8090170, 0.3090170, -0.3090170, 0.8090170, 0.3090170],
        ],
    ),
    # d + (s - d) e^(-|dz| / 1 mm), d the direction: -1 + e^-1.9; 1 - 1.850431 e^-1; -1 + 1.319264 e^-1.8; ...
    ("presliding_friction", {"travel": 1e-3}, [[0.0, -0.8504314, 0.3192643, -0.7819271, 0.7588424]]),
    # Off the last place at which it slid, less 0.2 mm, over 1.4 mm: -1.6, -0.6, -1.6 and 0.4 mm.
    ("play_friction", {"slider_play": 2e-4, "give": 1.4e-3}, [[0.0, -1.0, -0.2857143, -1.0, 0.1428591]]),
    # v |v|
    ("quadratic_damping", {}, [[2.5e-3, -9e-4, 1.6e-7, -0.0144, -1e-8]]),
    ("spring_backlash", {"backlash": 6e-4}, [[-6e-4, 6e-4, -3e-4, 6e-4, -5e-4]]),
    # z / 0.8 mm within +-1
    ("spring_preload", {"preload_travel": 8e-4}, [[1.0, -0.875, 0.375, -1.0, 0.625]]),
    # sign; sign e^(-(|v| / 0.04)^1.5): e^-1.397542, e^-0.6495191, ...
    (
        "stribeck_friction",
        {"stribeck_velocity": 0.04, "stribeck_exponent": 1.5},
        [SIGN, [0.2472037, -0.5222969, 0.3996002, -0.005537831, -0.4999375]],
    ),
)

#: Effect, coefficients of its columns, numbers in which it is not linear, and the parameters that follow.
VALUES: tuple[tuple[str, list[float], Mapping[str, float], Mapping[str, float] | None], ...] = (
    ("asymmetric_friction", [0.5, 0.1], {}, {"forward_force": 0.6, "backward_force": 0.4}),
    ("asymmetric_friction", [0.05, 0.01], {}, {"forward_force": 0.06, "backward_force": 0.04}),
    ("asymmetric_friction", [0.5, -0.4], {}, {"forward_force": 0.1, "backward_force": 0.9}),
    ("asymmetric_friction", [0.5, -0.8], {}, None),
    ("asymmetric_friction", [-0.5, 0.1], {}, None),
    ("constant_force", [-0.7], {}, {"push": -0.7}),
    ("coulomb_friction", [0.05], {}, {"coulomb_force": 0.05}),
    ("coulomb_friction", [-0.5], {}, None),
    ("cubic_stiffness", [-5e7], {}, {"cubic_coefficient": -5e7}),
    # over the drag: -0.2 / 4
    (
        "damping_drift",
        [-0.2],
        {"damping_drift_time": 40.0},
        {"damping_drift_rate": -0.05, "damping_drift_time": 40.0},
    ),
    (
        "end_stop",
        [0.05],
        {"stop_gap": 6e-4},
        {"stop_gap": 6e-4, "stop_stiffness": 0.05, "stop_dissipation": 0.0, "stop_damping": 0.0},
    ),
    ("end_stop", [-2e5], {"stop_gap": 6e-4}, None),
    # over the normal load 1.687 N; no root part below 0, one may be held at 0
    (
        "mixed_friction",
        [0.3, 0.02],
        {"mixed_velocity": 0.01},
        {
            "mixed_root_coefficient": 0.1778305,
            "mixed_inverse_coefficient": 0.01185537,
            "mixed_velocity": 0.01,
        },
    ),
    (
        "mixed_friction",
        [0.02],
        {"mixed_velocity": 0.01, "mixed_root_coefficient": 0.0},
        {"mixed_root_coefficient": 0.0, "mixed_inverse_coefficient": 0.01185537, "mixed_velocity": 0.01},
    ),
    ("mixed_friction", [-0.01, 0.02], {"mixed_velocity": 0.01}, None),
    ("mixed_friction", [0.3, -0.02], {"mixed_velocity": 0.01}, None),
    # hypot(0.3, 0.4); atan2(0.4, 0.3)
    (
        "periodic_force",
        [0.3, 0.4],
        {"force_frequency": 13.0},
        {"force_frequency": 13.0, "force_amplitude": 0.5, "force_phase": 0.9272952},
    ),
    # F / travel
    ("presliding_friction", [0.05], {"travel": 4e-4}, {"dahl_force": 0.05, "dahl_stiffness": 125.0}),
    ("presliding_friction", [-0.5], {"travel": 4e-4}, None),
    (
        "play_friction",
        [0.7],
        {"slider_play": 2e-4, "give": 1.4e-3},
        {"slider_force": 0.7, "slider_play": 2e-4, "slider_stiffness": 500.0},
    ),
    ("play_friction", [-0.7], {"slider_play": 2e-4, "give": 1.4e-3}, None),
    ("quadratic_damping", [18.0], {}, {"quadratic_coefficient": 18.0}),
    ("quadratic_damping", [-18.0], {}, None),
    ("spring_backlash", [], {"backlash": 6e-4}, {"backlash": 6e-4}),
    ("spring_preload", [0.4], {"preload_travel": 8e-4}, {"preload_force": 0.4, "preload_travel": 8e-4}),
    (
        "stribeck_friction",
        [0.3, 0.2],
        {"stribeck_velocity": 0.04, "stribeck_exponent": 1.5},
        {"coulomb_force": 0.3, "static_force": 0.5, "stribeck_velocity": 0.04, "stribeck_exponent": 1.5},
    ),
    ("stribeck_friction", [-0.1, 0.2], {}, None),
    ("stribeck_friction", [0.3, 0.05], {}, {"coulomb_force": 0.3, "static_force": 0.35}),
    ("stribeck_friction", [0.3, -0.2], {}, None),
    ("stribeck_friction", [-0.3, 0.2], {}, None),
)

#: Effect of the spool's channel, its numbers, and gain (1) and phase (rad) of the reading of a sine, by Hz.
CHANNELS: tuple[tuple[str, Mapping[str, float], dict[float, tuple[float, float]]], ...] = (
    # 2 pi 12 * 3.7 ms late
    ("spool_delay", {"spool_delay": 3.7e-3}, {12.0: (1.0, -0.2789734)}),
    ("spool_gain_error", {"spool_gain_error": 0.15}, {12.0: (1.15, 0.0)}),
)
#: Part of the measuring chain, its numbers without the channel, Hz, gain (1) and phase (rad).
PARTS: tuple[tuple[str, Mapping[str, float], float, tuple[float, float]], ...] = (
    # f / (f - i f_c): 2 / (2 - 0.6 i)
    ("ac_coupling", {"corner": 0.6}, 2.0, (0.9578263, 0.2914568)),
    # 1 / (1 + sqrt 2 i x - x^2), x = 12 * 0.004
    ("anti_alias", {"filter_time": 4e-3}, 12.0, (0.9999973, -0.06793431)),
    # 1 + 0.3 * 144 / (900 - 144 + 36 i)
    (
        "extra_mode",
        {"mode_share": 0.3, "mode_frequency": 30.0, "mode_damping": 0.05},
        12.0,
        (1.057017, -0.002568485),
    ),
)
RATE, COUNT = 1000.0, 4001
TIME = np.arange(COUNT) / RATE


def wave(hertz: float, gain: float = 1.0, phase: float = 0.0) -> Array:
    """Return a cosine whose mirror images at both ends are itself."""
    return cast("Array", gain * np.cos(2.0 * np.pi * hertz * TIME + phase))


def middle(row: Array) -> Array:
    return row[1500:2500]


def test_an_effect_of_a_channel_is_no_force() -> None:
    channels = [entry for entry in EFFECTS.values() if not entry.terms]
    assert len(channels) == 3
    assert {entry.signature(MOTION, {}).shape for entry in channels} == {(0, 5)}


@pytest.mark.parametrize(("name", "shape", "by_hand"), SIGNATURES)
def test_signature_is_the_one_worked_out_by_hand(
    name: str, shape: Mapping[str, float], by_hand: list[list[float]]
) -> None:
    found = EFFECTS[name].signature(MOTION, shape)
    assert found.shape == (len(by_hand), 5)
    for row, expected in zip(found, by_hand, strict=True):
        assert row == pytest.approx(expected, rel=EXACT, abs=1e-30)


@pytest.mark.parametrize(("name", "coefficients", "shape", "by_hand"), VALUES)
def test_parameters_are_those_worked_out_by_hand(
    name: str, coefficients: list[float], shape: Mapping[str, float], by_hand: Mapping[str, float] | None
) -> None:
    found = EFFECTS[name].values(np.array(coefficients), shape, MOTION)
    if by_hand is None:
        assert found is None
    else:
        assert found == pytest.approx(
            {**{key: value for key, value in shape.items() if key not in ("travel", "give")}, **by_hand},
            rel=EXACT,
        )


def test_every_effect_has_values_worked_out_by_hand() -> None:
    """An effect without a row fails here: add its signature or its reading, and its parameters."""
    shown = {row[0] for row in SIGNATURES} | {row[0] for row in CHANNELS} | {"sensor_saturation"}
    assert shown == set(EFFECTS)
    assert {row[0] for row in VALUES} == {name for name, entry in EFFECTS.items() if entry.terms}


def test_sizes_of_a_motion_are_those_worked_out_by_hand() -> None:
    # 3.996 steps into 0.3, 0.5, 0.7, 1.2, 1.5 mm: 1.2 + 0.996 * 0.3
    assert MOTION.largest_displacement == pytest.approx(1.4988e-3, rel=EXACT)
    # 3.96 steps into 0.0001, 0.0004, 0.03, 0.05, 0.12 m/s: 0.05 + 0.96 * 0.07
    assert MOTION.largest_velocity == pytest.approx(0.1172, rel=EXACT)
    assert MOTION.sign == pytest.approx(SIGN, rel=EXACT)
    # Equal ratios of 10 from 0.002 to 2; none where there is no room
    assert scan(2e-3, 2.0, 4) == pytest.approx([2e-3, 2e-2, 0.2, 2.0], rel=EXACT)
    assert scan(2.0, 2e-3, 4) == scan(0.0, 2e-3, 4) == []


@pytest.mark.parametrize(
    ("name", "by_hand"),
    # 0.7; 0.7 / 0.0015^3; 0.7 / 0.12^2
    [("coulomb_friction", 0.7), ("cubic_stiffness", 2.074074e8), ("quadratic_damping", 48.61111)],
)
def test_the_unit_of_an_effect_is_the_one_worked_out_by_hand(name: str, by_hand: float) -> None:
    scale = Scale(force=0.7, travel=1.5e-3, speed=0.12, seconds=20.0)
    assert EFFECTS[name].unit(scale) == pytest.approx(by_hand, rel=EXACT)


@pytest.mark.parametrize(("name", "values", "by_hand"), CHANNELS)
def test_channel_reads_a_sine_as_worked_out_by_hand(
    name: str, values: Mapping[str, float], by_hand: dict[float, tuple[float, float]]
) -> None:
    entry = cast("SensorEffect", EFFECTS[name])
    for hertz, (gain, phase) in by_hand.items():
        rows = np.array([wave(hertz), wave(hertz, 3.0)])
        one, other = entry.reading(rows, 1.0 / RATE, values)
        assert one.shape == other.shape == TIME.shape
        assert middle(one) == pytest.approx(middle(wave(hertz, gain, phase)), abs=MIDDLE * gain)
        assert other == pytest.approx(3.0 * one, abs=1e-9)


def test_a_clipped_channel_reads_what_was_worked_out_by_hand() -> None:
    clipped = cast(SensorEffect, EFFECTS["sensor_saturation"])
    found = clipped.reading(np.array([3.0, -20.0, 17.0]), 1e-3, {"saturation_limit": 15.0})
    assert found.tolist() == [3.0, -15.0, 15.0]


@pytest.mark.parametrize("channel", ["body", "spool"])
@pytest.mark.parametrize(("name", "numbers", "hertz", "by_hand"), PARTS)
def test_part_of_the_chain_passes_a_sine_as_worked_out_by_hand(
    channel: str, name: str, numbers: Mapping[str, float], hertz: float, by_hand: tuple[float, float]
) -> None:
    part = CHAIN_PARTS[f"{channel}_{name}"]
    assert part.response is not None
    assert [p.name for p in part.parameters] == [f"{channel}_{number}" for number in numbers]
    (found,) = part.response(np.array([hertz]), tuple(numbers.values()))
    assert cmath.polar(complex(found)) == pytest.approx(by_hand, rel=EXACT)


def test_zero_phase_band_has_the_gain_worked_out_by_hand() -> None:
    band = ZeroPhase(1.0 / RATE, 3.0, 40.0)
    # 0.5 - 0.5 cos(pi (f / 3 - 1)) to 6 Hz; 0.5 + 0.5 cos(4 pi (f / 40 - 1)) from 40 Hz to 50 Hz
    found = band.gain(np.array([2.9, 3.9, 5.4, 12.0, 42.0, 47.0, 50.5]))
    assert found == pytest.approx([0.0, 0.2061074, 0.9045085, 1.0, 0.9045085, 0.2061074, 0.0], rel=EXACT)
    assert ZeroPhase(1.0 / RATE, 0.0).gain(np.array([0.0, 0.1])).tolist() == [1.0, 1.0]
    assert ZeroPhase(1.0 / RATE, 0.06).gain(np.array([0.078]))[0] == pytest.approx(0.2061074, rel=EXACT)
    # 1 / (3 Hz * 1 ms)
    settling = [ZeroPhase(1.0 / RATE, low_cut).settling for low_cut in (3.0, 0.06, 0.0)]
    assert settling == [333, 16667, 0]
    # All passes where no band is set, down to one sample.
    assert ZeroPhase(1.0 / RATE, 0.0).apply(np.full(50, 3.0)) == pytest.approx(np.full(50, 3.0))
    assert ZeroPhase(1.0 / RATE, 0.0).apply(np.array([3.0])) == pytest.approx(np.array([3.0]))


def test_integrals_of_a_sine_are_those_worked_out_by_hand() -> None:
    band = ZeroPhase(1.0 / RATE, 3.0)
    # Over 2 pi 12 = 75.39822 a quarter turn later, each time
    for times, (gain, phase) in enumerate(((1.0, 0.0), (0.01326291, -1.570796), (1.759048e-4, -3.141593))):
        assert middle(band.apply(wave(12.0), times)) == pytest.approx(
            middle(wave(12.0, gain, phase)), abs=MIDDLE * gain
        )


def test_relative_motion_is_the_one_worked_out_by_hand() -> None:
    # Spool 2.5 and body 1 in phase: relative 1.5; a bias does not pass the band
    found = relative_motion(wave(12.0), wave(12.0, 2.5) + 3.0, ZeroPhase(1.0 / RATE, 3.0))
    for row, (gain, phase) in (
        (found.acceleration, (1.5, 0.0)),
        (found.velocity, (0.01989437, -1.570796)),
        (found.displacement, (2.638572e-4, -3.141593)),
        (found.spool, (2.5, 0.0)),
    ):
        assert row.shape == TIME.shape
        assert middle(row) == pytest.approx(middle(wave(12.0, gain, phase)), abs=MIDDLE * gain)
    assert found.settling == 333


def test_what_is_far_above_the_noise_keeps_every_sample() -> None:
    """Pieces that overlap, each weighed by its window, add up to the whole, also at both ends."""
    row = np.random.default_rng(4).standard_normal(1000)
    density = 1e-9
    kept = quiet(row, density, 100.0).apply(row)
    assert kept == pytest.approx(row, abs=1e-3)
