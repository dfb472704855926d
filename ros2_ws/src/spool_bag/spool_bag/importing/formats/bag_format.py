"""Bags of ROS 1 and ROS 2 (MCAP, SQLite): a group a topic, for accelerometers' messages and our own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.serde import SerdeError
from spool_core.errors import InputError
from spool_core.text import plural, printable

from spool_bag.importing.formats.format import Format
from spool_bag.importing.table import LOG_TIME, MOST_SAMPLES, STAMP, Channel, Group, Table, Values, too_long
from spool_bag.mcap_file import decompressed
from spool_bag.metadata import ACCELERATION_BLOCK, COMPRESSED, storage_of, typestore

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

    def __init__(self, path: Path) -> None:
        self.path = path
        self.clocks: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
        self._folder: TemporaryDirectory[str] | None = None
        self._files = self._plain_files()
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
                "geometry_msgs/Vector3Stamped, std_msgs/Float64MultiArray, spool_msgs/AccelerationBlock) "
                f"with messages in it; it has {held}"
            )
        self.groups = tuple({group.name: group for group in groups}.values())

    def _channels(self, reader: Any, connection: Any) -> tuple[Channel, ...]:
        stamp, log = Channel(_STAMP, STAMP, time=True), Channel(LOG_TIME, STAMP)
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
        return (stamp, *(Channel(axis, "m/s^2") for axis in _AXES), log)

    def read(self, group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return stamps (ns) and values by name."""
        wanted = list(dict.fromkeys([*names, _STAMP]))
        parts: dict[str, list[Any]] = {name: [] for name in wanted}
        times: list[int] = []
        rows = 0
        with self._reader() as reader:
            kind = next(one.msgtype for one in reader.connections if one.topic == group.name)
            for received, message in self._messages(reader, group.name):
                cells = self._cells(kind, received, message)
                rows += np.size(cells[_STAMP])
                if rows > MOST_SAMPLES:
                    raise too_long(self.path)
                times.append(received)
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
        for name in wanted:
            row: Any = joined(parts.pop(name))
            found[name] = row.astype(np.int64 if name in (_STAMP, LOG_TIME) else np.float64, copy=False)
        if _STAMP in names:
            found = self._in_order(group, found, np.array(times, dtype=np.int64))
        return {name: found[name] for name in names}

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
    def _cells(kind: str, received: int, message: Any) -> dict[str, Any]:
        if kind == _NO_TIME:
            return {_STAMP: received, **{str(at): value for at, value in enumerate(message.data.tolist())}}
        stamp = message.header.stamp
        taken = stamp.sec * 1_000_000_000 + stamp.nanosec
        if kind == ACCELERATION_BLOCK:
            steps = np.rint(np.arange(message.body.size) * (message.sample_period * 1e9)).astype(np.int64)
            return {_STAMP: taken + steps, "body": message.body, "spool": message.spool}
        vector = _READINGS[kind](message)
        return {_STAMP: taken, LOG_TIME: received, "x": vector.x, "y": vector.y, "z": vector.z}

    def _messages(self, reader: Any, topic: str) -> Any:
        wanted = [one for one in reader.connections if one.topic == topic]
        for connection, received, data in reader.messages(connections=wanted):
            with suppress(SerdeError):
                yield received, reader.deserialize(data, connection.msgtype)

    def _plain_files(self) -> list[Path]:
        """Return what is opened: the bag, its only file decompressed, or files whose storage is not named."""
        if self.path.is_file() and self.path.suffix in (COMPRESSED, ".zst"):
            self._folder = TemporaryDirectory(prefix="spool_import_")
            return [decompressed(self.path, Path(self._folder.name))]
        if self.path.is_dir() and storage_of(self.path) == "":
            return sorted(self.path.glob("*.mcap")) or [self.path]
        return [self.path]

    def _reader(self) -> AnyReader:
        try:
            return AnyReader(self._files, default_typestore=typestore())
        except AnyReaderError as error:
            raise InputError(f"{self.path}: it cannot be read as a bag: {printable(error, 200)}") from error


FORMAT = Format(
    "bag of ROS 1 or ROS 2",
    (".bag", ".mcap", ".db3", ".mcap.zstd"),
    BagTable,
    begins=(b"#ROSBAG", b"\x89MCAP", b"SQLite format 3", _ZSTD),
    folder=True,
)
