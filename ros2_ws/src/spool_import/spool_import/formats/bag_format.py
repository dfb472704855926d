"""Bags of ROS 1 and ROS 2 (MCAP, SQLite): a group a topic, for accelerometers' messages and our own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.serde import SerdeError
from spool_bag.format.definitions import ACCELERATION_BLOCK, typestore
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.tables.table import MOST_SAMPLES, STAMP, Channel, Group, Table, Values, too_long

from .format import Format

_STAMP = "stamp"
_AXES = ("x", "y", "z")
_NO_TIME = "std_msgs/msg/Float64MultiArray"


#: Messages that hold one reading of three axes, and how it is reached.
_READINGS: dict[str, Callable[[Any], Any]] = {
    "sensor_msgs/msg/Imu": lambda message: message.linear_acceleration,
    "geometry_msgs/msg/AccelStamped": lambda message: message.accel.linear,
    "geometry_msgs/msg/AccelWithCovarianceStamped": lambda message: message.accel.accel.linear,
}


class BagTable(Table):
    """Bag of any ROS: its topics of accelerations.

    Raises:
        InputError: no such topic in it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._reader() as reader:
            groups = [
                Group(connection.topic, self._channels(reader, connection), stamped=True)
                for connection in reader.connections
                if connection.msgtype in (*_READINGS, _NO_TIME, ACCELERATION_BLOCK) and connection.msgcount
            ]
            held = ", ".join(printable(one.topic, 40) for one in reader.connections[:8]) or "nothing"
        if not groups:
            raise InputError(
                f"{path}: no topic of accelerations (sensor_msgs/Imu, geometry_msgs/AccelStamped, "
                f"std_msgs/Float64MultiArray, spool_msgs/AccelerationBlock) with messages in it; it "
                f"has {held}"
            )
        self.groups = tuple({group.name: group for group in groups}.values())

    def _channels(self, reader: Any, connection: Any) -> tuple[Channel, ...]:
        stamp = Channel(_STAMP, STAMP, time=True)
        if connection.msgtype == ACCELERATION_BLOCK:
            return (
                stamp,
                Channel("body", "m/s^2", role="body_m_s2"),
                Channel("spool", "m/s^2", role="spool_m_s2"),
            )
        if connection.msgtype == _NO_TIME:
            message = next(self._messages(reader, connection.topic), None)
            size = np.size(message[1].data) if message else 0
            return (stamp, *(Channel(str(at)) for at in range(size)))
        return (stamp, *(Channel(axis, "m/s^2") for axis in _AXES))

    def read(self, group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return stamps (ns) and values by name."""
        parts: dict[str, list[Any]] = {name: [] for name in names}
        rows = 0
        with self._reader() as reader:
            kind = next(one.msgtype for one in reader.connections if one.topic == group.name)
            for received, message in self._messages(reader, group.name):
                cells = self._cells(kind, received, message)
                rows += np.size(cells[_STAMP])
                if rows > MOST_SAMPLES:
                    raise too_long(self.path)
                for name, kept in parts.items():
                    if name not in cells:
                        raise InputError(
                            f"{self.path}: {printable(group.name, 60)}: a message has no element "
                            f"{printable(name, 20)}: "
                            "its size changes"
                        )
                    kept.append(cells[name])
        joined = np.concatenate if kind == ACCELERATION_BLOCK else np.array
        found: dict[str, Values] = {}
        for name in names:
            row: Any = joined(parts.pop(name))
            found[name] = row.astype(np.int64 if name == _STAMP else np.float64, copy=False)
        return found

    @staticmethod
    def _cells(kind: str, received: int, message: Any) -> dict[str, Any]:
        if kind == _NO_TIME:
            return {_STAMP: received, **{str(at): value for at, value in enumerate(message.data.tolist())}}
        stamp = message.header.stamp
        taken = stamp.sec * 1_000_000_000 + stamp.nanosec
        if kind == ACCELERATION_BLOCK:
            steps = np.rint(np.arange(message.body.size) * (message.sample_period * 1e9)).astype(np.int64)
            return {_STAMP: taken + steps, "body": message.body, "spool": message.spool}
        vector = _READINGS[kind](message)
        return {_STAMP: taken, "x": vector.x, "y": vector.y, "z": vector.z}

    def _messages(self, reader: Any, topic: str) -> Any:
        wanted = [one for one in reader.connections if one.topic == topic]
        for connection, received, data in reader.messages(connections=wanted):
            with suppress(SerdeError):
                yield received, reader.deserialize(data, connection.msgtype)

    def _reader(self) -> AnyReader:
        try:
            return AnyReader([self.path], default_typestore=typestore())
        except AnyReaderError as error:
            raise InputError(f"{self.path}: it cannot be read as a bag: {printable(error, 200)}") from error


FORMAT = Format(
    "bag of ROS 1 or ROS 2",
    (".bag", ".mcap", ".db3"),
    BagTable,
    begins=(b"#ROSBAG", b"\x89MCAP", b"SQLite format 3"),
    folder=True,
)
