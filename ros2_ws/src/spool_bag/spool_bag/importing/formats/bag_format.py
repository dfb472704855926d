"""Bags of ROS 1 and ROS 2 (MCAP, SQLite), also by others: a group a topic, for accelerometers and our own."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import zstandard
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader, AnyReaderError
from spool_core.errors import InputError
from spool_core.text import plural, printable

from spool_bag import NOT_MEASURED, metadata
from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import LOG_TIME, MOST_SAMPLES, STAMP, Channel, Group, Table, Values, too_long
from spool_bag.mcap_file import McapFile, McapMessage, decompressed
from spool_bag.mcap_record import Topic
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
_SQLITE, _ZSTD = b"SQLite format 3", b"\x28\xb5\x2f\xfd"


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


class Held(NamedTuple):
    """Topic of a bag: its type, e.g. ``sensor_msgs/msg/Imu``, and the messages that the bag counts on it.

    ``stated`` is 0 where it does not count them.
    """

    type: str
    stated: int


class Message(NamedTuple):
    """Time of reception (ns), number in the recording and content of a message.

    ``content`` is ``None`` where the bytes are no message of the topic's type.
    """

    received: int
    sequence: int
    content: Any


@dataclass(frozen=True, slots=True)
class _SqliteFile:
    """File of a bag in SQLite, read without the metadata beside it."""

    path: Path
    topics: dict[int, Topic]
    counts: dict[int, int]
    closed: bool = True

    @classmethod
    def opened(cls, path: Path) -> _SqliteFile:
        """Return the file at ``path``.

        Raises:
            InputError: it is no bag, or damaged.
        """
        try:
            with closing(_connected(path)) as base:
                described = {name: "" for (name,) in base.execute("SELECT type FROM topics")}
                tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master")}
                if "message_definitions" in tables:
                    rows = base.execute(
                        "SELECT topic_type, encoded_message_definition FROM message_definitions"
                    )
                    described |= {
                        name: (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text))
                        for name, text in rows
                    }
                topics = {
                    number: Topic(name, kind, described[kind], "ros2msg", encoding, "", "")
                    for number, name, kind, encoding in base.execute(
                        "SELECT id, name, type, serialization_format FROM topics"
                    )
                }
                counts = dict(base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        except sqlite3.Error as error:
            raise InputError(
                f"{path}: it cannot be read as a bag in SQLite: {printable(error, 100)}"
            ) from error
        return cls(path, topics, counts)

    def records(self, wanted: Callable[[Topic], bool]) -> Iterator[McapMessage]:
        """Yield the messages of the ``wanted`` topics by their time of reception."""
        numbers = [number for number, topic in self.topics.items() if wanted(topic)]
        marks = ",".join("?" * len(numbers))
        chosen = f"FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp, id"
        try:
            with closing(_connected(self.path)) as base:
                for number, time, data in base.execute(f"SELECT topic_id, timestamp, data {chosen}", numbers):
                    yield McapMessage(number, 0, time, time, data)
        except sqlite3.Error as error:
            raise InputError(
                f"{self.path}: it is damaged ({printable(error, 100)}): copy it again"
            ) from error


class ForeignBag:
    """Bag of ROS 2: a file or a folder of MCAP or SQLite.

    Index and metadata are used as far as they are there: what counts are the messages themselves.

    Attributes:
        topics: what the bag holds by name, topics without a message included.
        warnings: what is missing or not as it should be, one line each; complete only after reading.

    Raises:
        InputError: there is no bag at ``path``, or it is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._folder: TemporaryDirectory[str] | None = None
        storage = (
            metadata.storage_files(path, foreign=True) if path.is_dir() else metadata.Storage([path], 0, [])
        )
        self.warnings = list(storage.warnings)
        self._packed = storage.packed
        self._files: list[McapFile | _SqliteFile] = []
        for one in storage.files:
            plain = one
            if one.suffix in metadata.COMPRESSED_WHOLE:
                self._folder = self._folder or TemporaryDirectory(prefix="spool_import_")
                plain = decompressed(one, Path(self._folder.name))
            with plain.open("rb") as content:
                is_sqlite = content.read(len(_SQLITE)) == _SQLITE
            self._files.append(_SqliteFile.opened(plain) if is_sqlite else McapFile(plain))
        self.warnings += [
            f"{file.path.name}: the recording was not finished: data not yet written to the disk are missing"
            for file in self._files
            if not file.closed
        ]
        counted: Counter[str] = Counter()
        kinds: dict[str, str] = {}
        for file in self._files:
            counts = file.counts
            if counts is None:  # topics of a file without a summary are known once it is read
                counts = Counter(one.channel for one in file.records(lambda _: True))
            for number, topic in file.topics.items():
                kinds.setdefault(topic.name, _with_folder(topic.type))
                counted[topic.name] += counts.get(number, 0)
        stated = _stated(path)
        self.topics = {
            name: Held(kind, max(counted[name], stated.get(name, 0))) for name, kind in kinds.items()
        }
        self._decoders: dict[tuple[str, str, str], Callable[[bytes], Any]] = {}

    def messages(self, topic: str) -> Iterator[Message]:
        """Yield the messages of a topic.

        Raises:
            InputError: the file is damaged, or in an encoding that is not read.
        """
        for file in self._files:
            for record in file.records(lambda one: one.name == topic):
                decode = self._decoder(file.topics[record.channel])
                try:
                    content = decode(zstandard.decompress(record.data) if self._packed else record.data)
                except Exception:  # rosbags, struct, NumPy, zstd: whatever a bad byte brings
                    content = None
                yield Message(record.log_time, record.sequence, content)

    def _decoder(self, topic: Topic) -> Callable[[bytes], Any]:
        """Return what decodes the messages of a topic: by the bag's definition, else by the usual one."""
        key = topic.type, topic.schema, topic.encoding
        if key not in self._decoders:
            kind = _with_folder(topic.type)
            store = (
                metadata.types_in(topic.schema, kind) if topic.schema.strip() else None
            ) or metadata.typestore()
            decoders = {"cdr": store.deserialize_cdr, "ros1": store.deserialize_ros1}
            if topic.encoding not in decoders:
                raise InputError(
                    f"{self.path}: {printable(topic.name, 60)} is encoded as "
                    f"{printable(topic.encoding, 20)!r}; only cdr and ros1 are read: convert the bag with "
                    "the tool that wrote it"
                )
            read = decoders[topic.encoding]
            self._decoders[key] = lambda data: read(data, kind)
        return self._decoders[key]


class Ros1Bag(ForeignBag):
    """Bag of ROS 1, read by its index."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings = []
        with self._reader() as reader:
            counted: Counter[str] = Counter()
            for one in reader.connections:
                counted[one.topic] += one.msgcount
            self.topics = {one.topic: Held(one.msgtype, counted[one.topic]) for one in reader.connections}

    def messages(self, topic: str) -> Iterator[Message]:
        """Yield the messages of a topic."""
        with self._reader() as reader:
            wanted = [one for one in reader.connections if one.topic == topic]
            for connection, received, data in reader.messages(connections=wanted) if wanted else ():
                try:
                    content = reader.deserialize(data, connection.msgtype)
                except Exception:  # as above
                    content = None
                yield Message(received, 0, content)

    def _reader(self) -> Any:
        try:
            reader = AnyReader([self.path], default_typestore=metadata.typestore())
            reader.open()
        except AnyReaderError as error:
            raise InputError(
                f"{self.path}: it cannot be read as a bag of ROS 1: {printable(error, 200)}"
            ) from error
        return closing(reader)


def opened(path: Path) -> ForeignBag:
    """Return the bag at ``path``.

    Raises:
        InputError: it cannot be read.
    """
    if path.is_file():
        with path.open("rb") as file:
            if file.read(7) == b"#ROSBAG":
                return Ros1Bag(path)
    return ForeignBag(path)


def interleaved(numbers: Sequence[int]) -> bool:
    """Return whether the numbers of messages are those of two publishers, each of which counts its own."""
    steps = [later - before for before, later in pairwise(numbers)]
    back = sum(step <= 0 for step in steps)
    return any(numbers) and 5 * back > len(steps) > 10


def _connected(path: Path) -> sqlite3.Connection:
    """Return a connection that writes nothing, not even beside the file, whatever its path holds."""
    # Only what a recorder had not yet moved into the file needs the log beside it.
    beside = path.with_name(f"{path.name}-wal")
    way = "mode=ro" if beside.is_file() and beside.stat().st_size else "mode=ro&immutable=1"
    return sqlite3.connect(f"file:{quote(str(path.absolute()))}?{way}", uri=True)


def _stated(path: Path) -> dict[str, int]:
    """Return the messages by topic that a folder's ``metadata.yaml`` counts; none if it cannot be read."""
    try:
        held = metadata.read_metadata(path)["topics_with_message_count"]
        return {str(one["topic_metadata"]["name"]): int(one["message_count"]) for one in held}
    except Exception:  # no file, no folder, no YAML, or other content
        return {}


def _with_folder(kind: str) -> str:
    """Return a type as ROS 2 writes it."""
    package, _, name = kind.rpartition("/")
    return kind if "/" in package or not package else f"{package}/msg/{name}"


FORMAT = Format(
    "bag of ROS 1 or ROS 2",
    (".bag", ".mcap", ".db3", ".mcap.zstd"),
    BagTable,
    begins=(b"#ROSBAG", b"\x89MCAP", _SQLITE, _ZSTD),
    folder=True,
)
