"""Parts of a recording: the file that is written, and those that are there already."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mcap._chunk_builder import ChunkBuilder
from mcap.records import Channel, Message, MessageIndex, Schema
from mcap.writer import CompressionType, Writer
from spool_core.errors import InputError
from spool_core.system import OPEN_FLAGS

from spool_bag.mcap_file import McapFile
from spool_bag.mcap_record import message_head
from spool_bag.metadata import Definition, PartCount, TopicCount, part_of, qos_of
from spool_bag.part_records import is_stub

#: B: what is written faster than it was recorded closes no chunk by time; this is 8 s of a valve at 2 kHz,
#: which a damaged chunk then costs. A packed sample record takes no more room so than in chunks of 1 MiB.
CHUNK_SIZE = 1 << 17
#: B of an index at most (MCAP specification): of a chunk, of a channel in it, of a definition besides its
#: texts, and of all else: statistics with some hundred channels, other records, offsets, footer.
CHUNK_INDEX, OFFSET, DEFINITION, INDEX = 100, 10, 200, 16_384

#: Of the chunks with messages of a channel the first ones that define it, and every how many later ones do:
#: in every chunk of 0.7 s the definitions of one valve's accelerations alone add 6 % to a recording, so 1 %.
FIRST, EVERY = 4, 8


class RepeatingChunks(ChunkBuilder):
    """Chunk builder that puts schema and channel before the first message of a channel in a chunk.

    A file then loses nothing but the chunk that is damaged, even if it is the first one. Definitions may be
    repeated (MCAP specification, "Channel": identical records with the same id).
    """

    def __init__(self) -> None:
        super().__init__()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._here: set[int] = set()
        self._uses: dict[int, int] = {}
        self._used: set[int] = set()

    def add_schema(self, schema: Schema) -> None:
        """Register a schema."""
        self._schemas[schema.id] = schema

    def add_channel(self, channel: Channel) -> None:
        """Register a channel."""
        self._channels[channel.id] = channel

    def add_message(self, message: Message) -> None:
        """Add a message, behind its definitions where they are not yet in this chunk."""
        channel = message.channel_id
        if channel not in self._used:
            self._used.add(channel)
            uses = self._uses.get(channel, 0)
            self._uses[channel] = uses + 1
            if uses < FIRST or uses % EVERY == 0:
                registered = self._channels[channel]
                if registered.schema_id and registered.schema_id not in self._here:
                    super().add_schema(self._schemas[registered.schema_id])
                    self._here.add(registered.schema_id)
                super().add_channel(registered)
        time, records = message.log_time, self.record_writer
        index = self.message_indices.get(channel)
        if index is None:
            index = self.message_indices[channel] = MessageIndex(channel, [])
        index.records.append((time, records.count))
        self.message_start_time = min(self.message_start_time, time) if self.num_messages else time
        self.message_end_time = max(self.message_end_time, time)
        self.num_messages += 1
        records.write(message_head(message))
        records.write(message.data)

    def reset(self) -> None:
        """Begin the next chunk."""
        super().reset()  # type: ignore[no-untyped-call]
        self._here.clear()
        self._used.clear()


class Output:
    """Unbuffered file: mcap hands over whole chunks, and a full disk must be seen immediately.

    Not derived from ``io.RawIOBase``, around which mcap puts a buffer: so mcap declares no such type.
    """

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | OPEN_FLAGS, 0o644)
        self.position = 0
        self.digest = hashlib.sha256()

    def write(self, data: bytes) -> int:
        """Write all of ``data``."""
        view = memoryview(data)
        while view:
            written = os.write(self.descriptor, view)
            self.digest.update(view[:written])
            self.position += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        """Return how much was written, B."""
        return self.position

    def flush(self) -> None:
        """Nothing is buffered here."""

    def sync(self) -> None:
        """Bring what was written to the disk."""
        os.fsync(self.descriptor)

    def cut(self, size: int) -> None:
        """Leave the first ``size`` B."""
        os.ftruncate(self.descriptor, size)

    def close(self) -> None:
        """Close the file; closing again does nothing, since its number may be another's by then."""
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


class McapPart:
    """MCAP file under way, with what it counts.

    Attributes:
        path: the file. count: what is in it by topic, and when; of the messages handed over.
        good: B up to the last complete chunk that is on the disk, and ``head`` what comes before the first.

    Raises:
        OSError: from any method.
    """

    def __init__(self, path: Path, number: int, about: Mapping[str, Mapping[str, str]] | None = None) -> None:
        self.path = path
        self.count = PartCount(path.name, number)
        self._output = Output(path)
        self._writer = Writer(self._output, CHUNK_SIZE, CompressionType.ZSTD)  # type: ignore[arg-type]
        # mcap 1.6.0 lets nobody choose the chunk builder or count the chunks, hence its private attributes.
        parts = vars(self._writer)
        assert "_Writer__chunk_builder" in parts, "mcap has changed: see RepeatingChunks"
        parts["_Writer__chunk_builder"] = RepeatingChunks()
        self._schemas: dict[str, int] = {}
        # One for each chunk, of which mcap writes an index at the end.
        self._chunks: Sequence[object] = parts["_Writer__chunk_indices"]
        self._channels = self._defined = 0
        try:
            self._writer.start(profile="ros2", library="spool_bag")
            for name, content in (about or {}).items():
                self._writer.add_metadata(name, dict(content))
        except OSError:
            self.discard()
            raise
        self.good = self.head = self._output.tell()

    @property
    def size(self) -> int:
        """B in the file."""
        return self._output.position

    @property
    def closing(self) -> int:
        """B that its index takes at most when it is finished."""
        return INDEX + self._defined + len(self._chunks) * (CHUNK_INDEX + OFFSET * self._channels)

    @property
    def digest(self) -> str:
        """SHA-256 of what was written so far."""
        return self._output.digest.hexdigest()

    def add(self, topic: str, type_name: str, described: Definition, qos: str) -> int:
        """Return the number of a new channel."""
        self._channels += 1
        self._defined += DEFINITION + len(topic) + len(type_name) + len(qos)
        if type_name not in self._schemas:
            self._defined += DEFINITION + len(type_name) + len(described.text.encode())
            self._schemas[type_name] = self._writer.register_schema(
                type_name, described.encoding, described.text.encode()
            )
        return self._writer.register_channel(
            topic,
            "cdr",
            self._schemas[type_name],
            {"offered_qos_profiles": qos, "topic_type_hash": described.digest},
        )

    def write(
        self, channel: int, topic: str, log_time: int, data: bytes, published: int, sequence: int
    ) -> None:
        """Append a message."""
        self._writer.add_message(channel, log_time, data, published, sequence)
        self.count.take(topic, log_time)

    def flush(self) -> None:
        """Close the chunk in progress and sync it."""
        self._writer.flush()
        self._output.sync()
        self.good = self._output.tell()

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Write a metadata record behind what is complete."""
        self._writer.add_metadata(name, dict(content))

    def finish(self) -> None:
        """Write index and footer, sync and close."""
        self._writer.finish()
        self._output.sync()
        self.good = self.count.size = self._output.position
        self._output.close()

    def discard(self) -> None:
        """Remove the file."""
        with contextlib.suppress(OSError):
            self._output.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def abandon(self, *, cut: bool) -> bool:
        """Close without an index, cut back to the last chunk that is synced where that is asked.

        Return whether it is: where the disk takes no more, not even that, what lies on it is what it is.
        """
        sure = True
        try:
            if cut and self._output.position > self.good:
                self._output.cut(self.good)
                self._output.sync()
        except OSError:
            sure = False
        self.count.size = self.good if cut else self._output.position
        with contextlib.suppress(OSError):
            self._output.close()
        return sure


class Existing(NamedTuple):
    """Existing parts in order, their topics, their files by number, and whether the last one was finished."""

    parts: list[PartCount]
    topics: list[tuple[TopicCount, Definition]]
    files: list[tuple[int, Path]]
    finished: bool


def numbered(folder: Path) -> list[tuple[int, Path]]:
    """Return the parts in a folder by their numbers."""
    found = [(part[1], path) for path in folder.glob("*.mcap") if (part := part_of(path.name)) is not None]
    return sorted(found)


def existing_parts(folder: Path) -> Existing:
    """Return what a recording in ``folder`` holds; finished parts by their index, others as far as
    they can be read.

    Raises:
        OSError: the folder cannot be read.
    """
    parts: list[PartCount] = []
    topics: dict[str, tuple[TopicCount, Definition]] = {}
    files = numbered(folder)
    with contextlib.suppress(OSError):
        if files and is_stub(files[-1][1]):
            files.pop()[1].unlink()
        if files:  # a recorder that was killed left what a power loss would take
            with files[-1][1].open("rb") as stream:
                os.fsync(stream.fileno())
    finished = False
    for number, path in files:
        count, finished = PartCount(path.name, number), False
        parts.append(count)
        try:
            count.size = path.stat().st_size
            file = McapFile(path)
            finished = file.closed
            if file.counts is not None and file.times is not None:
                count.start, count.end = file.times
                count.messages = {
                    topic.name: file.counts.get(channel, 0) for channel, topic in file.topics.items()
                }
            else:
                for record in file.records(lambda _: True, lambda _: None):
                    count.take(file.topics[record.channel].name, record.log_time)
        except (InputError, OSError):
            continue  # not one byte of it can be used: it takes room, and goes by the quota
        for topic in file.topics.values():
            topics.setdefault(
                topic.name,
                (
                    TopicCount(topic.name, topic.type, topic.digest, qos_of(topic.qos)),
                    Definition(topic.type, topic.schema, topic.digest, topic.schema_encoding),
                ),
            )
    return Existing(parts, list(topics.values()), files, finished)
