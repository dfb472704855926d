"""Latency of the estimator nodes of many valves in one process on one processor.

Run as ``python -m spool_evaluation.benchmarks.many_valves COUNT FILE``; on SIGINT it writes what it saw
as JSON.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from spool_estimator.node.estimator_node import EstimatorNode
from spool_msgs.msg import AccelerationBlock
from spool_node.messages import nanoseconds

#: Blocks of each valve during which its model is looked for: all start at the same instant.
LEARNING = 200
#: s after its last sample a block has to be done with: then the next one comes.
LATE = 0.02


class TimedEstimator(EstimatorNode):
    """Estimator node that notes how old each block is when it is done with it."""

    def __init__(self, namespace: str) -> None:
        super().__init__(namespace)
        self.ages: list[float] = []

    def _take(self, message: AccelerationBlock) -> None:
        super()._take(message)
        measured = nanoseconds(message.header.stamp) * 1e-9 + len(message.body) * message.sample_period
        self.ages.append(time.time() - measured)

    @property
    def lost(self) -> int:
        """Blocks that did not come."""
        return self._core.gate.lost if self._core is not None else 0


def main(count: int, file: Path) -> None:
    """Run the nodes until SIGINT."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    stop = threading.Event()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGINT, lambda *_: stop.set())
    executor = EventsExecutor()
    nodes = [TimedEstimator(f"/valve_{number}") for number in range(1, count + 1)]
    for node in nodes:
        node.trigger_configure()
        node.trigger_activate()
        executor.add_node(node)
    before = time.process_time()
    while not stop.is_set():
        executor.spin_once(timeout_sec=0.2)
    start = np.concatenate([node.ages[:LEARNING] for node in nodes])
    ages = np.concatenate([node.ages[LEARNING:] for node in nodes])
    found = {
        "blocks": int(start.size + ages.size),
        "lost": sum(node.lost for node in nodes),
        "late": int((ages > LATE).sum()),
        "late_at_start": int((start > LATE).sum()),
        "worst_at_start_s": float(start.max()),
        "median_s": float(np.median(ages)),
        "worst_s": float(ages.max()),
        "processor_s": time.process_time() - before,
    }
    file.write_text(json.dumps(found), encoding="utf-8")
    executor.shutdown()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
