"""Node ``adapter``: two accelerometers with a ROS driver as the source of a valve's ``acceleration``."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

from geometry_msgs.msg import AccelStamped, Vector3Stamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu
from spool_core.aligner import CLOCK_STEP, Aligner, AlignerSettings, Channel
from spool_core.block import RecentCounts
from spool_core.cdr import decode_vector
from spool_core.node import qos
from spool_core.node.block_hub import BlockPublisher, Throttle
from spool_core.node.diagnostics import DiagnosticPublisher, Level, Status, key
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter, Value
from spool_core.numbers import GRAVITY
from spool_core.rate_check import LIMIT as WRONG_RATE
from spool_core.sensor_clock import LEAST_STEP
from spool_core.sensor_stream import Refusal
from spool_core.text import plural
from std_msgs.msg import Float64MultiArray

from spool_bag import NOT_MEASURED

#: s between two looks at the sensors, and looks between two reports of an unchanged state: about once a
#: second, and a sensor that stopped is reported within ``stale_after`` and a look.
LOOK, LOOKS = 0.25, 4

#: Messages that may wait: half a second of the fastest rate that single messages can come at.
DEPTH = 5000

#: m/s^2 in one of each unit; g is the standard acceleration of free fall (ISO 80000-3).
UNITS: Mapping[str, float] = {"m/s^2": 1.0, "g": GRAVITY}

IMU, ACCEL, ARRAY = "sensor_msgs/msg/Imu", "geometry_msgs/msg/AccelStamped", "std_msgs/msg/Float64MultiArray"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
TYPES: Mapping[str, Any] = {
    IMU: Imu, ACCEL: AccelStamped, VECTOR: Vector3Stamped, ARRAY: Float64MultiArray,
}  # fmt: skip
_AXIS = re.compile(r"[+-]?[xyz]")
_COLUMN = re.compile(r"[+-]?column\d{1,4}")

#: Of an Imu: B between header and acceleration (orientation, angular velocity and their covariances), and
#: doubles from there: the acceleration and the first of its covariance, which says whether it is measured.
_IN_IMU = (200, 4)

#: Readings whose mean shows gravity, and how far off it a sensor may be.
GRAVITY_READINGS, GRAVITY_OFF = 1000, 0.07
#: s for which a publisher that was killed still counts as one: the lease of Fast DDS, its default.
LEASE = 20.0

Samples = list[tuple[int, float]]
Read = Callable[[bytes, int], Samples]

#: Looks after which a step of one clock is reported: both may have been set, and one is seen first.
SETTLED_LOOKS = 4

_structural = partial(NodeParameter, structural=True)


def _of(channel: str, topic: str) -> tuple[NodeParameter, ...]:
    return (
        _structural(f"{channel}_topic", topic, f"Topic of the accelerometer on the {channel}."),
        _structural(f"{channel}_type", IMU, "Message type of the topic.", choices=tuple(TYPES)),
        _structural(
            f"{channel}_axis",
            "+x",
            "Sensor axis along the spool: +x, +y, +z, -x, -y, -z; for an array +column0 and so on.",
        ),
        _structural(f"{channel}_unit", "m/s^2", "Unit of the readings.", choices=tuple(UNITS)),
        _structural(f"{channel}_gain", 1.0, "Factor applied to the readings.", "1", 1e-9, 1e9),
        _structural(f"{channel}_frame", "", "The only frame_id accepted; empty: any."),
    )


class AdapterNode(ManagedNode):
    """Publish ``acceleration`` out of two sensors that send sample by sample."""

    PARAMETERS: ClassVar = (
        *_of("body", "body/imu"),
        *_of("spool", "spool/imu"),
        _structural("valve_id", "", "The valve's id, sent as frame_id of the blocks; empty: not known."),
        _structural(
            "stamps", "header", "Source of a sample's time: its header or its arrival.",
            choices=("header", "arrival"),
        ),
        _structural(
            "time_column", -1, "Column of an array with the time in s; -1: use the time of arrival.",
            "", -1, 9999,
        ),
        _structural("spool_delay", 0.0, "Delay subtracted from the spool's stamps.", "s", -10.0, 10.0),
        _structural("sample_rate", 0.0, "Sample rate; 0: from the stamps.", "Hz", 0.0, 1e5),
        _structural("block_rate", 50.0, "Blocks a second.", "Hz", 0.1, 1000.0),
        _structural("settle", 1.0, "Time span of stamps from which each clock is estimated.", "s", 0.1, 60.0),
        _structural(
            "longest_wait", 1.0, "Longest time that one sensor waits for the other.", "s", 0.01, 10.0
        ),
        _structural("stale_after", 0.5, "Silence after which a sensor is reported as stale.", "s", 0.1, 60.0),
        _structural(
            "reliability", "best_effort",
            "best_effort: any publisher; reliable: only reliable publishers, which resend lost messages.",
            choices=("best_effort", "reliable"),
        ),
    )  # fmt: skip

    def __init__(self, namespace: str | None = None, **options: Any) -> None:
        super().__init__("adapter", namespace, **options)
        self._throttle = Throttle()

    def configure(self) -> None:
        """Read the table, make the core and the publisher."""
        self._aligner = self._new_aligner()
        self._publisher = BlockPublisher(self, "acceleration", self.value("block_rate"))
        self._diagnostics = DiagnosticPublisher(self, self.value("valve_id"))

    def activate(self) -> None:
        """Listen; forget the messages received before."""
        self._aligner = self._new_aligner()
        topics = {one: self.resolve_topic_name(self.value(f"{one.value}_topic")) for one in Channel}
        self._report = SensorReport(topics, self.value("stale_after"))
        self._report.gravity = {one: Gravity(self.value(f"{one.value}_unit")) for one in Channel}
        self._begin = time.monotonic()
        self._heard: dict[Channel, float] = {}
        self._looks, self._level = 0, Level.OK
        readings = {one: self._reading(one.value, {}) for one in Channel}
        partners = [one.frame for one in readings.values()] if len(set(topics.values())) == 1 else []
        wanted = qos.profile(DEPTH, reliable=self.value("reliability") == "reliable")
        sources = []
        for topic in dict.fromkeys(topics.values()):
            channels = {
                one: replace(reading, gravity=self._report.gravity[one], partners=partners).samples
                for one, reading in readings.items()
                if topics[one] == topic
            }
            kind = TYPES[self.value(f"{next(iter(channels)).value}_type")]
            sources.append((kind, topic, self._taker(channels)))
        self.collect(sources, wanted)
        self.every(LOOK, self._look, steady=True)

    def deactivate(self) -> None:
        """Report that no blocks are sent, by order."""
        self._diagnostics.rest("inactive: no blocks are sent")

    def cleanup(self) -> None:
        """Destroy the publishers."""
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
            return f"spool_type: {topics.pop()} is body_topic as well and has one type: set body_type to it"
        if len(topics) == 1 and self._reading("body", changes) == self._reading("spool", changes):
            return "spool_topic: body_topic has the same topic, axis and frame: name a second sensor"
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

    def _taker(self, channels: dict[Channel, Read]) -> Callable[[bytes, int], None]:
        """Return what takes the messages of one topic for the sensors that are in them."""

        def take(message: bytes, arrival: int) -> None:
            clock = self.get_clock()
            if clock.ros_time_is_active or not arrival:
                arrival = clock.now().nanoseconds
            for channel, samples in channels.items():
                try:
                    found = samples(message, arrival)
                except UnusableError as unusable:
                    self._report.unusable[channel] += 1
                    self._report.reason[channel] = str(unusable)
                    if count := self._throttle.take(channel.value):
                        self.get_logger().warning(
                            f"{channel.value}: {plural(count, 'message')} could not be used: {unusable}"
                        )
                    continue
                if found:
                    self._heard[channel] = time.monotonic()
                for stamp, value in found:
                    block = self._aligner.update(channel, stamp, value)
                    if block is not None:
                        self._publisher.publish(block, block.source)

        return take

    def _look(self) -> None:
        """Report about once a second, and at once where the level changes."""
        now = time.monotonic()
        self._report.silent = {one: now - self._heard.get(one, self._begin) for one in Channel}
        self._report.listeners = self._publisher.listeners
        self._report.count_publishers(
            {
                one: self.count_publishers(self._report.topics[one])
                for one in Channel
                if not str(self.value(f"{one.value}_frame"))
            },
            LOOK,
        )
        self._report.advance(self._aligner, LOOK)
        if self._report.unpaired >= SETTLED_LOOKS:
            self._publisher.publish(self._aligner.notice(), self.value("valve_id"))
        status = self._report.status(self._aligner, self.get_clock().now().nanoseconds)
        self._looks += 1
        if self._looks >= LOOKS or status.level is not self._level:
            self._looks, self._level = 0, status.level
            self._diagnostics.publish(status)


class UnusableError(ValueError):
    """A message holds no sample that can be used; the text says why."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Takes the samples of one sensor out of a message.

    ``kind`` is one of ``TYPES``; ``axis`` is ``+x``, ``+y``, ``+z``, with a minus where it points the other
    way, ``+column0`` and so on of an array; ``unit`` one of ``UNITS``; ``gain`` is multiplied on top.
    ``frame`` is the only ``frame_id`` taken, empty: any. ``by_arrival``: the arrival's time counts, not the
    header's.
    ``time_column``: of an array, in s; -1 for none. ``sample_rate`` (Hz) of arrays with several samples each.
    ``gravity`` gets the axes of all readings. ``partners``: frames of both sensors, where they share a topic.
    """

    kind: str
    axis: str
    unit: str = "m/s^2"
    gain: float = 1.0
    frame: str = ""
    by_arrival: bool = False
    time_column: int = -1
    sample_rate: float = 0.0
    gravity: Gravity | None = field(default=None, compare=False)
    partners: Sequence[str] = field(default=(), compare=False)

    def refusal(self) -> str | None:
        """Return what is wrong with ``axis`` for this type of message, or ``None``."""
        if self.kind == ARRAY:
            good, wanted = _COLUMN.fullmatch(self.axis), "+column0, -column0, +column1 and so on"
        else:
            good, wanted = _AXIS.fullmatch(self.axis), "+x, +y, +z, -x, -y or -z"
        return None if good else f"{self.axis!r} is no axis of {self.kind}: write {wanted}"

    @property
    def samples(self) -> Read:
        """What takes a message (CDR) and its arrival (ns), and returns stamps (ns) and values (m/s^2).

        Raises:
            UnusableError: there is no sample in it for this sensor.
        """
        name = self.axis.lstrip("+-").removeprefix("column")
        factor = UNITS[self.unit] * self.gain * (-1.0 if self.axis.startswith("-") else 1.0)
        if self.kind == ARRAY:
            return lambda message, arrival: self._of_array(
                deserialize_message(message, TYPES[ARRAY]), arrival, int(name), factor
            )
        axis, (skipped, numbers) = "xyz".find(name), _IN_IMU if self.kind == IMU else (0, 3)

        def of_vector(message: bytes, arrival: int) -> Samples:
            stamp, frame, found = decode_vector(message, skipped, numbers)
            if self.frame and frame != self.frame:
                if frame in self.partners:
                    return []
                raise UnusableError(f"frame_id is {frame!r}, not {self.frame!r}")
            if found[3:] == (NOT_MEASURED,):
                raise UnusableError("this Imu message reports that it measures no acceleration")
            if self.gravity is not None:
                self.gravity.take(*found[:3])
            return [(arrival if self.by_arrival else stamp, factor * found[axis])]

        return of_vector

    def _of_array(self, message: Any, arrival: int, column: int, factor: float) -> Samples:
        dimensions = message.layout.dim
        data = message.data[message.layout.data_offset :]
        columns = dimensions[-1].size if len(dimensions) > 1 else len(data)
        if columns < 1 or len(data) % columns or not data:
            raise UnusableError(f"{len(data)} numbers cannot form rows of {columns} columns")
        highest = max(column, self.time_column)
        if highest >= columns:
            raise UnusableError(f"no column {highest}: the array has {columns} columns, counted from 0")
        values = [factor * value for value in data[column::columns]]
        if self.time_column >= 0:
            return [
                (round(1e9 * time) if math.isfinite(time) and abs(time) < 1e10 else 0, value)
                for time, value in zip(data[self.time_column :: columns], values, strict=True)
            ]
        if len(values) == 1:
            return [(arrival, values[0])]
        if self.sample_rate <= 0.0:
            raise UnusableError(f"{len(values)} samples in a message: set sample_rate, or time_column")
        step, last = 1e9 / self.sample_rate, len(values) - 1
        return [(arrival - round((last - place) * step), value) for place, value in enumerate(values)]


@dataclass(slots=True)
class Gravity:
    """Mean of the three axes of a sensor that is set to ``unit``, which shows gravity in its true unit."""

    unit: str
    _count: int = 0
    _sums: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def take(self, *axes: float) -> None:
        """Take a reading."""
        x, y, z = axes
        if math.isfinite(x + y + z):
            self._count += 1
            self._sums[0] += x
            self._sums[1] += y
            self._sums[2] += z

    @property
    def other_unit(self) -> str:
        """Unit in which the mean is gravity, "" where that is the one that is set, or none is."""
        if self._count < GRAVITY_READINGS:
            return ""
        shown = math.hypot(*self._sums) / self._count
        fitting = [unit for unit, size in UNITS.items() if abs(shown * size / GRAVITY - 1.0) < GRAVITY_OFF]
        return "" if not fitting or self.unit in fitting else fitting[0]


@dataclass(slots=True)
class SensorReport:
    """``silent`` s since a sensor's last message; ``unusable`` messages, the last reason.

    ``unpaired``: looks in a row at which one clock was set against the other. ``publishers`` on a sensor's
    topic, and for how many s there have been ``several``.
    """

    topics: dict[Channel, str]
    stale_after: float
    silent: dict[Channel, float] = field(default_factory=lambda: dict.fromkeys(Channel, math.inf))
    unusable: dict[Channel, int] = field(default_factory=lambda: dict.fromkeys(Channel, 0))
    reason: dict[Channel, str] = field(default_factory=lambda: dict.fromkeys(Channel, ""))
    listeners: int = 0
    recent: RecentCounts = field(default_factory=RecentCounts)
    unpaired: int = 0
    publishers: dict[Channel, int] = field(default_factory=dict)
    several: dict[Channel, float] = field(default_factory=lambda: dict.fromkeys(Channel, 0.0))
    gravity: dict[Channel, Gravity] = field(default_factory=dict)
    _counted: tuple[int, int] = (0, 0)

    def count_publishers(self, found: Mapping[Channel, int], seconds: float) -> None:
        """Take the number of publishers on the topics of sensors that no frame selects, ``seconds`` later."""
        self.publishers = dict(found)
        for channel in Channel:
            many = found.get(channel, 0) > 1
            self.several[channel] = self.several[channel] + seconds if many else 0.0

    def advance(self, aligner: Aligner, seconds: float) -> None:
        """Count what was lost and refused in the ``seconds`` since it was asked last."""
        lost = sum(stream.lost for stream in aligner.streams.values())
        refused = sum(stream.refused.total() for stream in aligner.streams.values())
        refused += sum(self.unusable.values())
        self.recent.advance(seconds)
        self.recent.count(max(0, lost - self._counted[0]), max(0, refused - self._counted[1]))
        self._counted = lost, refused
        fault = aligner.fault
        self.unpaired = self.unpaired + 1 if fault is not None and fault.cause == CLOCK_STEP else 0

    def status(self, aligner: Aligner, now: int) -> Status:
        """Return the state of the sensors at ``now`` (ns, on the clock that stamps them)."""
        level, message = self._judgement(aligner)
        values: dict[str, object] = {}
        for channel, stream in aligner.streams.items():
            name, clock = channel.value, stream.clock
            values |= {
                key(f"{name}_rate", "Hz"): clock.rate if clock else math.nan,
                key(f"{name}_jitter", "s"): 1e-9 * clock.jitter if clock else math.nan,
                key(f"{name}_step_limit", "s"): 1e-9 * stream.step_limit,
                f"{name}_received": stream.received,
                f"{name}_lost": stream.lost,
                f"{name}_restarts": stream.restarts,
                f"{name}_clock_steps": stream.steps,
                **{f"{name}_refused_{one.name.lower()}": stream.refused[one] for one in Refusal},
                f"{name}_unusable": self.unusable[channel],
                f"{name}_publishers": self.publishers.get(channel, 0),
                key(f"{name}_silent", "s"): self.silent[channel],
                key(f"{name}_age", "s"): 1e-9 * (now - stream.newest) if stream.newest else math.nan,
            }
        return Status(
            "sensors",
            level,
            message,
            values
            | {
                key("sample_rate", "Hz"): aligner.sample_rate,
                key("offset", "s"): aligner.offset,
                key("drift", "ppm"): 1e6 * aligner.drift,
                key("spool_behind", "s"): aligner.apart,
                key("clock_step", "s"): aligner.clock_step,
                key("wandered", "s"): aligner.wandered,
                "late_samples": aligner.late,
                "blocks_sent": aligner.sent,
                "blocks_dropped": aligner.dropped,
                "listeners": self.listeners,
            },
        )

    def _judgement(self, aligner: Aligner) -> tuple[Level, str]:
        faults = [self._silence(aligner, channel) for channel in Channel]
        mismatch = self._mismatch(aligner)
        for found in (*faults, self._mixture(mismatch is not None), mismatch):
            if found is not None:
                return found
        for channel, one in self.gravity.items():
            if one.other_unit:
                text = f"{channel.value}: its three axes show gravity in {one.other_unit}"
                return Level.WARNING, f"{text}: set {channel.value}_unit to it instead of {one.unit}"
        if not aligner.settled or aligner.fault is not None:
            return Level.WARNING, "finding the sensors' rates"
        if self.recent.lost or self.recent.refused:
            why = next((text for text in self.reason.values() if text), "")
            text = (
                f"{plural(self.recent.lost, 'sample')} lost, {self.recent.refused} refused in the last minute"
            )
            return Level.WARNING, f"{text}: {why}" if why else text
        if aligner.wandered:
            text = f"{1e3 * abs(aligner.wandered):.2g} ms apart by now"
            return Level.WARNING, f"the sensors' clocks drift against each other, {text}: synchronise them"
        drift = "" if math.isnan(aligner.drift) else f", drift {1e6 * aligner.drift:+.1f} ppm"
        steps = max(stream.found.resolution if stream.found else 0.0 for stream in aligner.streams.values())
        coarse = f", stamps in steps of {1e3 * steps:g} ms" if 1e9 * steps >= LEAST_STEP else ""
        return Level.OK, f"{aligner.sample_rate:.6g} Hz{drift}{coarse}"

    def _silence(self, aligner: Aligner, channel: Channel) -> tuple[Level, str] | None:
        stream, silent = aligner.streams[channel], self.silent[channel]
        if silent <= self.stale_after:
            return None
        if stream.received == 0:
            if self.unusable[channel]:
                return Level.ERROR, f"{channel.value}: {self.reason[channel]}"
            return Level.WARNING, f"{channel.value}: nothing came on {self.topics[channel]} so far"
        return Level.ERROR, f"{channel.value}: nothing on {self.topics[channel]} for {silent:.1f} s"

    def _mixture(self, mismatch: bool) -> tuple[Level, str] | None:
        """Return which topic has several publishers: for good, or beside a ``mismatch`` of stamps."""
        for channel, seconds in self.several.items():
            if seconds > LEASE or (mismatch and seconds > 0.0):
                return (
                    Level.ERROR,
                    f"{channel.value}: {self.publishers[channel]} publishers on {self.topics[channel]}, "
                    f"whose samples mix: stop all but one, or set {channel.value}_frame",
                )
        return None

    def _mismatch(self, aligner: Aligner) -> tuple[Level, str] | None:
        """Return what keeps the two from being one stream, or ``None``."""
        settings = aligner.settings
        for channel, stream in aligner.streams.items():
            if stream.clock is None and stream.refused[Refusal.RATE]:
                return Level.ERROR, f"{channel.value}: {Refusal.RATE.value}"
            if stream.clock is None and stream.doubt:
                advice = "let the driver stamp each sample, or set stamps to arrival"
                return (
                    Level.ERROR,
                    f"{channel.value}: its stamps show no sample rate ({stream.doubt}): {advice}",
                )
            rate = stream.clock.rate if stream.clock is not None else math.nan
            if settings.sample_rate > 0.0 and abs(rate / settings.sample_rate - 1.0) > WRONG_RATE:
                wanted = f"sample_rate is {settings.sample_rate:.6g} Hz: set it to 0 or to the right rate"
                return Level.ERROR, f"{channel.value}: its stamps show {rate:.6g} Hz, {wanted}"
        fault = aligner.fault
        if fault is not None and (fault.cause != CLOCK_STEP or self.unpaired >= SETTLED_LOOKS):
            return Level.ERROR, fault.text
        if abs(aligner.apart) > settings.longest_wait:
            advice = "synchronise their clocks, or set stamps to arrival"
            return Level.ERROR, f"the sensors' stamps are {abs(aligner.apart):.6g} s apart: {advice}"
        return None
