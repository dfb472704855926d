"""Read the messages of one MCAP file in the order of writing, finished or not, with bounded memory."""

from __future__ import annotations

import struct
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

from spool_sim.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
FRAME = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")


class Record(NamedTuple):
    """A message as stored; times in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


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
                if self.closed:
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
        size = self.path.stat().st_size
        accepted: dict[int, bool] = {}
        with self.path.open("rb") as stream:
            offset = stream.seek(len(MAGIC))
            while True:
                head = stream.read(FRAME.size)
                if len(head) < FRAME.size:
                    return
                opcode, length = FRAME.unpack(head)
                if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    return
                if opcode == 0 or offset + FRAME.size + length > size:
                    # Past a kill there is a part of a record, past a power loss there may be zeros.
                    if self.closed or damaged is not None:
                        report(Damage(offset, size - offset, "a record reaches beyond the end of the file"))
                    return
                if opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
                    body = stream.read(length)
                    try:
                        yield from self._record(opcode, body, wanted, accepted)
                    except (InputError, GeneratorExit):
                        raise
                    except Exception as error:  # zstd, struct, CRC, MemoryError: whatever a bad byte brings
                        reason = str(error) or type(error).__name__
                        report(Damage(offset, FRAME.size + length, reason))
                else:
                    stream.seek(length, 1)
                offset += FRAME.size + length

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
                    take = accepted[channel] = wanted(self.topics[channel])
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
        self.topics[channel.id] = Topic(channel.topic, name, text, encoding, channel.message_encoding)

    def _read_summary(self, stream: BinaryIO) -> None:
        """Take topics and counts from the summary; a damaged one only costs a pass over the file."""
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
        self.counts = {number: 0 for number in self.topics} | dict(summary.statistics.channel_message_counts)

    def _refuse(self, damage: Damage) -> None:
        raise InputError(
            f"{self.path}: damaged at byte {damage.offset} ({damage.reason}): "
            "make a readable bag of it with `./spool recover`"
        )
