"""What simulator, estimator and adapter publish: every field and number, and what parameters change."""

from __future__ import annotations

import array
import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
import yaml
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, Temperature
from spool_bag.adapter_node import AdapterNode
from spool_core.aligner import Aligner, AlignerSettings, Channel
from spool_core.block import Block
from spool_core.block_gate import Fault
from spool_core.errors import InputError
from spool_core.node.diagnostics import Level
from spool_core.node.managed_node import ManagedNode
from spool_core.node.messages import from_block, from_quantity, nanoseconds, number_of, to_time, type_with
from spool_core.sensor_stream import Refusal
from spool_estimator.estimate import QUANTITIES
from spool_estimator.estimator import Estimator, phase_of, settings_for
from spool_estimator.estimator_node import EstimatorNode
from spool_estimator.messages import from_description, from_message
from spool_monitor.monitor_node import MonitorNode
from spool_msgs.msg import (
    AccelerationBlock,
    AccelerationBlocks,
    HealthEvent,
    ModelEstimate,
    Quantity,
    ValveDescription,
)
from spool_sim.excitation import PRESETS, load_excitation
from spool_sim.observation import MEAN, Observation
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.simulator_node import SimulatorNode
from spool_sim.valve import find_valve, shipped_valves
from std_msgs.msg import Float64, Float64MultiArray, Header

from .clocked import START, STEP, Clocked, Domains, clocked

Adapting: TypeAlias = tuple[Clocked, Aligner, list[Block]]
Estimating: TypeAlias = tuple[Clocked, Estimator]

VALVE = shipped_valves()["4weh10_stiff"].read_text("utf-8")
#: rev/min at 0 and 60 s; the pump's second order meets the valve.
SHAKING = "{kind: machine_orders, speed_profile: [[0, 850], [60, 910]], orders: [[2, 6], [1, 2]]}\n"
RECORD: dict[str, Any] = {"sample_rate": 1000.0, "seed": 5}


@pytest.fixture(scope="module", name="valve")
def _valve(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("valve") / "valve.yaml"
    path.write_text(VALVE + "components:\n- {name: pump, pistons: 9}\n", "utf-8")
    path.with_name("shaking.yaml").write_text(SHAKING, "utf-8")
    return str(path)


def plain(value: Any) -> Any:
    """Return a field of a message as something that can be compared, NaN as well."""
    if isinstance(value, Header):
        return value.frame_id, nanoseconds(value.stamp)
    if isinstance(value, Quantity):
        return repr(from_quantity(value))
    return [plain(one) for one in value] if isinstance(value, list | array.array) else value


def check_fields(message: Any, expected: dict[str, Any]) -> None:
    """Compare every field of a message with a table in which no two are alike."""
    assert {name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()} == expected
    assert len(set(map(str, expected.values()))) == len(expected)


def live(kind: type[ManagedNode]) -> set[str]:
    """Return the parameters of a node that may change while it runs."""
    return {one.name for one in kind.PARAMETERS if not (one.structural or one.read_only)}


def change(node: Any, name: str, value: object) -> None:
    assert node.set_parameters([Parameter(name, value=value)])[0].successful


@pytest.fixture(scope="module", name="chain")
def _chain(claim_domain: Domains, valve: str) -> Iterator[Clocked]:
    """Simulator, estimator and monitor that ran for 17 s, of which the simulator slept for a while."""
    shaking = str(Path(valve).with_name("shaking.yaml"))
    errors = {
        "filter": "mean", "noise": 0.02, "body_gain_error": 0.01, "spool_gain_error": -0.03,
        "coulomb_force": 0.02,
    }  # fmt: skip
    with clocked(claim_domain, "valve_1") as chain:
        chain.start(MonitorNode, state_folder="none", resonance_on_delay=3.0)
        chain.start(EstimatorNode, valve_file=valve, memory=1.0)
        topics = {"acceleration": AccelerationBlock, "speed": Float64, "oil_temperature": Temperature}
        for topic, kind in (topics | {"events": HealthEvent}).items():
            chain.listen(kind, topic)
        chain.start(SimulatorNode, valve_file=valve, excitation=shaking, block_rate=25.0, **RECORD, **errors)
        chain.advance(15.0)
        chain.now += 2_000_000_000  # 50 blocks are due together
        chain.turn()
        chain.advance(0.2)
        chain.until(
            lambda: chain.numbers("simulation").get("blocks_sent") == "402", "the report of 402 blocks"
        )
        chain.settle()
        yield chain


def test_every_field_of_a_block_is_what_the_sensors_measured(chain: Clocked, valve: str) -> None:
    blocks = chain.heard["acceleration"]
    assert [message.sequence for message in blocks] == [*range(372), *range(397, 427)]
    simulator = Simulator(
        find_valve(valve),
        load_excitation(str(Path(valve).with_name("shaking.yaml"))),
        coulomb_force=0.02,
        block_size=40,
        body_sensor=Sensor(filter=Observation(MEAN), gain_error=0.01, noise=0.02),
        spool_sensor=Sensor(filter=Observation(MEAN), gain_error=-0.03, noise=0.02),
        **RECORD,
    )
    truth = list(simulator.records(18.0))
    for message in (blocks[3], blocks[-1]):
        block = truth[message.sequence]
        expected = {
            "header": ("4weh10_stiff", START + STEP + 40_000_000 * block.sequence),
            "sequence": block.sequence,
            "sample_period": 0.001,
            "body": block.body.tolist(),
            "spool": block.spool.tolist(),
        }
        check_fields(message, expected)


def test_the_oil_s_temperature_comes_once_a_second_with_its_time(chain: Clocked) -> None:
    assert len(chain.heard["oil_temperature"]) == 18
    for second, message in enumerate(chain.heard["oil_temperature"]):
        header = ("4weh10_stiff", START + STEP + second * 1_000_000_000)
        check_fields(message, {"header": header, "temperature": 20.0, "variance": 0.0})


def test_the_speed_is_in_rev_per_min_and_the_monitor_names_the_order_by_it(chain: Clocked) -> None:
    """Name and pistons of what turns reach the monitor with the valve's description."""
    speeds = [message.data for message in chain.heard["speed"]]
    assert speeds == pytest.approx([850.0 + 0.08 * place for place in range(214)])
    resonance = next(event for event in chain.heard["events"] if event.kind == "resonance")
    assert resonance.message.startswith("Resonance (2nd order of the pump, 85")
    evidence = {one.name: one.value for one in resonance.evidence}
    assert evidence["speed"] / 30.0 == pytest.approx(evidence["dominant_frequency"], rel=0.003)


def test_the_simulator_s_diagnostics_are_the_truth_and_what_was_sent(chain: Clocked) -> None:
    assert chain.numbers("simulation") == {
        "blocks_sent": "402",
        "blocks_dropped": "25",
        "viscous_coefficient_N_s_per_m": f"{0.0198 * math.pi * 0.020 * 0.032 / 15e-6:.6g}",
        "coulomb_force_N": "0.02",
        "spring_stiffness_N_per_m": "5846",
        "valve_id": "4weh10_stiff",
    }


#: Settings of the simulator: name, value, and the oil temperature after each s from then, deg C.
DRIFTS: list[tuple[str, object, list[float]]] = [
    ("drift_quantity", "oil_temperature", [32.5]),
    ("drift_target", 60.75, [45.0]),
    ("drift_duration", 4.0, [45.0]),
    ("drift_quantity", "none", [45.0]),
    ("drift_quantity", "oil_temperature", [48.9375, 52.875]),
]


def test_a_drift_that_is_set_live_is_in_what_the_simulator_publishes(
    claim_domain: Domains, valve: str
) -> None:
    """A new target changes no drift that is under way: it is that of the next quantity."""
    assert live(SimulatorNode) == {name for name, _, _ in DRIFTS}
    with clocked(claim_domain, "valve_2") as nodes:
        nodes.listen(Temperature, "oil_temperature")
        node = nodes.start(SimulatorNode, valve_file=valve, drift_target=45.0, drift_duration=2.0)
        nodes.advance(1.1)
        for name, value, temperatures in DRIFTS:
            change(node, name, value)
            nodes.advance(len(temperatures))
        nodes.advance(0.1)
        nodes.until(lambda: len(nodes.heard["oil_temperature"]) >= 8, "8 temperatures")
    found = [message.temperature for message in nodes.heard["oil_temperature"]]
    assert found == pytest.approx([20.0, 20.0, *(one for _, _, each in DRIFTS for one in each)])


def test_a_simulator_of_many_valves_sends_one_message_for_all(claim_domain: Domains, valve: str) -> None:
    """Each valve has its noise, and its oil temperature beside the blocks."""
    with clocked(claim_domain, "plant") as nodes:
        nodes.listen(AccelerationBlocks, "/accelerations")
        for number in (1, 3):
            nodes.listen(Temperature, f"/valve_{number}/oil_temperature")
        nodes.start(SimulatorNode, valve_file=valve, excitation="multisine", valves=3, **RECORD)
        nodes.advance(2.5)
        nodes.until(lambda: len(nodes.heard["/accelerations"]) >= 120, "120 messages")
    for number in range(3):
        alone = Simulator(
            find_valve(valve),
            PRESETS["multisine"],
            coulomb_force=0.1,
            block_size=20,
            body_sensor=Sensor(noise=0.05),
            spool_sensor=Sensor(noise=0.05),
            **(RECORD | {"seed": 5 + number}),
        )
        for message, block in zip(nodes.heard["/accelerations"][:120], alone.records(2.4), strict=True):
            assert message.names == ["valve_1", "valve_2", "valve_3"]
            assert message.blocks[number].sequence == block.sequence
            assert message.blocks[number].spool.tolist() == block.spool.tolist()
    assert [len(nodes.heard[f"/valve_{number}/oil_temperature"]) for number in (1, 3)] == [3, 3]


def disturbed(valve: str) -> Iterator[Block]:
    """Yield a record of 66 s that lacks 5 blocks, 2 in the last minute, and has 10 useless ones, 4 in it."""
    record = Simulator(find_valve(valve), PRESETS["multisine"], block_size=50, start_stamp=START, **RECORD)
    for one in record.records(66.0):
        block = replace(one, source="4weh10_stiff")
        if block.sequence == 40:
            yield from [replace(block, spool=block.spool[1:])] * 4
        if block.sequence == 50:
            yield from [replace(block, sample_period=math.nan)] * 2
        if block.sequence == 1270:
            yield from [replace(block, body=np.full_like(block.body, np.nan))] * 3
            yield replace(block, stamp=0)
        if block.sequence not in (60, 61, 62, 1260, 1261):
            yield block


@pytest.fixture(scope="module", name="estimating")
def _estimating(claim_domain: Domains, valve: str) -> Iterator[Estimating]:
    """Estimator that took a record with losses and faults, and the core that took the same."""
    given = {"memory": 1.5, "low_cut": 5.0, "high_cut": 250.0, "minimum_excitation": 0.3, "period": 0.5}
    core = Estimator(settings_for(find_valve(valve), phase=phase_of("/valve_3"), **given))
    with clocked(claim_domain, "valve_3") as nodes:
        nodes.listen(ModelEstimate, "estimate")
        nodes.listen(ValveDescription, "valve")
        nodes.start(EstimatorNode, valve_file=valve, stale_after=60.0, **given)
        blocks = nodes.offer(AccelerationBlock, "acceleration")
        temperatures = nodes.offer(Temperature, "oil_temperature")
        for block in disturbed(valve):
            if block.sequence % 20 == 0 and block.stamp:
                nodes.settle()
                message = Temperature(temperature=40.0 + 0.01 * block.sequence, variance=2.25)
                message.header.stamp = to_time(block.stamp)
                temperatures(message)
                nodes.settle()
                core.update_temperature(block.stamp, message.temperature, 1.5)
            blocks(from_block(block, block.source))
            core.update(block)
        nodes.until(lambda: nodes.numbers("estimate").get("blocks_used") == "1315", "the last block")
        yield nodes, core


def test_every_field_of_an_estimate_is_that_of_the_core_with_the_same_blocks(estimating: Estimating) -> None:
    nodes, core = estimating
    latest = core.latest
    expected = {
        **{"header": ("4weh10_stiff", START + 65_999_000_000), "model": "coulomb", "state": 2},
        **{"last_sequence": 1319, "samples": latest.samples, "delay": latest.delay, "memory": 1.5},
        **{"parameters": [repr(one) for one in latest.parameters], "lost_blocks": 5, "refused_blocks": 10},
        **{name: repr(getattr(latest, name)) for name in QUANTITIES},
    }
    check_fields(nodes.heard["estimate"][-1], expected)
    sent = replace(latest, source="4weh10_stiff", residual_force=from_message(ModelEstimate()).residual_force)
    assert repr(from_message(nodes.heard["estimate"][-1])) == repr(sent)


def test_a_thermometer_s_variance_is_the_square_of_the_deviation(estimating: Estimating) -> None:
    assert estimating[0].heard["estimate"][-1].oil_temperature.standard_deviation == 1.5


def test_every_field_of_the_description_is_that_of_the_valve_file(estimating: Estimating, valve: str) -> None:
    (message,) = estimating[0].heard["valve"]
    components = '[{"name":"pump","ratio":1.0,"pistons":9}]'
    expected = yaml.safe_load(VALVE) | {"components": components}
    check_fields(message, expected | {"header": (expected.pop("id"), START)})
    assert from_description(message) == find_valve(valve)


def test_the_estimator_s_diagnostics_count_faults_and_show_the_estimate(estimating: Estimating) -> None:
    last = estimating[0].heard["estimate"][-1]
    told = {one.name: f"{one.value:.6g}" for one in (*last.parameters, last.oil_temperature)}
    assert estimating[0].status("estimate").level == Level.WARNING.value
    assert estimating[0].numbers("estimate") == {
        **{f"fault_{fault.name.lower()}": "0" for fault in Fault},
        **{"fault_lengths_differ": "4", "fault_bad_period": "2", "fault_not_finite": "3"},
        **{"fault_no_time": "1", "fault_lost": "2", "blocks_used": "1315"},
        **{"blocks_lost": "5", "blocks_lost_last_minute": "2"},
        **{"blocks_refused": "10", "blocks_refused_last_minute": "4"},
        "spring_stiffness_N_per_m": told["spring_stiffness"],
        "viscous_coefficient_N_s_per_m": told["viscous_coefficient"],
        "coulomb_force_N": told["coulomb_force"],
        "oil_temperature_deg_C": told["oil_temperature"],
        "valve_id": "4weh10_stiff",
    }


def test_a_longer_silence_that_is_allowed_live_makes_nothing_stale(claim_domain: Domains, valve: str) -> None:
    assert live(EstimatorNode) == {"stale_after"}
    with clocked(claim_domain, "valve_4") as nodes:
        node = nodes.start(EstimatorNode, valve_file=valve, stale_after=0.2)
        nodes.listen(ModelEstimate, "estimate")
        send, heard = nodes.offer(AccelerationBlock, "acceleration"), nodes.heard["estimate"]
        record = [from_block(block, "4weh10_stiff") for block in disturbed(valve)]
        for message in record[:40]:
            send(message)
        nodes.until(lambda: heard and heard[-1].state == ModelEstimate.STATE_STALE, "it is stale")
        change(node, "stale_after", 60.0)
        stale = len(heard)
        for message in record[50:90]:
            send(message)
        nodes.until(lambda: len(heard) > stale, "estimates")
        reports = len(nodes.heard["/diagnostics"])
        nodes.until(lambda: len(nodes.heard["/diagnostics"]) >= reports + 3, "three reports of silence")
        assert ModelEstimate.STATE_STALE not in {message.state for message in heard[stale:]}


def test_a_field_of_the_machine_s_own_message_is_the_solenoid_s_command(
    claim_domain: Domains, valve: str
) -> None:
    """All that take `command` get it when it changes; a message without the number is left out."""
    field = {"command_type": "std_msgs/msg/Float64MultiArray", "command_field": "data[1]"}
    outputs = ([9.0, 0.0], [9.0, 1.5], [9.0], [9.0, 1.5], [9.0, 0.0])
    with clocked(claim_domain, "valve_5") as nodes:
        nodes.listen(Float64, "command")
        send = nodes.offer(Float64MultiArray, "/plc/outputs")
        shake = nodes.offer(AccelerationBlock, "acceleration")
        monitor = nodes.start(MonitorNode, state_folder="none", natural_frequency=28.7)
        nodes.start(EstimatorNode, valve_file=valve, command_topic="/plc/outputs", **field)
        source = Simulator(find_valve(valve), PRESETS["multisine"], block_size=40, start_stamp=START)
        for data, sent in zip(outputs, (1, 2, 2, 2, 3), strict=True):
            for block in source.records(1.0):
                shake(from_block(block, "4weh10_stiff"))
            nodes.advance(1.0)
            send(Float64MultiArray(data=data))
            nodes.until(lambda count=sent: len(nodes.heard["command"]) == count, "the command")
            value = nodes.heard["command"][-1].data
            nodes.until(lambda wanted=value: monitor._core.strokes.command == wanted, "the monitor has it")
    assert [message.data for message in nodes.heard["command"]] == [0.0, 1.5, 0.0]


def test_a_command_that_no_message_has_is_refused_with_what_it_has() -> None:
    with pytest.raises(InputError, match="source its workspace"):
        type_with("plc_msgs/msg/Outputs", "current")
    with pytest.raises(InputError, match="has no number 'current'; it has: layout, data"):
        type_with("std_msgs/msg/Float64MultiArray", "current")
    assert type_with("std_msgs/msg/Float64MultiArray", "data[3]") is Float64MultiArray
    assert number_of(Float64MultiArray(data=[1.0, 2.5]), "data[1]") == 2.5


def test_what_moves_too_little_is_not_estimated(claim_domain: Domains, valve: str) -> None:
    with clocked(claim_domain, "valve_6") as nodes:
        nodes.start(EstimatorNode, valve_file=valve, stale_after=60.0, minimum_excitation=50.0)
        nodes.listen(ModelEstimate, "estimate")
        send, heard = nodes.offer(AccelerationBlock, "acceleration"), nodes.heard["estimate"]
        for block in islice(disturbed(valve), 120):
            send(from_block(block, "4weh10_stiff"))
        nodes.until(lambda: len(heard) >= 3, "three estimates")
        assert ModelEstimate.STATE_TRACKING not in {message.state for message in heard}


def wave(stamp: int) -> float:
    """Return the body's acceleration, m/s^2; the spool's is three times as large."""
    return 5.0 * math.sin(2.0 * math.pi * 3.0e-9 * (stamp - START))


def imu(channel: str, stamp: int, value: float, *, measured: bool = True) -> Imu:
    """Return what the driver sends: the body's y axis in half g, the spool's z axis turned, in 2 m/s^2."""
    message = Imu()
    message.header.frame_id, message.header.stamp = channel, to_time(stamp)
    message.linear_acceleration.x = 77.0
    message.linear_acceleration.y = value / 0.5 / 9.80665 if channel == "body" else 66.0
    message.linear_acceleration.z = -value / 2.0 if channel == "spool" else 55.0
    message.linear_acceleration_covariance[0] = 0.0 if measured else -1.0
    return message


def sensed() -> Iterator[tuple[Imu, float]]:
    """Yield samples of both sensors in turn, and m/s^2: the spool's clock is 1.3 ms ahead and gains 300 ppm.

    From 6 s on samples are lost, repeated, without a time or a value, or of nobody.
    """
    rng = np.random.default_rng(3)
    for number in range(2000):
        for body in (True, False):
            true = 5_000_000 * number if body else 5_001_500 * number + 1_300_000
            stamp = START + true + round((5e4 if body else 1e5) * rng.uniform(-1.0, 1.0))
            channel, value = ("body", wave(stamp)) if body else ("spool", 3.0 * wave(stamp))
            if number in (range(1300, 1311) if body else (*range(1500, 1513), 1999)):
                continue
            if number in range(1700, 1709 if body else 1710):
                value = math.nan
            yield imu(channel, stamp, value), value
            if number == 1200:
                yield from [(imu(channel, stamp, value), value)] * (5 if body else 6)
                yield from [(imu(channel, 0, 1.0), 1.0)] * (7 if body else 8)
                yield from [(imu(channel, stamp, 1.0, measured=False), 1.0)] * (3 if body else 2)
                yield from [(imu("other", stamp, 1.0), 1.0)] * body


@pytest.fixture(scope="module", name="adapting")
def _adapting(claim_domain: Domains) -> Iterator[Adapting]:
    """Adapter that took what two sensors sent in one topic, the core that took the same, and its blocks."""
    given = {
        **{"body_topic": "imu", "body_frame": "body", "body_axis": "+y", "body_unit": "g", "body_gain": 0.5},
        **{"spool_topic": "imu", "spool_frame": "spool", "spool_axis": "-z", "spool_gain": 2.0},
        **{"block_rate": 20.0, "valve_id": "4weh10_stiff", "stale_after": 60.0},
    }
    core, truth = Aligner(AlignerSettings(block_rate=20.0, source="4weh10_stiff")), []
    with clocked(claim_domain, "valve_5") as nodes:
        nodes.start(AdapterNode, **given)
        send = nodes.offer(Imu, "imu")
        nodes.listen(AccelerationBlock, "acceleration")
        for place, (message, value) in enumerate(sensed()):
            send(message)
            if place == 2000:
                nodes.until(lambda: nodes.numbers("sensors").get("body_received") == "1001", "a calm report")
                nodes.heard["calm"] = [nodes.status("sensors")]
            frame, stamp = message.header.frame_id, nanoseconds(message.header.stamp)
            if frame != "other" and not message.linear_acceleration_covariance[0]:
                block = core.update(Channel(frame), stamp, value)
                truth += [block] if block is not None else []
        nodes.until(lambda: nodes.numbers("sensors").get("body_received") == "2001", "the last sample")
        nodes.now += 12_345_000_000
        nodes.turn()
        nodes.until(lambda: nodes.numbers("sensors")["body_age_s"][0] != "-", "a report by the clock")
        yield nodes, core, truth


def test_two_sensors_with_frames_in_one_topic_are_no_cause_for_a_warning(adapting: Adapting) -> None:
    (status,) = adapting[0].heard["calm"]
    assert (status.level, status.message) == (Level.OK.value, "200.001 Hz, drift +300.6 ppm")


def test_every_field_of_an_aligned_block_is_what_both_sensors_measured(adapting: Adapting) -> None:
    assert live(AdapterNode) == set()
    nodes, _, truth = adapting
    for message, block in zip(nodes.heard["acceleration"], truth, strict=True):
        waves = [wave(block.stamp + round(1e9 * block.sample_period) * place) for place in range(10)]
        expected = {
            "header": ("4weh10_stiff", block.stamp),
            "sequence": block.sequence,
            "sample_period": pytest.approx(0.005, rel=1e-4),
            "body": pytest.approx(waves, abs=0.02),
            "spool": pytest.approx([3.0 * one for one in waves], abs=0.06),
        }
        check_fields(message, expected)


def test_the_adapter_s_diagnostics_are_what_each_sensor_sent(adapting: Adapting) -> None:
    nodes, core, truth = adapting
    found = nodes.numbers("sensors")
    assert 0.0 <= float(found.pop("body_silent_s")) < float(found.pop("spool_silent_s"))
    expected: dict[str, object] = {
        **{"sample_rate_Hz": core.sample_rate, "offset_s": core.offset, "drift_ppm": 1e6 * core.drift},
        **{"spool_behind_s": core.apart, "clock_step_s": 0.0, "wandered_s": core.wandered},
        **{"late_samples": 0, "blocks_sent": len(truth), "listeners": 1, "valve_id": "4weh10_stiff"},
        "blocks_dropped": truth[-1].sequence + 1 - len(truth),
    }
    counts = {
        **{f"refused_{one.name.lower()}": (0, 0) for one in Refusal},
        **{"received": (2001, 2000), "lost": (11, 13), "unusable": (4, 3), "publishers": (0, 0)},
        **{"restarts": (0, 0), "clock_steps": (0, 0)},
        **{"refused_no_time": (7, 8), "refused_not_finite": (9, 10), "refused_duplicate": (5, 6)},
    }
    for place, (channel, stream) in enumerate(core.streams.items()):
        name = channel.value
        expected |= {f"{name}_{key}": pair[place] for key, pair in counts.items()}
        expected |= {
            f"{name}_rate_Hz": stream.clock.rate,
            f"{name}_jitter_s": 1e-9 * stream.clock.jitter,
            f"{name}_step_limit_s": 1e-9 * stream.step_limit,
            f"{name}_age_s": 1e-9 * (nodes.now - stream.newest),
        }
    assert found == {
        key: f"{value:.6g}" if isinstance(value, float) else str(value) for key, value in expected.items()
    }
