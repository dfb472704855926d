"""Read the messages of one MCAP file in the order of writing, finished or not, with bounded memory."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import get_chunk_data_stream
from spool_stream.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
FRAME = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
FOOTER = struct.Struct("<BQQQI")


class Record(NamedTuple):
    """A message as stored; times in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class Frame(NamedTuple):
    """A record's kind, where it starts and the length of its content in bytes."""

    opcode: int
    offset: int
    length: int


class Damage(NamedTuple):
    """Bytes of a file that cannot be read: where, how many, why."""

    offset: int
    size: int
    reason: str


@dataclass(frozen=True, slots=True)
class Topic:
    """What a channel carries."""

    name: str
    type: str
    schema: str
    schema_encoding: str
    encoding: str
    qos: str
    digest: str


@dataclass(slots=True)
class McapFile:
    """One MCAP file.

    Attributes:
        closed: the file ends as a finished one does.
        topics: by channel number, as far as read; complete from the start where the file has a summary.
        counts: messages by channel number from the summary, ``None`` where there is none.
    """

    path: Path
    closed: bool = False
    topics: dict[int, Topic] = field(default_factory=dict)
    counts: dict[int, int] | None = None
    _chunk_starts: list[int] = field(default_factory=list)
    _schemas: dict[int, Schema] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            with self.path.open("rb") as stream:
                start = stream.read(len(MAGIC))
                if start != MAGIC:
                    what = "is empty" if not start else "is not an MCAP file"
                    raise InputError(f"{self.path} {what}: name a rosbag2 directory or an .mcap file")
                size = stream.seek(0, 2)
                stream.seek(max(size - len(MAGIC), 0))
                self.closed = size > 2 * len(MAGIC) and stream.read() == MAGIC
                if self.closed and _summary_holds(stream, size):
                    self._read_summary(stream)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from error

    def records(
        self, wanted: Callable[[Topic], bool], damaged: Callable[[Damage], None] | None = None
    ) -> Iterator[Record]:
        """Yield the messages of the ``wanted`` topics in the order of writing.

        Damage inside the file goes to ``damaged`` and is stepped over; without it, it is an error. A file
        that merely ends too early (a killed recorder) gives what it holds.

        Raises:
            InputError: the file is damaged and ``damaged`` is not given.
        """
        report = damaged or self._refuse
        accepted: dict[int, bool] = {}
        with self.path.open("rb") as stream:
            for frame in self._frames(stream, report, strict=self.closed or damaged is not None):
                try:
                    body = stream.read(frame.length)
                    yield from self._record(frame.opcode, body, wanted, accepted)
                except InputError:
                    raise
                except Exception as error:  # zstd, struct, CRC, MemoryError: whatever a bad byte brings
                    size = FRAME.size + frame.length
                    report(Damage(frame.offset, size, str(error) or type(error).__name__))

    def _frames(self, stream: BinaryIO, report: Callable[[Damage], None], *, strict: bool) -> Iterator[Frame]:
        """Yield the records that hold messages; the stream stands at the record's content.

        Where the summary names the starts of the chunks, a record that runs into one is damaged and the
        next chunk is gone to.
        """
        size = self.path.stat().st_size
        starts = iter(self._chunk_starts)
        offset, known = len(MAGIC), next(starts, size + 1)
        while offset < size:
            stream.seek(offset)
            head = stream.read(FRAME.size)
            opcode, length = FRAME.unpack(head) if len(head) == FRAME.size else (0, 0)
            follows = offset + FRAME.size + length
            at_known = offset == known
            while known <= offset:
                known = next(starts, size + 1)
            if opcode in (Opcode.DATA_END, Opcode.FOOTER) and known > size:
                return
            lost = at_known and opcode != Opcode.CHUNK
            if opcode == 0 or follows > min(known, size) or lost:
                # Past a kill there is a part of a record, past a power loss there may be zeros.
                beyond = min(known, size)
                if strict:
                    report(Damage(offset, beyond - offset, "a record is cut off or its head is damaged"))
                offset = beyond
                continue
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
                yield Frame(opcode, offset, length)
            offset = follows

    def _record(
        self, opcode: int, body: bytes, wanted: Callable[[Topic], bool], accepted: dict[int, bool]
    ) -> Iterator[Record]:
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            stream, length = get_chunk_data_stream(chunk, validate_crc=True)
            data = stream.read(length)
        else:
            data = FRAME.pack(opcode, len(body)) + body
        yield from self._messages(data, wanted, accepted)

    def _messages(
        self, data: bytes, wanted: Callable[[Topic], bool], accepted: dict[int, bool]
    ) -> Iterator[Record]:
        at, end = 0, len(data)
        unpack_frame, unpack_message, message = FRAME.unpack_from, MESSAGE.unpack_from, int(Opcode.MESSAGE)
        while at < end:
            opcode, length = unpack_frame(data, at)
            at += 9
            if opcode == message:
                channel, sequence, log_time, publish_time = unpack_message(data, at)
                take = accepted.get(channel)
                if take is None:
                    take = accepted[channel] = wanted(self._described(channel))
                if take:
                    yield Record(channel, sequence, log_time, publish_time, data[at + 22 : at + length])
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(data[at : at + length])))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                self._add(Channel.read(ReadDataStream(BytesIO(data[at : at + length]))))
            at += length

    def _add(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        name, text, encoding = (
            (schema.name, schema.data.decode("utf-8", "replace"), schema.encoding) if schema else ("", "", "")
        )
        about = channel.metadata
        qos, digest = about.get("offered_qos_profiles", ""), about.get("topic_type_hash", "")
        self.topics[channel.id] = Topic(
            channel.topic, name, text, encoding, channel.message_encoding, qos, digest
        )

    def _read_summary(self, stream: BinaryIO) -> None:
        """Take topics and counts from the summary; without one they cost a pass over the file."""
        stream.seek(0)
        try:
            summary = make_reader(stream).get_summary()
        except Exception:  # as above: mcap, struct and codecs each raise their own
            return
        if summary is None or summary.statistics is None:
            return
        self._schemas.update(summary.schemas)
        for channel in summary.channels.values():
            self._add(channel)
        self._chunk_starts = sorted(index.chunk_start_offset for index in summary.chunk_indexes)
        self.counts = dict.fromkeys(self.topics, 0) | dict(summary.statistics.channel_message_counts)

    def _described(self, channel: int) -> Topic:
        if channel not in self.topics:
            raise ValueError(f"channel {channel} is nowhere described")
        return self.topics[channel]

    def _refuse(self, damage: Damage) -> None:
        raise InputError(
            f"{self.path}: damaged at byte {damage.offset} ({damage.reason}): "
            "make a readable bag of it with `./spool recover`"
        )


def _summary_holds(stream: BinaryIO, size: int) -> bool:
    """Return whether there is a summary and its checksum, where it has one, is right."""
    at = size - len(MAGIC) - FOOTER.size
    stream.seek(max(at, 0))
    try:
        opcode, _, start, _, checksum = FOOTER.unpack(stream.read(FOOTER.size))
    except struct.error:
        return False
    if opcode != Opcode.FOOTER or not len(MAGIC) < start <= at:
        return False
    stream.seek(start)
    return bool(checksum == 0 or zlib.crc32(stream.read(at + FOOTER.size - 4 - start)) == checksum)
