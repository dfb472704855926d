"""Accelerometers with a ROS driver as a valve's source, over DDS: from single samples to estimates."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import AccelStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from spool_core.block import Block, joined
from spool_core.node.messages import to_block, to_time
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import make_estimator, phase_of, settings_for
from spool_estimator.messages import from_message
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, ValveHealth
from spool_sim.excitation import load_excitation
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from std_msgs.msg import Float64MultiArray

if TYPE_CHECKING:
    from .conftest import System

RATE = 1000.0
TASK = "valve_1/adapter: sensors"
START = 1_700_000_000_000_000_000
#: ns between the samples of drivers that run by the clock.
PERIOD = 5_000_000


def record(seconds: float, excitation: str = "sweep") -> list[Block]:
    """Return what two accelerometers say, in blocks of 20 samples at 1 kHz."""
    valve = find_valve("4weh10_soft")
    simulator = Simulator(
        valve, load_excitation(excitation), sample_rate=RATE, block_size=20, start_stamp=START
    )
    return list(simulator.records(seconds))


def imu(stamp: int, value: float) -> Imu:
    message = Imu()
    message.header.stamp = to_time(stamp)
    message.linear_acceleration.x = float(value)
    return message


def offered(system: System, kind: type, topic: str, reliability: ReliabilityPolicy) -> Any:
    profile = QoSProfile(depth=5000, reliability=reliability)
    return system.node.create_publisher(kind, f"/valve_1/{topic}", profile)


def numbers(estimate: Estimate) -> np.ndarray:
    found = (*estimate.parameters, estimate.natural_frequency, estimate.damping_ratio, estimate.residual)
    return np.array([number for one in found for number in (one.value, one.standard_deviation)])


def test_estimates_from_two_imus_are_those_of_the_record_itself(system: System) -> None:
    """The same samples, one message each: what the estimator says differs by less than 1e-9."""
    blocks = record(12.0)
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    aligned = system.listen(AccelerationBlock, "/valve_1/acceleration")
    _ = system.diagnostics
    system.start("adapter", reliability="reliable", valve_id="4weh10_soft")
    system.start("estimator", valve_file="4weh10_soft")
    body = offered(system, Imu, "body/imu", ReliabilityPolicy.RELIABLE)
    spool = offered(system, Imu, "spool/imu", ReliabilityPolicy.RELIABLE)
    system.until(
        lambda: (
            body.get_subscription_count() == 1
            and spool.get_subscription_count() == 1
            and system.numbers(TASK).get("listeners") == "2"
        ),
        "adapter and estimator listen",
    )
    system.watch(1.0)  # who is seen may not have seen us yet, and would miss the first blocks
    whole = joined(blocks)
    stamps = START + 1_000_000 * np.arange(whole.body.size)
    sent = 0
    while sent < stamps.size:
        for place in range(sent, min(sent + 100, stamps.size)):
            body.publish(imu(int(stamps[place]), float(whole.body[place])))
            spool.publish(imu(int(stamps[place]), float(whole.spool[place])))
        sent = min(sent + 100, stamps.size)
        # A program that publishes a record faster than it was measured has to wait for who listens.
        wanted = sent // 20 if sent >= 1200 else 0
        system.until(lambda wanted=wanted: len(aligned.heard) >= wanted, f"{wanted} blocks")
    assert len(aligned.heard) == len(blocks)
    for message, block in zip(aligned.messages, blocks, strict=True):
        taken = to_block(message)
        assert (taken.stamp, taken.sequence, taken.sample_period) == (block.stamp, block.sequence, 0.001)
        np.testing.assert_array_equal(taken.body, block.body)
        np.testing.assert_array_equal(taken.spool, block.spool)
    replay = Replay(
        make_estimator("prediction", settings_for(find_valve("4weh10_soft"), phase=phase_of("/valve_1"))),
        Monitor(),
        keep=True,
    )
    for block in blocks:
        replay.update(block)
    replay.flush()

    def live() -> list[Estimate]:
        found = [from_message(message) for message in estimates.messages]
        return [one for one in found if one.state is not State.STALE]

    # The newest estimate replaces the one before, should that not have been heard yet.
    last = replay.estimates[-1].stamp
    system.until(lambda: live() and live()[-1].stamp >= last, "the last estimate of the record")
    by_stamp = {estimate.stamp: estimate for estimate in replay.estimates}
    pairs = [(one, by_stamp[one.stamp]) for one in live()]
    assert len(pairs) >= 0.5 * len(by_stamp)
    assert any(recorded.state is State.TRACKING for _, recorded in pairs)
    worst = 0.0
    for heard, recorded in pairs:
        assert (heard.stamp, heard.state) == (recorded.stamp, recorded.state)
        np.testing.assert_allclose(numbers(heard), numbers(recorded), rtol=1e-9)
        difference = np.abs(numbers(heard) / numbers(recorded) - 1.0)
        worst = max(worst, float(np.nanmax(np.append(difference, 0.0))))
    print(f"{len(pairs)} estimates, largest relative difference {worst:.1e}")
    said = system.numbers(TASK)
    assert [said[f"{name}_lost"] for name in ("body", "spool")] == ["0", "0"]
    assert said["late_samples"] == said["blocks_dropped"] == "0"


class Drivers:
    """Two drivers that publish a body and a spool that shake, stamped now, until they are stopped.

    They do so at 200 Hz, which leaves a busy machine with two processors time for everything else.
    """

    def __init__(self, send: dict[str, Callable[[int, int], None]]) -> None:
        self.send = send
        self.running = set(send)
        self.stopped_at = 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        begin, sent = time.time_ns(), 0
        while not self._end.wait(0.01):
            due = (time.time_ns() - begin) // PERIOD
            for number in range(sent, due):
                for name in sorted(self.running):
                    self.send[name](number, begin + number * PERIOD)
            sent = due

    def stop(self, name: str) -> None:
        self.running = self.running - {name}
        self.stopped_at = time.monotonic()

    def close(self) -> None:
        self._end.set()
        self._thread.join()


def shaking(number: int) -> float:
    return 8.0 * float(np.sin(0.1 * number) + np.sin(0.23 * number))


@pytest.fixture(name="two_drivers")
def _two_drivers(system: System) -> Iterator[Drivers]:
    """Best effort publishers of different types, one in g and pointing the other way."""
    body = offered(system, AccelStamped, "body/accel", ReliabilityPolicy.BEST_EFFORT)
    spool = offered(system, Imu, "spool/imu", ReliabilityPolicy.BEST_EFFORT)

    def send_body(number: int, stamp: int) -> None:
        message = AccelStamped()
        message.header.stamp = to_time(stamp)
        message.accel.linear.z = -shaking(number) / 9.80665
        body.publish(message)

    drivers = Drivers(
        {"body": send_body, "spool": lambda number, stamp: spool.publish(imu(stamp, 2.0 * shaking(number)))}
    )
    try:
        yield drivers
    finally:
        drivers.close()


def level_of(system: System, level: bytes, after: float) -> Callable[[], bool]:
    return lambda: any(status.level == level for _, status in system.statuses(TASK, after=after))


@pytest.mark.slow
def test_a_sensor_that_stops_is_stale_for_adapter_and_monitor_and_comes_back(
    system: System, two_drivers: Drivers
) -> None:
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    blocks = system.listen(AccelerationBlock, "/valve_1/acceleration")
    _ = system.diagnostics
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    system.start(
        "adapter",
        body_topic="body/accel",
        body_type="geometry_msgs/msg/AccelStamped",
        body_axis="-z",
        body_unit="g",
        stamps="header",
    )
    system.until(level_of(system, DiagnosticStatus.OK, 0.0), "both sensors are aligned")
    system.until(lambda: len(blocks.heard) > 100, "blocks")
    system.start("monitor")
    system.start("estimator")
    silent = (ValveHealth.LEVEL_UNKNOWN, ValveHealth.LEVEL_STALE)
    system.until(lambda: health.heard and health.last.level not in silent, "monitor and estimator hear it")
    last = blocks.last
    np.testing.assert_allclose(np.array(last.spool), 2.0 * np.array(last.body), rtol=1e-5, atol=1e-4)

    two_drivers.stop("spool")
    stopped = two_drivers.stopped_at

    def stale(event: HealthEvent) -> bool:
        return bool(
            event.kind == "stale"
            and event.cause == "acceleration"
            and event.state == HealthEvent.STATE_RAISED
        )

    system.until(lambda: events.first(stale, after=stopped), "the monitor says stale")
    system.until(level_of(system, DiagnosticStatus.ERROR, stopped), "the adapter says stale")
    event = events.first(stale, after=stopped)
    assert event is not None
    said = next(one for one in system.statuses(TASK, after=stopped) if one[1].level == DiagnosticStatus.ERROR)
    print(
        f"monitor: {event.arrival - stopped:.2f} s, adapter: {said[0] - stopped:.2f} s after the spool's stop"
    )
    assert said[1].message.startswith("spool: nothing on /valve_1/spool/imu for ")

    two_drivers.running = {"body", "spool"}
    again = time.monotonic()
    heard = len(blocks.heard)
    system.until(lambda: len(blocks.heard) > heard + 50, "blocks again")
    system.until(
        lambda: events.first(
            lambda one: one.kind == "stale" and one.state == HealthEvent.STATE_CLEARED, after=again
        ),
        "the monitor clears it",
    )
    assert blocks.last.sequence > last.sequence
    assert system.numbers(TASK)["spool_restarts"] == "1"
    assert system.numbers(TASK)["body_restarts"] == "0"


@pytest.mark.slow
def test_a_clock_of_one_sensor_that_was_set_is_reported_by_adapter_and_monitor(system: System) -> None:
    """The body's driver sets its clock back by 3 ms: no block follows, and both say what happened."""
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    blocks = system.listen(AccelerationBlock, "/valve_1/acceleration")
    _ = system.diagnostics
    # Reliable: samples lost to a busy machine, and of each sensor others, may look like a clock that was set.
    system.start("adapter", reliability="reliable", valve_id="4weh10_soft")
    system.start("monitor")
    body = offered(system, Imu, "body/imu", ReliabilityPolicy.RELIABLE)
    spool = offered(system, Imu, "spool/imu", ReliabilityPolicy.RELIABLE)
    set_back = [0]
    drivers = Drivers(
        {
            "body": lambda number, stamp: body.publish(imu(stamp - set_back[0], shaking(number))),
            "spool": lambda number, stamp: spool.publish(imu(stamp, 2.0 * shaking(number))),
        }
    )
    try:
        system.until(level_of(system, DiagnosticStatus.OK, 0.0), "both sensors are aligned")
        system.until(lambda: system.numbers(TASK).get("listeners") == "2", "the monitor listens")
        heard = len(blocks.heard)
        system.until(lambda: len(blocks.heard) > heard + 100, "blocks")
        set_back[0] = 3_000_000
        begin = time.monotonic()
        system.until(level_of(system, DiagnosticStatus.ERROR, begin), "the adapter reports an error")
        system.until(
            lambda: events.first(
                lambda one: (one.kind, one.cause) == ("data_fault", "clock_step"), after=begin
            ),
            "the monitor raises it",
        )
        status = next(
            one for _, one in system.statuses(TASK, after=begin) if one.level == DiagnosticStatus.ERROR
        )
        assert status.message.startswith("the body's clock was set by -0.003 s against the spool's")
        assert len(blocks.last.spool) == 0
        for message in (one for one in blocks.messages if len(one.spool)):
            np.testing.assert_allclose(
                np.array(message.spool), 2.0 * np.array(message.body), rtol=1e-5, atol=1e-4
            )
    finally:
        drivers.close()


def test_one_array_with_both_sensors_and_messages_of_no_use(system: System) -> None:
    """Time, body and spool in one message; NaN, missing columns and another size end nothing."""
    blocks = system.listen(AccelerationBlock, "/valve_1/acceleration")
    _ = system.diagnostics
    adapter = system.start(
        "adapter",
        body_topic="/daq",
        spool_topic="/daq",
        body_type="std_msgs/msg/Float64MultiArray",
        spool_type="std_msgs/msg/Float64MultiArray",
        body_axis="+column1",
        spool_axis="-column2",
        time_column=0,
        sample_rate=RATE,
        reliability="reliable",
    )
    array = system.node.create_publisher(Float64MultiArray, "/daq", 5000)
    system.until(lambda: array.get_subscription_count() == 1, "the adapter listens")
    system.until(lambda: system.numbers(TASK), "the adapter is known")
    bad = [[], [1.0], [np.nan, 1.0, 1.0], [-5.0, 1.0, 1.0], [1e300, 1.0, 1.0], [1.7e9, np.inf, 1.0]]
    sent = 0
    while sent < 2500:
        for number in range(sent, sent + 100):
            for row in bad if number == 1700 else ():
                array.publish(Float64MultiArray(data=row))
            values = [1.7e9 + number / RATE, shaking(number), -2.0 * shaking(number)]
            array.publish(Float64MultiArray(data=values))
        sent += 100
        wanted = sent // 20 - 2 if sent >= 1200 else 0
        system.until(lambda wanted=wanted: len(blocks.heard) >= wanted, f"{wanted} blocks")
    assert adapter.alive
    for message in blocks.messages:
        number = round((to_block(message).stamp - START) / 1e6)
        np.testing.assert_allclose(
            message.body, [shaking(one) for one in range(number, number + 20)], rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(
            np.array(message.spool), 2.0 * np.array(message.body), rtol=1e-6, atol=1e-6
        )
    system.until(lambda: system.numbers(TASK)["body_unusable"] == "2", "what was of no use is counted")
    assert system.numbers(TASK)["body_refused_no_time"] == "3"


def test_a_wrong_setting_ends_the_node_with_the_key_and_what_to_write(system: System) -> None:
    system.forks = False
    adapter = system.start("adapter", body_axis="+q")
    assert adapter.popen.wait(timeout=180) == 2
    said = (
        "/valve_1/adapter: body_axis: '+q' is no axis of sensor_msgs/msg/Imu: write +x, +y, +z, -x, -y or -z"
    )
    assert adapter.said.splitlines()[-1].endswith(said)
