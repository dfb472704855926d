"""Bags of ROS 1 and ROS 2 (MCAP, SQLite): a group a topic, for accelerometers' messages and our own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.text import plural, printable

from spool_bag import NOT_MEASURED
from spool_bag.importing.foreign_bag import Held, interleaved, opened
from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import LOG_TIME, MOST_SAMPLES, STAMP, Channel, Group, Table, Values, too_long
from spool_bag.metadata import ACCELERATION_BLOCK

_STAMP = "stamp"
_AXES = ("x", "y", "z")
_NO_TIME = "std_msgs/msg/Float64MultiArray"


#: Messages that hold one reading of three axes, and how it is reached.
_READINGS: dict[str, Callable[[Any], Any]] = {
    "sensor_msgs/msg/Imu": lambda message: message.linear_acceleration,
    "geometry_msgs/msg/AccelStamped": lambda message: message.accel.linear,
    "geometry_msgs/msg/AccelWithCovarianceStamped": lambda message: message.accel.accel.linear,
    "geometry_msgs/msg/Vector3Stamped": lambda message: message.vector,
}
#: Share of messages with a stamp of 0 that are left out: nodes send some before their clock is known.
MOST_ZERO = 0.05
#: Share of the usual step below which two stamps are too close to be those of a regular clock.
TOO_CLOSE = 0.5
_ZSTD = b"\x28\xb5\x2f\xfd"


class BagTable(Table):
    """Bag of any ROS: its topics of accelerations.

    Attributes:
        clocks: of each topic that was read, header stamps and times of reception (ns, shape (n,)).

    Raises:
        InputError: no such topic in it.
    """

    zoned = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self.clocks: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
        self._bag = opened(path)
        self.groups = tuple(
            Group(name, self._channels(name, held), stamped=True)
            for name, held in self._bag.topics.items()
            if held.type in (*_READINGS, _NO_TIME, ACCELERATION_BLOCK) and held.stated
        )
        self.warnings = tuple(self._bag.warnings)
        if not self.groups:
            held_topics = ", ".join(
                f"{printable(name, 40)} ({printable(held.type, 40)}{'' if held.stated else ', empty'})"
                for name, held in list(self._bag.topics.items())[:8]
            )
            raise InputError(
                f"{path}: no topic of accelerations (sensor_msgs/Imu, geometry_msgs/AccelStamped, "
                "geometry_msgs/Vector3Stamped, std_msgs/Float64MultiArray, spool_msgs/AccelerationBlock) "
                f"with messages in it; it has {held_topics or 'nothing'}"
            )

    def _channels(self, name: str, held: Held) -> tuple[Channel, ...]:
        stamp, log = Channel(_STAMP, STAMP, time=True), Channel(LOG_TIME, STAMP)
        if held.type == ACCELERATION_BLOCK:
            return (
                stamp,
                Channel("body", "m/s^2", role="body_m_s2"),
                Channel("spool", "m/s^2", role="spool_m_s2"),
            )
        if held.type == _NO_TIME:
            first = next((one.content for one in self._bag.messages(name) if one.content is not None), None)
            size = 0 if first is None else np.size(_data(first))
            labels = [] if first is None else [one.label for one in first.layout.dim if one.label]
            if labels:
                self.settings = Settings({"labels of dimensions": ", ".join(labels)})
            return (stamp, *(Channel(str(at)) for at in range(size)))
        return (stamp, *(Channel(axis, "m/s^2") for axis in _AXES), log)

    def read(self, group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return stamps (ns) and values by name."""
        title, kind = printable(group.name, 60), self._bag.topics[group.name].type
        vectors = kind in _READINGS
        wanted = list(dict.fromkeys([*names, _STAMP, *(_AXES if vectors else ())]))
        parts: dict[str, list[Any]] = {name: [] for name in wanted}
        times: list[int] = []
        numbers: list[int] = []
        frames: dict[str, None] = {}
        rows = seen = 0
        for message in self._bag.messages(group.name):
            seen += 1
            if message.content is None:
                continue
            cells = self._cells(kind, message.received, message.content)
            if cells is None:
                raise InputError(
                    f"{self.path}: {title}: these messages state that they contain no acceleration "
                    f"(covariance {NOT_MEASURED:g}): name the topic of the accelerometer with --topic"
                )
            rows += np.size(cells[_STAMP])
            if rows > MOST_SAMPLES:
                raise too_long(self.path)
            times.append(message.received)
            numbers.append(message.sequence)
            if hasattr(message.content, "header"):
                frames.setdefault(message.content.header.frame_id)
            for name, kept in parts.items():
                if name not in cells:
                    raise InputError(
                        f"{self.path}: {title}: a message has no element {printable(name, 20)}: "
                        "its size changes"
                    )
                kept.append(cells[name])
        self._check_one_publisher(title, list(frames), numbers)
        if not times and seen:
            raise InputError(
                f"{self.path}: {title}: none of its {seen} messages is a {kind} as the bag defines it"
            )
        self.account(title, "messages", self._bag.topics[group.name].stated, len(times))
        joined = np.concatenate if kind == ACCELERATION_BLOCK else np.array
        found: dict[str, Values] = {}
        for name in wanted:
            row: Any = joined(parts.pop(name)) if times else np.empty(0)
            found[name] = row.astype(np.int64 if name in (_STAMP, LOG_TIME) else np.float64, copy=False)
        if vectors and rows:
            mean = [float(found[axis].mean()) for axis in _AXES]
            self.gravity = {**self.gravity, group.name: float(np.linalg.norm(mean))}
        if _STAMP in names:
            found = self._in_order(group, found, np.array(times, dtype=np.int64))
        elif LOG_TIME in names:
            order = np.argsort(found[LOG_TIME], kind="stable")
            found = {name: row[order] for name, row in found.items()}
        return {name: found[name] for name in names}

    def _check_one_publisher(self, title: str, frames: Sequence[str], numbers: Sequence[int]) -> None:
        """Check that one publisher alone wrote a topic.

        Raises:
            InputError: there were several.
        """
        several = ""
        if len(frames) > 1:
            several = f"frame_id is {' and '.join(repr(printable(one, 30)) for one in frames[:4])}"
        elif interleaved(numbers):
            several = "the messages are numbered twice"
        if several:
            raise InputError(
                f"{self.path}: {title}: several publishers wrote this topic ({several}): their "
                "samples cannot be separated: record each sensor on a separate topic"
            )

    def _in_order(
        self, group: Group, found: dict[str, Values], times: NDArray[np.int64]
    ) -> dict[str, Values]:
        """Return the messages in order of their stamps, without those that have none.

        Messages that overtook each other are sorted; a clock that was set back is left for the judgement of
        stamps.

        Raises:
            InputError: there are no stamps.
        """
        name, stamps = printable(group.name, 60), np.asarray(found[_STAMP], dtype=np.int64)
        if times.size == stamps.size:
            zero = int(np.count_nonzero(stamps <= 0))
            if zero > MOST_ZERO * stamps.size:
                raise InputError(
                    f"{self.path}: {name}: {zero} of {stamps.size} header stamps are 0: type --stamps log to "
                    "use the times at which the recorder received the messages"
                )
            if zero:
                kept = stamps > 0
                found = {one: row[kept] for one, row in found.items()}
                stamps, times = stamps[kept], times[kept]
                self.warnings = (*self.warnings, f"{name}: {plural(zero, 'message')} left out: no stamp")
        late = int(np.count_nonzero(np.diff(stamps) < 0))
        if late:
            order = np.argsort(stamps, kind="stable")
            close = TOO_CLOSE * float(np.median(np.abs(np.diff(stamps))))
            if np.count_nonzero(np.diff(stamps[order]) < close) <= np.count_nonzero(
                np.abs(np.diff(stamps)) < close
            ):
                found = {one: row[order] for one, row in found.items()}
                if times.size == stamps.size:
                    times = times[order]
                text = f"{name}: {plural(late, 'message')} out of order: sorted by stamp"
                self.warnings = (*self.warnings, text)
        if times.size == stamps.size:
            self.clocks[group.name] = np.asarray(found[_STAMP], dtype=np.int64), times
        return found

    @staticmethod
    def _cells(kind: str, received: int, message: Any) -> dict[str, Any] | None:
        """Return the readings of a message by channel, ``None`` where it says that it holds none."""
        if kind == _NO_TIME:
            return {_STAMP: received, **{str(at): value for at, value in enumerate(_data(message).tolist())}}
        stamp = message.header.stamp
        taken = stamp.sec * 1_000_000_000 + stamp.nanosec
        if kind == ACCELERATION_BLOCK:
            steps = np.rint(np.arange(message.body.size) * (message.sample_period * 1e9)).astype(np.int64)
            return {_STAMP: taken + steps, "body": message.body, "spool": message.spool}
        covariance = getattr(message, "linear_acceleration_covariance", None)
        if covariance is not None and covariance[0] == NOT_MEASURED:
            return None
        vector = _READINGS[kind](message)
        return {_STAMP: taken, LOG_TIME: received, "x": vector.x, "y": vector.y, "z": vector.z}


def _data(message: Any) -> NDArray[np.float64]:
    """Return the values of an array, without the padding in front of them."""
    values: NDArray[np.float64] = message.data[message.layout.data_offset :]
    return values


FORMAT = Format(
    "bag of ROS 1 or ROS 2",
    (".bag", ".mcap", ".db3", ".mcap.zstd"),
    BagTable,
    begins=(b"#ROSBAG", b"\x89MCAP", b"SQLite format 3", _ZSTD),
    folder=True,
)
