from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt, sosfiltfilt, sosfreqz
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.errors import InputError
from spool_sim.excitation import PRESETS, SteadySine
from spool_sim.model import MODELS
from spool_sim.observation import CAUSAL, LINEAR, MEAN, Observation
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve

NOISY = {"body_sensor": Sensor(noise=0.1), "spool_sensor": Sensor(gain_error=0.05, bias=0.2, noise=0.1)}


FILTERED = (Observation(MEAN), Observation(LINEAR, 6.0, 0.42), Observation(CAUSAL, 4.0, 0.36))
PASSED = {
    "body_sensor": Sensor(filter=FILTERED[0], noise=0.1),
    "spool_sensor": Sensor(filter=FILTERED[1], delay_samples=2.3),
}


def joined(blocks: list[Block]) -> tuple[Any, Any]:
    return np.concatenate([b.body for b in blocks]), np.concatenate([b.spool for b in blocks])


@pytest.mark.parametrize("name", ["sweep", "orders"])
def test_record_and_blocks_are_the_same_bit_for_bit(valve: Valve, name: str) -> None:
    fast = list(Simulator(valve, PRESETS[name], seed=3, **NOISY).records(6.0))
    live = Simulator(valve, PRESETS[name], seed=3, **NOISY)
    assert len(fast) == 300
    for block in fast:
        assert live.stamp == block.stamp
        other = live.next_block()
        for field in ("stamp", "sequence", "sample_period", "body", "spool"):
            np.testing.assert_array_equal(getattr(block, field), getattr(other, field))


@pytest.mark.parametrize("sensors", [NOISY, PASSED], ids=["instants", "filtered"])
@settings(max_examples=15, deadline=None)
@given(block_size=st.integers(1, 700))
def test_samples_do_not_depend_on_the_block_size(sensors: dict[str, Sensor], block_size: int) -> None:
    valve = find_valve("4weh10_soft")
    whole = Simulator(valve, PRESETS["multisine"], block_size=1500, **sensors).next_block()
    split = Simulator(valve, PRESETS["multisine"], block_size=block_size, **sensors)
    body, spool = joined(list(split.records(0.75)))
    np.testing.assert_array_equal(body[:1500], whole.body)
    np.testing.assert_array_equal(spool[:1500], whole.spool)


@pytest.mark.parametrize("sample_rate", [2000.0, 10_000.0, 3333.0, 44_100.5])
def test_blocks_pass_the_gate_and_their_stamps_are_exact(valve: Valve, sample_rate: float) -> None:
    start = 1_700_000_000_123_456_789
    source = Simulator(valve, PRESETS["steady"], sample_rate=sample_rate, block_size=37, start_stamp=start)
    gate = BlockGate()
    for number, block in enumerate(islice(source.records(2.0), 100)):
        verdict = gate.judge(block)
        assert verdict is (Verdict.CONTINUES if number else Verdict.RESTARTS)
        assert block.sequence == number
        # Twice the rate is a whole number here: round(n 1e9 / rate) in whole numbers.
        twice = round(2 * sample_rate)
        samples = 37 * number
        assert abs((block.stamp - start) * twice - samples * 2_000_000_000) * 2 <= twice
        assert block.body.dtype == block.spool.dtype == np.float32
        assert block.body.shape == block.spool.shape == (37,)
    assert gate.refused == gate.lost == 0
    assert not gate.faults


def test_both_sensors_have_their_own_noise_and_the_seed_makes_it(valve: Valve) -> None:
    sensors = {"body_sensor": Sensor(noise=0.1), "spool_sensor": Sensor(noise=0.1)}
    rest = PRESETS["standstill"]
    block = Simulator(valve, rest, block_size=5000, seed=1, **sensors).next_block()
    assert abs(np.corrcoef(block.body, block.spool)[0, 1]) < 0.05
    other = Simulator(valve, rest, block_size=5000, seed=2, **sensors).next_block()
    assert abs(np.corrcoef(block.body, other.body)[0, 1]) < 0.05


def test_drift_runs_linearly_from_where_it_is(valve: Valve) -> None:
    source = Simulator(valve, PRESETS["sweep"], coulomb_force=0.2)
    before = source.truth
    assert before.coulomb_force == 0.2
    assert before.viscous_coefficient == valve.viscous_coefficient
    assert before.natural_frequency == pytest.approx(valve.natural_frequency)
    assert before.damping_ratio == pytest.approx(valve.damping_ratio)
    list(source.records(1.0))
    source.set_drift("coulomb_force", 1.2, 4.0)
    assert source.truth.coulomb_force == 0.2
    list(source.records(1.0))
    assert source.truth.coulomb_force == pytest.approx(0.45)
    list(source.records(1.0))
    source.set_drift("coulomb_force", 0.0, 1.0)
    assert source.truth.coulomb_force == pytest.approx(0.7)
    list(source.records(2.0))
    assert source.truth.coulomb_force == 0.0
    source.set_drift("viscous_coefficient", 3.0)
    assert source.truth.viscous_coefficient == 3.0
    assert source.truth.time == 5.0


def test_large_friction_locks_the_spool_to_the_body(valve: Valve) -> None:
    block = Simulator(valve, PRESETS["sweep"], coulomb_force=5.0, block_size=4000).next_block()
    np.testing.assert_array_equal(block.body, block.spool)


def test_start_in_the_model_file_and_overrides(valve: Valve) -> None:
    assert Simulator(valve, PRESETS["sweep"]).truth.coulomb_force == 0.5
    assert Simulator(valve, PRESETS["sweep"], model="fluid").truth.coulomb_force == 0.0
    assert Simulator(valve, PRESETS["sweep"], model="fluid", coulomb_force=0.0).truth.coulomb_force == 0.0
    soft = Simulator(valve, PRESETS["sweep"], model=MODELS["fluid"], parameters={"spring_stiffness": 900.0})
    assert soft.truth.spring_stiffness == 900.0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"sample_rate": 0.0}, "sample_rate"),
        ({"sample_rate": float("nan")}, "sample_rate"),
        ({"sample_rate": 150.0}, "cannot hold an excitation of up to 100 Hz"),
        ({"block_size": 0}, "block_size"),
        ({"start_stamp": 0}, "start_stamp"),
        ({"coulomb_force": -1.0}, "coulomb_force: -1 N is out of range"),
        ({"model": "fluid", "coulomb_force": 1.0}, "coulomb_force: unknown parameter of model 'fluid'"),
        ({"parameters": {"colour": 1.0}}, "colour: unknown parameter"),
        ({"model": "stiction"}, "no such model"),
    ],
)
def test_wrong_arguments_are_refused(valve: Valve, arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Simulator(valve, PRESETS["sweep"], **arguments)


def test_oil_that_warms_thins_by_its_law(valve: Valve) -> None:
    source, other_source = (Simulator(valve, PRESETS["multisine"]) for _ in range(2))
    for one in (source, other_source):
        one.set_drift("viscous_coefficient", 4.0, 1.0)
        one.set_drift("oil_temperature", 60.0, 4.0)
    for block in other_source.records(4.0):
        truth, other = source.truth, source.next_block()
        np.testing.assert_array_equal(block.spool, other.spool)
    assert truth.oil_temperature == pytest.approx(60.0, abs=0.3)
    ratio = valve.at(truth.oil_temperature).viscous_coefficient / valve.viscous_coefficient
    assert truth.viscous_coefficient == pytest.approx(4.0 * ratio, rel=1e-5)
    # From there on it moves as a valve that has this drag from the start.
    thin = valve.at(60.0).viscous_coefficient / valve.viscous_coefficient * 4.0
    steady = Simulator(valve, PRESETS["multisine"], parameters={"viscous_coefficient": thin})
    late = joined(list(source.records(4.0)))[1][-2000:]
    wanted = joined(list(steady.records(8.0)))[1][-2000:]
    np.testing.assert_allclose(late, wanted, atol=1e-3 * np.abs(wanted).max())


def test_oil_that_cools_back_to_the_valve_s_own_temperature_is_thin_until_it_gets_there(valve: Valve) -> None:
    cooling, warm = (Simulator(valve, SteadySine(frequency=15.0, amplitude=10.0)) for _ in range(2))
    for one in (cooling, warm, warm):  # the same command again changes nothing
        one.set_drift("oil_temperature", 60.0)
    cooling.set_drift("oil_temperature", valve.oil_temperature, 1000.0)
    moved, expected = (joined(list(one.records(1.0)))[1] for one in (cooling, warm))
    np.testing.assert_allclose(moved, expected, atol=0.002 * np.abs(expected).max())
    truth = cooling.truth
    assert truth.oil_temperature == pytest.approx(59.96)
    assert truth.viscous_coefficient == pytest.approx(valve.at(59.96).viscous_coefficient, rel=1e-4)
    cooling.set_drift("oil_temperature", valve.oil_temperature)
    assert cooling.truth.viscous_coefficient == valve.viscous_coefficient


def test_wrong_drift_and_length_are_refused(valve: Valve) -> None:
    source = Simulator(valve, PRESETS["sweep"], model="fluid")
    with pytest.raises(InputError, match="coulomb_force: unknown parameter"):
        source.set_drift("coulomb_force", 1.0)
    with pytest.raises(InputError, match="use one of viscous_coefficient"):
        source.set_drift("mass", 1.0)
    with pytest.raises(InputError, match="out of range"):
        source.set_drift("viscous_coefficient", -1.0)
    with pytest.raises(InputError, match="duration"):
        source.set_drift("viscous_coefficient", 1.0, -1.0)
    with pytest.raises(InputError, match="out of range for HL68"):
        source.set_drift("oil_temperature", 500.0)
    with pytest.raises(InputError, match="seconds"):
        source.records(0.0)


@pytest.mark.parametrize("one", FILTERED, ids=str)
def test_a_filtered_record_is_the_fine_motion_through_a_filter_of_scipy(
    valve: Valve, one: Observation
) -> None:
    fine, rate, late = 64, 2000.0, 0.0
    dense = Simulator(valve, PRESETS["sweep"], coulomb_force=0.4, sample_rate=fine * rate, block_size=fine)
    rows = joined(list(dense.records(2.0)))
    sensor = Sensor(filter=one)
    simulator = Simulator(valve, PRESETS["sweep"], coulomb_force=0.4, body_sensor=sensor, spool_sensor=sensor)
    sections = butter(int(one.order or 1), one.corner if one.order else 0.4, fs=fine, output="sos")
    for read, row in zip(joined(list(simulator.records(2.0))), rows, strict=True):
        if one.kind == MEAN:
            ends = np.append(0.0, np.cumsum(row, dtype=np.float64))
            made = (np.roll(ends, -fine // 2) - np.roll(ends, fine // 2)) / fine
        elif one.kind == LINEAR:
            made = sosfiltfilt(sections, row)
        else:
            made = sosfilt(sections, row)
            _, response = sosfreqz(sections, [1e-3], fs=fine)
            late = -float(np.angle(response[0])) / (2.0 * np.pi * 1e-3)
        found = np.interp((np.arange(read.size) + late) * fine, np.arange(made.size), made)
        inner = slice(100, -100)
        # A jump of the fine record is half a step late: a part in a hundred of what the filter makes of it.
        assert np.std((read - found)[inner]) < 1e-3 * np.std(found)
    instants = rows[1][::fine]
    assert np.std(read - instants) > 1e-2 * np.std(instants)


def test_a_filtered_reading_is_late_by_the_delay_of_its_sensor(valve: Valve) -> None:
    sensors = (Sensor(filter=FILTERED[1], delay_samples=delay) for delay in (0.0, 3.0, 2.5))
    prompt, whole, half = (
        Simulator(valve, PRESETS["sweep"], model="fluid", spool_sensor=one, block_size=2000)
        .next_block()
        .spool
        for one in sensors
    )
    np.testing.assert_allclose(whole[3:], prompt[:-3], atol=1e-5)
    # Far below half the rate a mean of two neighbours is the value between them.
    between = 0.5 * (prompt[1:-2] + prompt[:-3])
    np.testing.assert_allclose(half[3:], between, atol=2e-3 * np.std(prompt))


def test_a_drift_reaches_a_filtered_record_though_its_steps_become_finer(valve: Valve) -> None:
    sensor = Sensor(filter=FILTERED[1])
    shaking = SteadySine(frequency=30.0, amplitude=8.0)
    source = Simulator(valve, shaking, model="fluid", sample_rate=500.0, spool_sensor=sensor)
    source.next_block()
    before = source.substeps
    source.set_drift("spring_stiffness", 400.0 * valve.spring_stiffness)
    assert source.substeps > before
    body, spool = joined(list(source.records(8.0)))
    # Such a spring holds the spool in the body.
    assert np.std((spool - body)[-1000:]) < 0.02 * np.std(body[-1000:])
