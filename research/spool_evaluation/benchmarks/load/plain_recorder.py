"""Plain recorder, a peer: it writes each message as it comes with the library mcap, and syncs nothing.

Run as ``python -m spool_evaluation.benchmarks.load.plain_recorder FILE TOPIC...``; a signal ends it.
"""

from __future__ import annotations

import signal
import sys
import time
from functools import partial

import rclpy
from mcap.writer import CompressionType, Writer
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from spool_bag.metadata import definition
from spool_core.node import qos
from spool_msgs.msg import AccelerationBlock

TYPE = "spool_msgs/msg/AccelerationBlock"
#: Messages of a topic that may wait, as the recorder's.
DEPTH = 1000


def main(file: str, topics: list[str]) -> None:
    """Record ``topics`` into ``file`` until a signal."""
    ended: list[int] = []
    for asking in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asking, lambda *_: ended.append(1))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("plain_recorder")
    executor = EventsExecutor()
    executor.add_node(node)
    with open(file, "wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema(TYPE, "ros2msg", definition(TYPE).text.encode())

        def write(channel: int, data: bytes) -> None:
            now = time.time_ns()
            writer.add_message(channel, now, data, now)

        for topic in topics:
            channel = writer.register_channel(topic, "cdr", schema)
            wanted = qos.samples_wanted(DEPTH)
            node.create_subscription(AccelerationBlock, topic, partial(write, channel), wanted, raw=True)
        while not ended:
            executor.spin_once(timeout_sec=0.1)
        writer.finish()
    executor.shutdown()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
