"""Node ``adapter``: two accelerometers with a ROS driver as the source of a valve's ``acceleration``."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, ClassVar

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from spool_core.alignment.aligner import Aligner, AlignerSettings, Channel
from spool_core.node.block_hub import BlockPublisher, Throttle
from spool_core.node.diagnostics import DiagnosticPublisher, Level
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter, Value
from spool_core.node.running import run
from spool_core.text import plural

from .readings import IMU, TYPES, UNITS, Reading, Samples, UnusableError
from .sensor_report import SETTLED_LOOKS, SensorReport

#: s between two looks at the sensors, and looks between two reports of an unchanged state: about once a
#: second, and a sensor that stopped is told of within ``stale_after`` and a look.
LOOK, LOOKS = 0.25, 4

#: Messages that may wait: half a second of the fastest rate that single messages can come at.
DEPTH = 5000


def _of(channel: str, topic: str) -> tuple[NodeParameter, ...]:
    return (
        NodeParameter(
            f"{channel}_topic", topic, f"Topic of the accelerometer on the {channel}.", structural=True
        ),
        NodeParameter(f"{channel}_type", IMU, "Its message type.", choices=tuple(TYPES), structural=True),
        NodeParameter(
            f"{channel}_axis",
            "+x",
            "Its axis along the spool: +x, +y, +z, -x, -y, -z; of an array +column0 and so on.",
            structural=True,
        ),
        NodeParameter(f"{channel}_unit", "m/s^2", "Its unit.", choices=tuple(UNITS), structural=True),
        NodeParameter(
            f"{channel}_gain", 1.0, "Multiplied with what it says.", "1", 1e-9, 1e9, structural=True
        ),
        NodeParameter(
            f"{channel}_frame", "", "The only frame_id that is taken; empty: any.", structural=True
        ),
    )


class AdapterNode(ManagedNode):
    """Publish ``acceleration`` out of two sensors that send sample by sample."""

    PARAMETERS: ClassVar = (
        *_of("body", "body/imu"),
        *_of("spool", "spool/imu"),
        NodeParameter(
            "valve_id",
            "",
            "The valve's id, sent as frame_id of the blocks; empty: not known.",
            structural=True,
        ),
        NodeParameter(
            "stamps",
            "header",
            "Time of a sample: of its header, or of its arrival here.",
            choices=("header", "arrival"),
            structural=True,
        ),
        NodeParameter(
            "time_column",
            -1,
            "Column of an array with the time in s; -1: the time of arrival counts.",
            "",
            -1,
            9999,
            structural=True,
        ),
        NodeParameter("spool_delay", 0.0, "Taken off the spool's stamps.", "s", -10.0, 10.0, structural=True),
        NodeParameter(
            "sample_rate", 0.0, "Samples a second, 0: from the stamps.", "Hz", 0.0, 1e5, structural=True
        ),
        NodeParameter("block_rate", 50.0, "Blocks a second.", "Hz", 0.1, 1000.0, structural=True),
        NodeParameter("settle", 1.0, "Stamps that make the clocks.", "s", 0.1, 60.0, structural=True),
        NodeParameter(
            "longest_wait", 1.0, "How long one sensor waits for the other.", "s", 0.01, 10.0, structural=True
        ),
        NodeParameter(
            "stale_after", 0.5, "Silence of a sensor that is reported.", "s", 0.1, 60.0, structural=True
        ),
        NodeParameter(
            "reliability",
            "best_effort",
            "best_effort hears all; reliable those that offer it, and they send again what was lost.",
            choices=("best_effort", "reliable"),
            structural=True,
        ),
    )

    def __init__(self, namespace: str | None = None, **options: Any) -> None:
        super().__init__("adapter", namespace, **options)
        self._throttle = Throttle()

    def configure(self) -> None:
        """Read the table, make the core and the publisher."""
        self._aligner = self._new_aligner()
        self._publisher = BlockPublisher(self, "acceleration", self.value("block_rate"))
        self._diagnostics = DiagnosticPublisher(self, self.value("valve_id"))

    def activate(self) -> None:
        """Listen; what was heard before is over."""
        self._aligner = self._new_aligner()
        topics = {one: self.resolve_topic_name(self.value(f"{one.value}_topic")) for one in Channel}
        self._report = SensorReport(topics, self.value("stale_after"))
        self._begin = time.monotonic()
        self._heard: dict[Channel, float] = {}
        self._looks, self._level = 0, Level.OK
        readings = {channel: self._reading(channel.value, {}).samples for channel in Channel}
        for topic in dict.fromkeys(topics.values()):
            channels = {one: readings[one] for one in Channel if topics[one] == topic}
            kind = TYPES[self.value(f"{next(iter(channels)).value}_type")]
            self.subscribe(kind, topic, self._taker(channels), self._wanted())
        self.every(LOOK, self._look, steady=True)

    def cleanup(self) -> None:
        """Let go of the publishers."""
        self._publisher.destroy()
        self._diagnostics.destroy()

    def refuse_change(self, changes: dict[str, Value]) -> str | None:
        """Check axes by message type, and what two sensors on one topic share."""
        for channel in Channel:
            refusal = self._reading(channel.value, changes).refusal()
            if refusal is not None:
                return f"{channel.value}_axis: {refusal}"
        topics = {str(self._setting(f"{one.value}_topic", changes)) for one in Channel}
        kinds = {str(self._setting(f"{one.value}_type", changes)) for one in Channel}
        if "" in topics:
            return "body_topic and spool_topic: name the topics of both sensors"
        if len(topics) == 1 and len(kinds) == 2:
            return (
                f"spool_type: {topics.pop()} is body_topic, too, and has one type: set body_type to the same"
            )
        if len(topics) == 1 and self._reading("body", changes) == self._reading("spool", changes):
            return "spool_topic: it is body_topic, too, with the same axis and frame: that is one sensor"
        return None

    def _setting(self, name: str, changes: dict[str, Value]) -> Any:
        return changes.get(name, self.value(name))

    def _reading(self, channel: str, changes: dict[str, Value]) -> Reading:
        return Reading(
            self._setting(f"{channel}_type", changes),
            self._setting(f"{channel}_axis", changes),
            self._setting(f"{channel}_unit", changes),
            self._setting(f"{channel}_gain", changes),
            self._setting(f"{channel}_frame", changes),
            self._setting("stamps", changes) == "arrival",
            self._setting("time_column", changes),
            self._setting("sample_rate", changes),
        )

    def _new_aligner(self) -> Aligner:
        names = ("block_rate", "sample_rate", "settle", "longest_wait", "spool_delay")
        return Aligner(
            AlignerSettings(**{name: self.value(name) for name in names}, source=self.value("valve_id"))
        )

    def _wanted(self) -> QoSProfile:
        reliable = self.value("reliability") == "reliable"
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.VOLATILE,
        )

    def _taker(self, channels: dict[Channel, Callable[[Any, int], Samples]]) -> Callable[[Any], None]:
        """Return what takes the messages of one topic for the sensors that are in them."""

        def take(message: Any) -> None:
            arrival = self.get_clock().now().nanoseconds
            for channel, samples in channels.items():
                try:
                    found = samples(message, arrival)
                except UnusableError as unusable:
                    self._tell_unusable(channel, str(unusable))
                    continue
                self._heard[channel] = time.monotonic()
                for stamp, value in found:
                    block = self._aligner.update(channel, stamp, value)
                    if block is not None:
                        self._publisher.publish(block, block.source)

        return take

    def _tell_unusable(self, channel: Channel, reason: str) -> None:
        self._report.unusable[channel] += 1
        self._report.reason[channel] = reason
        count = self._throttle.take(channel.value)
        if count:
            self.get_logger().warning(
                f"{channel.value}: {plural(count, 'message')} could not be used: {reason}"
            )

    def _look(self) -> None:
        """Report about once a second, and at once where the level changes."""
        now = time.monotonic()
        self._report.silent = {one: now - self._heard.get(one, self._begin) for one in Channel}
        self._report.listeners = self._publisher.listeners
        self._report.advance(self._aligner, LOOK)
        if self._report.unpaired >= SETTLED_LOOKS:
            self._publisher.publish(self._aligner.notice(), self.value("valve_id"))
        status = self._report.status(self._aligner, self.get_clock().now().nanoseconds)
        self._looks += 1
        if self._looks >= LOOKS or status.level is not self._level:
            self._looks, self._level = 0, status.level
            self._diagnostics.publish(status)


def main() -> int:
    """Run the node."""
    return run(AdapterNode)


if __name__ == "__main__":
    sys.exit(main())
