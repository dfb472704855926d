"""Bags that others wrote, ROS 1 and ROS 2: their messages by topic, however their index and metadata are."""

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

import zstandard
from rosbags.highlevel import AnyReader, AnyReaderError
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.mcap_file import McapFile, McapMessage, decompressed
from spool_bag.mcap_record import Topic
from spool_bag.metadata import COMPRESSED_WHOLE, Storage, read_metadata, storage_files, types_in, typestore

_SQLITE = b"SQLite format 3"


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
        storage = storage_files(path, foreign=True) if path.is_dir() else Storage([path], 0, [])
        self.warnings = list(storage.warnings)
        self._packed = storage.packed
        self._files = [self._opened(one) for one in storage.files]
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

    def _opened(self, path: Path) -> McapFile | _SqliteFile:
        if path.suffix in COMPRESSED_WHOLE:
            self._folder = self._folder or TemporaryDirectory(prefix="spool_import_")
            path = decompressed(path, Path(self._folder.name))
        with path.open("rb") as file:
            head = file.read(len(_SQLITE))
        return _SqliteFile.opened(path) if head == _SQLITE else McapFile(path)

    def _decoder(self, topic: Topic) -> Callable[[bytes], Any]:
        """Return what decodes the messages of a topic: by the bag's definition, else by the usual one."""
        key = topic.type, topic.schema, topic.encoding
        if key not in self._decoders:
            kind = _with_folder(topic.type)
            store = (types_in(topic.schema, kind) if topic.schema.strip() else None) or typestore()
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
            reader = AnyReader([self.path], default_typestore=typestore())
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
        held = read_metadata(path)["topics_with_message_count"]
        return {str(one["topic_metadata"]["name"]): int(one["message_count"]) for one in held}
    except Exception:  # no file, no folder, no YAML, or other content
        return {}


def _with_folder(kind: str) -> str:
    """Return a type as ROS 2 writes it."""
    package, _, name = kind.rpartition("/")
    return kind if "/" in package or not package else f"{package}/msg/{name}"
