"""Live source of blocks: many valves, 50 blocks a second, and when their estimates come back."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from functools import partial

import rclpy
from rclpy.executors import SingleThreadedExecutor
from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.messages import from_block, to_time
from spool_msgs.msg import AccelerationBlock, ModelEstimate
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

BLOCK_RATE = 50.0
#: s that nodes may take until they listen.
PATIENCE = 60.0


@dataclass(slots=True)
class LiveSource:
    """Live source of one simulated record for the valves ``valve_1`` to ``valve_<count>`` as it happens.

    Attributes:
        sent: when each block was given to the publisher, by valve and sequence, s of the monotonic clock.
        latencies: from then until its estimate was here, s; estimates of the first ``run_in`` s left out.
        delay: s, of the filter, as the last estimate says.
        lost: blocks that the estimators counted as lost, by valve.

    """

    count: int
    seconds: float
    run_in: float = 4.0
    sample_rate: float = 2000.0
    sent: dict[tuple[int, int], float] = field(default_factory=dict)
    latencies: list[float] = field(default_factory=list)
    delay: float = 0.0
    lost: dict[int, int] = field(default_factory=dict)

    def run(self, listeners: int) -> None:
        """Wait until ``listeners`` hear each valve, then publish at the pace of the clock.

        Raises:
            InputError: they did not come.

        """
        messages = self._messages()
        rclpy.init()
        node = rclpy.create_node("source")
        executor = SingleThreadedExecutor()
        try:
            publishers = []
            for valve in range(1, self.count + 1):
                name = f"/valve_{valve}"
                publishers.append(
                    node.create_publisher(
                        AccelerationBlock, f"{name}/acceleration", qos.samples_offered(BLOCK_RATE)
                    )
                )
                node.create_subscription(
                    ModelEstimate, f"{name}/estimate", partial(self._heard, valve), qos.state(depth=50)
                )
            executor.add_node(node)
            spinning = threading.Thread(target=executor.spin, daemon=True)
            spinning.start()
            self._wait(publishers, listeners)
            self._publish(publishers, messages)
            time.sleep(0.5)
        finally:
            executor.shutdown()
            node.destroy_node()
            rclpy.shutdown()

    def _messages(self) -> list[AccelerationBlock]:
        noisy = Sensor(noise=0.03)
        source = Simulator(
            find_valve("4weh10_soft"),
            PRESETS["multisine"],
            coulomb_force=0.2,
            sample_rate=self.sample_rate,
            block_size=round(self.sample_rate / BLOCK_RATE),
            seed=1,
            body_sensor=noisy,
            spool_sensor=noisy,
        )
        return [from_block(block, "4weh10_soft") for block in source.records(self.seconds)]

    def _wait(self, publishers: list[rclpy.publisher.Publisher], listeners: int) -> None:
        end = time.monotonic() + PATIENCE
        while any(publisher.get_subscription_count() < listeners for publisher in publishers):
            if time.monotonic() > end:
                raise InputError(f"bench: the nodes do not listen after {PATIENCE:g} s")
            time.sleep(0.05)
        time.sleep(1.0)  # who is counted may still be about to hear

    def _publish(
        self, publishers: list[rclpy.publisher.Publisher], messages: list[AccelerationBlock]
    ) -> None:
        begin = time.monotonic()
        origin = time.time_ns()
        for number, message in enumerate(messages):
            due = begin + (number + 1) / BLOCK_RATE
            time.sleep(max(0.0, due - time.monotonic()))
            message.header.stamp = to_time(origin + round(number * 1e9 / BLOCK_RATE))
            for valve, publisher in enumerate(publishers, 1):
                self.sent[valve, number] = time.monotonic()
                publisher.publish(message)

    def _heard(self, valve: int, message: ModelEstimate) -> None:
        now = time.monotonic()
        self.lost[valve] = message.lost_blocks
        self.delay = message.delay
        sent = self.sent.get((valve, message.last_sequence))
        if sent is not None and message.last_sequence >= self.run_in * BLOCK_RATE:
            self.latencies.append(now - sent)
