"""Faults of sensors, converters and clocks are named by their own causes, and sound records have none."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from spool_core.numbers import Array
from spool_estimator.identification.channel_faults import (
    faults_of,
    interpolated,
    look_at_pair,
    repeats,
    without_outliers,
    wrap_around,
)
from spool_sim.excitation import from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

Pair = tuple[Array, Array]

RATE = 1000.0
EXCITATIONS = {
    "machine": {
        "kind": "machine_orders", "speed_profile": [[0.0, 700.0], [12.0, 1300.0]],
        "orders": [[1.0, 8.0], [2.0, 2.0]], "broadband_rms": 1.5,
    },
    "sweep": {
        "kind": "swept_sine", "start_frequency": 6.0, "stop_frequency": 80.0, "duration": 12.0,
        "amplitude": 8.0,
    },
    "multisine": {"kind": "multisine", "low_frequency": 5.0, "high_frequency": 80.0, "rms": 6.0},
    "steady": {"kind": "steady_sine", "frequency": 17.0, "amplitude": 9.0},
}  # fmt: skip


@lru_cache(maxsize=64)
def simulated(valve: str, excitation: str, friction: float, noise: float, seed: int) -> Pair:
    """Return body and spool of a healthy valve, 12 s at 1 kHz, as a text file has them."""
    sensors = Sensor(noise=noise), Sensor(noise=noise)
    simulator = Simulator(
        find_valve(valve), from_mapping(EXCITATIONS[excitation]), coulomb_force=friction, sample_rate=RATE,
        seed=seed, body_sensor=sensors[0], spool_sensor=sensors[1],
    )  # fmt: skip
    blocks = list(simulator.records(12.0))
    body, spool = (
        np.concatenate([getattr(one, name) for one in blocks]).astype(np.float64).round(3)
        for name in ("body", "spool")
    )
    body.flags.writeable = spool.flags.writeable = False
    return body, spool


def sound() -> Pair:
    return simulated("4weh10_soft", "machine", 0.1, 0.03, 1)


def held(row: Array, times: float) -> Array:
    """Return ``row`` read ``times`` as often as it samples."""
    return np.asarray(row[(np.floor(np.arange(row.size) / times) * times).astype(int)])


def wrapped(row: Array, share: float) -> Array:
    """Return ``row`` in 16 bits whose range is exceeded ``share`` times."""
    count = np.abs(row).max() / share / 32768
    return np.asarray(((np.round(row / count).astype(np.int64) + 32768) % 65536 - 32768) * count)


def ac_coupled(row: Array, corner: float) -> Array:
    return np.asarray(signal.lfilter(*signal.butter(1, corner, "high", fs=RATE), row))


def moved(row: Array, by: int) -> Array:
    """Return ``row`` whose second half comes ``by`` samples later."""
    half = row.size // 2
    return np.concatenate([row[:half], np.roll(row, by)[half:]])


def on(channel: str, change: Callable[[Array], Array], pair: Pair) -> Pair:
    body, spool = pair
    return (change(body), spool) if channel == "body" else (body, change(spool))


#: What is done to one channel, and the cause that it has.
FAULTS: dict[str, tuple[Callable[[Array], Array], str]] = {
    **{
        f"times {factor:g}": (lambda row, factor=factor: factor * row, "sensitivity")  # type: ignore[misc]
        for factor in (0.1, 0.5, 2.0, 5.0, 7.0, 10.0)
    },
    "polled twice": (lambda row: held(row, 2.0), "repeats"),
    "polled 1.4 times": (lambda row: held(row, 1.4), "repeats"),
    "wraps": (lambda row: wrapped(row, 1.3), "wrap_around"),
    "behind a capacitor": (lambda row: ac_coupled(row, 1.0), "ac_coupling"),
    "three samples late": (lambda row: moved(row, 3), "clock_step"),
    "one sample late": (lambda row: moved(row, 1), "clock_step"),
    "always late": (lambda row: np.roll(row, 2), "delay"),
}


@pytest.mark.parametrize("channel", ["body", "spool"])
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_a_channel_has_its_own_cause(fault: str, channel: str) -> None:
    change, cause = FAULTS[fault]
    found = faults_of(*on(channel, change, sound()), 1.0 / RATE)
    assert [one.cause for one in found] == [cause]


@pytest.mark.parametrize("rail", [0.72, 0.86, 0.98])
def test_integers_that_begin_to_wrap_around_are_told_though_friction_turns_at_the_rail(rail: float) -> None:
    body, spool = simulated("4weh10_soft", "machine", 0.4, 0.03, 2)
    span = rail * np.sqrt(2.0) * float(spool.std())
    changed = np.where(np.arange(spool.size) < 0.7 * spool.size, spool, (spool + span) % (2.0 * span) - span)
    found = faults_of(body, changed, 1.0 / RATE)
    assert [(one.cause, one.channel) for one in found] == [("wrap_around", "spool")]


@pytest.mark.parametrize("ring", [300.0, 400.0])
@pytest.mark.parametrize("every", [0.1, 0.35])
def test_blows_on_the_machine_are_no_integers_that_wrap_around(ring: float, every: float) -> None:
    generator, time = np.random.default_rng(1), np.arange(8000) / 1000.0
    row = 5.0 * np.sin(75.4 * time) + generator.normal(0.0, 0.05, time.size)
    for blow in np.arange(0.1, 7.9, every):
        since = np.maximum(0.0, time - blow)
        rings = np.exp(-since / 1e-3) * np.sin(2.0 * np.pi * ring * since)
        row += 60.0 * (1.0 + 0.1 * generator.normal()) * rings
    assert wrap_around(row, "body") is None
    assert wrap_around(row[-2000:], "body") is None


def test_one_sensor_read_twice_at_rest_is_no_pair_to_judge() -> None:
    """Too few of its samples change to tell that it is one."""
    noise = np.random.default_rng(0).normal(0.0, 0.016, 8000)
    row = 0.08 * np.round(noise / 0.08)
    assert 10 < np.count_nonzero(np.diff(row)) < 200
    assert faults_of(row, row.copy(), 1e-3) == []


@pytest.mark.parametrize("seed", range(20))
def test_a_machine_that_stops_leaves_noise_behind_a_converter_and_repeats_no_samples(seed: int) -> None:
    """Few changes are large then, and those of noise that are have equal neighbours among them by chance."""
    index = np.arange(16_000)
    vibration = 150.0 * np.sin(0.0377 * index) * (index < 8000)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, index.size)
    assert repeats(np.round(vibration + 3.1 * noise), "spool") is None
    assert not any(wrap_around(row, "spool") for row in noise.reshape(-1, 800))
    assert repeats(np.round(held(vibration + 5.0 * noise, 1.4)), "spool") is not None


def shaken(seconds: float = 8.0, rate: float = 2000.0, seed: int = 3) -> Array:
    """Return an acceleration of 5 m/s^2 rms below 60 Hz with the noise of a sensor."""
    generator = np.random.default_rng(seed)
    row = signal.sosfiltfilt(
        signal.butter(4, 60.0, fs=rate, output="sos"), generator.standard_normal(round(seconds * rate))
    )
    return np.asarray(5.0 * row / np.std(row) + 0.02 * generator.standard_normal(row.size))


@pytest.mark.parametrize("digits", [3, 6, 15])
@pytest.mark.parametrize("slower", [200.0, 250.0, 500.0, 300.0, 430.0])
def test_samples_on_lines_between_slower_readings_are_told_with_their_rate(
    slower: float, digits: int
) -> None:
    time = np.arange(16_000) / 2000.0
    readings = np.arange(0.0, 8.1, 1.0 / slower)
    row = np.round(np.interp(time, readings, np.interp(readings, time, shaken())), digits)
    assert repeats(row, "spool") is None
    found = interpolated(row, "spool", 1.0 / 2000.0)
    assert found is not None
    assert found.cause == "repeats"
    assert 2000.0 / found.value == pytest.approx(slower, rel=0.02)


@pytest.mark.parametrize("step", [0.0, 1e-6, 1e-3, 0.05, 0.5, 3.0])
def test_sound_rows_are_not_interpolated(step: float) -> None:
    """Also behind a coarse converter, at rest between blows, and as a sine of a whole number of samples."""
    time = np.arange(16_000) / 2000.0
    blows = np.exp(-(time % 0.05) / 2e-3) * np.sin(2.0 * np.pi * 300.0 * time)
    rows = [shaken(seed=seed) for seed in range(3)]
    rows += [blows, 40.0 * blows, 5.0 * np.sin(2.0 * np.pi * 50.0 * time), shaken(rate=100_000.0)[:16_000]]
    rows += [np.sign(np.sin(2.0 * np.pi * 25.0 * time)), 5.0 * np.clip(3.0 * blows, -0.2, 0.2)]
    for row in rows:
        assert interpolated(np.round(row / step) * step if step else row, "body", 5e-4) is None


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 5.0, 7.0, 10.0])
def test_the_factor_of_a_wrong_sensitivity_is_measured_and_both_candidates_are_named(factor: float) -> None:
    body, spool = sound()
    (of_spool,) = faults_of(body, factor * spool, 1.0 / RATE)
    (of_body,) = faults_of(factor * body, spool, 1.0 / RATE)
    assert of_spool.value == pytest.approx(factor, rel=0.02)
    assert of_body.value == pytest.approx(1.0 / factor, rel=0.02)
    assert "the spool's sensitivity is wrong by" in of_spool.text
    assert "or the body's by" in of_spool.text


@pytest.mark.parametrize("by", [3, -3, 16, -20, 40, -100, 300], ids="{:+d} ms".format)
def test_the_size_of_a_step_of_a_clock_and_its_time_are_measured(by: int) -> None:
    body, spool = sound()
    (found,) = faults_of(body, moved(spool, by), 1.0 / RATE)
    assert found.cause == "clock_step"
    assert found.value == pytest.approx(1e-3 * by, abs=1e-3)
    assert 4.5 < float(found.text.split()[1]) < 7.5


@pytest.mark.parametrize("excitation", ["machine", "multisine"])
@pytest.mark.parametrize("rate", [3e-4, -1e-3, 5e-3], ids="{:+g}".format)
def test_a_clock_that_runs_faster_than_the_other_is_told_with_its_rate(rate: float, excitation: str) -> None:
    body, spool = simulated("4weh10_soft", excitation, 0.1, 0.03, 1)
    index = np.arange(spool.size)
    (found,) = faults_of(body, np.interp((1.0 - rate) * index, index, spool), 1.0 / RATE)
    assert (found.cause, found.value) == ("clock_drift", pytest.approx(rate, rel=0.05, abs=5e-5))


@pytest.mark.parametrize("corner", [1.0, 3.0, 6.0])
@pytest.mark.parametrize("channel", ["body", "spool"])
def test_the_corner_of_a_coupled_channel_is_measured(corner: float, channel: str) -> None:
    coupled = on(channel, lambda row: ac_coupled(row, corner), sound())
    (found,) = faults_of(*coupled, 1.0 / RATE)
    assert (found.cause, found.channel) == ("ac_coupling", channel)
    assert found.value == pytest.approx(corner, rel=0.15)


def broken(after: float) -> Pair:
    """Return 8 s of a valve whose stiffness is multiplied by ``after`` in the middle."""
    valve = find_valve("4weh10_soft")
    simulator = Simulator(
        valve, from_mapping(EXCITATIONS["machine"]), coulomb_force=0.1, sample_rate=RATE, seed=2,
        body_sensor=Sensor(noise=0.03), spool_sensor=Sensor(noise=0.03),
    )  # fmt: skip
    blocks = list(simulator.records(4.0))
    simulator.set_drift("spring_stiffness", after * valve.spring_stiffness, 0.0)
    blocks += list(simulator.records(4.0))
    body, spool = (
        np.concatenate([getattr(one, name) for one in blocks]).astype(np.float64).round(3)
        for name in ("body", "spool")
    )
    return body, spool


@pytest.mark.parametrize("after", [0.6, 0.75, 1.4], ids="stiffness times {:g}".format)
def test_a_spring_that_breaks_within_a_record_is_no_fault_of_a_channel(after: float) -> None:
    assert faults_of(*broken(after), 1.0 / RATE) == []


@pytest.mark.parametrize("after", [0.6, 0.75, 1.4], ids="{:g} times".format)
def test_a_valve_that_changes_is_told_from_a_gain_that_jumps(after: float) -> None:
    """Both leave two valves before and behind a moment; only the gain stays wrong."""
    changed = look_at_pair(*broken(after), 1.0 / RATE)
    body, spool = broken(1.0)
    jumped = look_at_pair(
        body, np.where(np.arange(spool.size) < spool.size // 2, spool, after * spool), 1.0 / RATE
    )
    assert changed is not None
    assert jumped is not None
    assert (changed.changed, jumped.changed) == (True, False)


@pytest.mark.parametrize("valve", ["4weh10_soft", "4weh10_stiff"])
@pytest.mark.parametrize("after", [1.0, 2.0, 4.0, 5.0, 7.0], ids="after {:g} s".format)
def test_channels_that_are_exchanged_within_a_record_have_no_wrong_sensitivity(
    valve: str, after: float
) -> None:
    """Some gain accounts for half of each state, so no single account holds for the whole."""
    body, spool = (row[: 8 * int(RATE)] for row in simulated(valve, "machine", 0.1, 0.05, 3))
    before = np.arange(body.size) < after * RATE
    look = look_at_pair(np.where(before, body, spool), np.where(before, spool, body), 1.0 / RATE)
    assert look is None or look.fault is None or look.fault.cause != "sensitivity"


def test_one_sensor_read_twice_is_seen_and_a_stuck_spool_is_not_that() -> None:
    body, _ = sound()
    stuck = body + 0.03 * np.random.default_rng(4).standard_normal(body.size).round(3)
    assert [one.cause for one in faults_of(body, body, 1.0 / RATE)] == ["same_channel"]
    assert [one.cause for one in faults_of(body, (1.02 * body).round(3), 1.0 / RATE)] == ["same_channel"]
    assert faults_of(body, stuck.round(3), 1.0 / RATE) == []
    coarse = 0.25
    assert faults_of(*((row / coarse).round() * coarse for row in (body, stuck)), 1.0 / RATE) == []


def test_samples_that_no_motion_explains_are_lines_between_their_neighbours() -> None:
    _, spool = sound()
    spoiled = spool.copy()
    spoiled[[0, 700, 701, 4000]] = -9999.0
    repaired, count = without_outliers(spoiled, 1.0 / RATE)
    assert count == 4
    assert np.abs(repaired - spool).max() < 1.0


VALVES = st.sampled_from(["4weh10_soft", "4weh10_stiff"])
FRICTION = st.sampled_from([0.0, 0.02, 0.1, 0.3, 0.8])
NOISE = st.sampled_from([0.005, 0.03, 0.1])


@given(
    valve=VALVES,
    excitation=st.sampled_from(sorted(EXCITATIONS)),
    friction=FRICTION,
    noise=NOISE,
    seed=st.integers(0, 99),
)
@settings(max_examples=25, deadline=None)
def test_no_fault_is_seen_in_a_sound_record(
    valve: str, excitation: str, friction: float, noise: float, seed: int
) -> None:
    assert faults_of(*simulated(valve, excitation, friction, noise, seed), 1.0 / RATE) == []


@given(
    valve=VALVES,
    excitation=st.sampled_from(sorted(EXCITATIONS)),
    friction=FRICTION,
    seed=st.integers(0, 3),
    fault=st.sampled_from(sorted(FAULTS)),
    channel=st.sampled_from(["body", "spool"]),
)
@settings(max_examples=30, deadline=None)
def test_a_fault_is_never_taken_for_another_one(
    valve: str, excitation: str, friction: float, seed: int, fault: str, channel: str
) -> None:
    change, cause = FAULTS[fault]
    pair = on(channel, change, simulated(valve, excitation, friction, 0.03, seed))
    assert {one.cause for one in faults_of(*pair, 1.0 / RATE)} <= {cause}
