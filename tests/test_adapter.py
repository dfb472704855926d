"""Accelerometers with a ROS driver as a valve's source: what becomes of their samples, and who says so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from sensor_msgs.msg import Imu
from spool_bag.adapter_node import AdapterNode
from spool_core.node.messages import to_block, to_time
from spool_monitor.monitor_node import MonitorNode
from spool_msgs.msg import AccelerationBlock, HealthEvent
from std_msgs.msg import Float64MultiArray

from .clocked import START, Clocked, Domains, clocked


def shaking(number: int) -> float:
    return 8.0 * float(np.sin(0.1 * number) + np.sin(0.23 * number))


@dataclass
class Drivers:
    """Adapter and monitor that run, and two drivers whose spool shakes twice as much as its body."""

    nodes: Clocked
    sent: int = 0
    set_by: int = 0

    def __post_init__(self) -> None:
        self.nodes.start(AdapterNode, valve_id="press_7")
        self.nodes.start(MonitorNode, state_folder="none", stale_after=0.5)
        self.nodes.listen(AccelerationBlock, "acceleration")
        self.nodes.listen(HealthEvent, "events")
        self.topics = [self.nodes.offer(Imu, f"{one}/imu") for one in ("body", "spool")]

    def send(self, seconds: float, *, spool: bool = True) -> None:
        """Send samples of 200 Hz; the body's clock shows ``set_by`` ns too much."""
        for number in range(self.sent, self.sent + round(200.0 * seconds)):
            for channel in range(1 + spool):
                message = Imu()
                message.header.stamp = to_time(START + 5_000_000 * number + (0 if channel else self.set_by))
                message.linear_acceleration.x = (1.0 + channel) * shaking(number)
                self.topics[channel](message)
            self.nodes.settle()
        self.sent += round(200.0 * seconds)

    def until(self, text: str, kind: str, cause: str, state: int, *, spool: bool = True) -> None:
        """Send until the adapter shows a text and the monitor publishes an event."""
        wanted = (kind, cause, state)

        def met() -> bool:
            self.send(0.05, spool=spool)
            events = {(one.kind, one.cause, one.state) for one in self.nodes.heard["events"]}
            return text in self.nodes.status("sensors").message and wanted in events

        self.nodes.until(met, f"{text}; {wanted}")


@pytest.fixture(name="drivers")
def _drivers(claim_domain: Domains) -> Iterator[Drivers]:
    with clocked(claim_domain, "valve_1") as nodes:
        found = Drivers(nodes)
        found.send(3.0)
        yield found
        for message in nodes.heard["acceleration"]:
            if len(message.spool):
                assert list(message.spool) == pytest.approx([2.0 * one for one in message.body], abs=1e-4)


def test_a_sensor_that_stops_is_stale_for_adapter_and_monitor_and_comes_back(drivers: Drivers) -> None:
    text, raised = "spool: nothing on /valve_1/spool/imu for ", HealthEvent.STATE_RAISED
    drivers.send(2.0, spool=False)
    drivers.until(text, "stale", "acceleration", raised, spool=False)
    before = len(drivers.nodes.heard["acceleration"])
    drivers.until("200 Hz", "stale", "acceleration", HealthEvent.STATE_CLEARED)
    drivers.send(2.0)
    assert len(drivers.nodes.heard["acceleration"]) > before + 50
    assert [drivers.nodes.numbers("sensors")[f"{one}_restarts"] for one in ("body", "spool")] == ["0", "1"]


def test_a_clock_of_one_sensor_that_was_set_is_reported_by_adapter_and_monitor(drivers: Drivers) -> None:
    """The body's driver sets its clock back by 3 ms: no block follows, and both say what happened."""
    drivers.set_by = -3_000_000
    text = "the body's clock was set by -0.003 s against the spool's"
    drivers.until(text, "data_fault", "clock_step", HealthEvent.STATE_RAISED)
    assert len(drivers.nodes.heard["acceleration"][-1].spool) == 0


def test_one_array_with_both_sensors_and_messages_of_no_use(claim_domain: Domains) -> None:
    """Time, body and spool in one message; NaN, missing columns and another size end nothing."""
    array = {"topic": "daq", "type": "std_msgs/msg/Float64MultiArray"}
    given = {f"{sensor}_{name}": value for sensor in ("body", "spool") for name, value in array.items()}
    bad = [[], [1.0], [np.nan, 1.0, 1.0], [-5.0, 1.0, 1.0], [1e300, 1.0, 1.0], [1.7e9, np.inf, 1.0]]
    with clocked(claim_domain, "valve_2") as nodes:
        axes = {"body_axis": "+column1", "spool_axis": "-column2", "time_column": 0, "sample_rate": 1000.0}
        nodes.start(AdapterNode, **given, **axes)
        nodes.listen(AccelerationBlock, "acceleration")
        send = nodes.offer(Float64MultiArray, "daq")
        for number in range(2500):
            for row in bad if number == 1700 else ():
                send(Float64MultiArray(data=row))
            values = [1.7e9 + number / 1000.0, shaking(number), -2.0 * shaking(number)]
            send(Float64MultiArray(data=values))
        nodes.until(lambda: nodes.numbers("sensors").get("body_received") == "2504", "all")
        blocks, numbers = nodes.heard["acceleration"], nodes.numbers("sensors")
    assert len(blocks) > 120
    for message in blocks:
        first = round((to_block(message).stamp - START) / 1e6)
        body = [shaking(number) for number in range(first, first + 20)]
        np.testing.assert_allclose(message.body, body, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(message.spool, 2.0 * np.array(message.body), rtol=1e-6, atol=1e-6)
    assert (numbers["body_unusable"], numbers["body_refused_no_time"]) == ("2", "3")
