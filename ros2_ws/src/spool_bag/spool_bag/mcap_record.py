"""Records of an MCAP file, read and written byte by byte, and the definitions among them."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema, Statistics

#: What a bad byte brings; anything else is a fault of the suite.
BAD_BYTES = (ValueError, struct.error, McapError, MemoryError, OverflowError)

MAGIC = b"\x89MCAP0\r\n"
#: Layout: the MCAP format specification, section "Records" (https://mcap.dev/spec): opcode, length, content.
FRAME = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
MESSAGE_RECORD = struct.Struct("<BQHIQQ")
FOOTER = struct.Struct("<BQQQI")
CHUNK_HEAD = struct.Struct("<QQQII")
MESSAGE_INDEX = struct.Struct("<HI")
#: B of a summary that are read: 90 B a chunk, so more than a year of chunks of 0.7 s would need.
LARGEST_SUMMARY = 1 << 27
DATA_END_SIZE, FOOTER_SIZE = 4, 20
#: B of content that tell every kind of record: a chunk's head with the longest name of a compression.
HEAD_SIZE = 64
COMPRESSIONS = (b"", b"lz4", b"zstd")

#: B of an entry of a message index: a time and an offset, 8 B each.
INDEX_ENTRY = 16
# Where the fields begin that stand behind their length, and how many there are.
_FIELDS = {Opcode.HEADER: (0, 2), Opcode.SCHEMA: (2, 3), Opcode.CHANNEL: (4, 3), Opcode.METADATA: (0, 2)}
_FIRST_PRIVATE = 0x80
# Searched for by their rarest bytes; lengths below 2^40 B. A packed chunk is known by its compression's name.
_PACKED = (b"\x04\0\0\0zstd", b"\x03\0\0\0lz4")
_PLAIN_CHUNK = re.compile(rb"\x06(?=[\s\S]{5}\x00{3}[\s\S]{28}\x00{4})")
_INDEX = re.compile(rb"\x07(?=[\s\S]{5}\x00{3}[\s\S]{5}\x00)")
_LOOSE = re.compile(rb"[\x03-\x05](?=[\s\S]{5}\x00{3})")

#: B of one definition and of all of a file; the longest of ROS 2's own, with its dependencies, have 50 kB.
LARGEST_DEFINITION = 1 << 18
MOST_DEFINITIONS = 1 << 24


class Frame(NamedTuple):
    """Frame of a record: its kind, where it starts and the length of its content in bytes."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """Where the next record starts."""
        return self.offset + FRAME.size + self.length


class ChunkHead(NamedTuple):
    """Head of a chunk: times in ns, sizes in B, ``start`` of the data within the content."""

    message_start_time: int
    message_end_time: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    start: int


def message_head(message: Message) -> bytes:
    """Return what stands ahead of the data: packed at once, for a fraction of what mcap takes."""
    fields = message.channel_id, message.sequence, message.log_time, message.publish_time
    return MESSAGE_RECORD.pack(Opcode.MESSAGE, MESSAGE.size + len(message.data), *fields)


def chunk_head(content: bytes, length: int) -> ChunkHead | None:
    """Return the head of the chunk whose ``content`` of ``length`` B begins so, ``None`` where it is none.

    The length of a chunk's data stands in it a second time, which hardly any other bytes fulfil.
    """
    if len(content) < CHUNK_HEAD.size:
        return None
    start_time, end_time, size, checksum, name_size = CHUNK_HEAD.unpack_from(content)
    name = content[CHUNK_HEAD.size : CHUNK_HEAD.size + name_size] if name_size <= 4 else None
    at = CHUNK_HEAD.size + name_size
    if name not in COMPRESSIONS or len(content) < at + 8:
        return None
    (data,) = struct.unpack_from("<Q", content, at)
    if at + 8 + data != length:
        return None
    return ChunkHead(start_time, end_time, size, checksum, name.decode(), at + 8)


def index_entries(content: bytes, length: int) -> int | None:
    """Return how many messages the index lists whose ``content`` of ``length`` B begins so."""
    if len(content) < MESSAGE_INDEX.size:
        return None
    _, size = MESSAGE_INDEX.unpack_from(content)
    if MESSAGE_INDEX.size + size != length or size % INDEX_ENTRY:
        return None
    return int(size) // INDEX_ENTRY


def kind_of(opcode: int, content: bytes, length: int) -> int | None:
    """Return the kind of the record whose ``content`` of ``length`` B begins so, ``None``: it is damaged.

    A chunk is known by its head even where ``opcode`` says something else.
    """
    if chunk_head(content, length) is not None:
        return int(Opcode.CHUNK)
    if opcode in (Opcode.CHUNK, 0):
        return None
    if opcode == Opcode.MESSAGE_INDEX:
        return opcode if index_entries(content, length) is not None else None
    if opcode == Opcode.DATA_END:
        return opcode if length == DATA_END_SIZE else None
    if opcode == Opcode.FOOTER:
        return opcode if length == FOOTER_SIZE else None
    if opcode == Opcode.MESSAGE:
        return opcode if length >= MESSAGE.size else None
    if opcode in _FIELDS:
        return opcode if _fields_fit(*_FIELDS[Opcode(opcode)], content, length) else None
    return opcode if opcode < Opcode.DATA_END or opcode >= _FIRST_PRIVATE else None


def candidates(piece: bytes, *, chunked: bool) -> list[int]:
    """Return where in ``piece`` a record could begin: chunks, their indexes, or in their absence others."""
    if not chunked:
        return [found.start() for found in _LOOSE.finditer(piece)]
    places = [found.start() for pattern in (_PLAIN_CHUNK, _INDEX) for found in pattern.finditer(piece)]
    for name in _PACKED:
        before = FRAME.size + CHUNK_HEAD.size - 4
        at = piece.find(name, before)
        while at >= 0:
            places.append(at - before)
            at = piece.find(name, at + 1)
    return sorted(places)


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
class Definitions:
    """Topics by channel number; writers repeat them, which costs a comparison only."""

    topics: dict[int, Topic] = field(default_factory=dict)
    _schemas: dict[int, _Schema] = field(default_factory=dict)
    _known: dict[tuple[int, bytes], bytes] = field(default_factory=dict)
    _size: int = 0

    def take(self, opcode: int, content: bytes) -> None:
        """Take the ``content`` of a schema or channel.

        Raises:
            ValueError: not one, or more than the bounds.
            mcap.exceptions.McapError: it ends too early.
        """
        key = (opcode, content[:2])
        if self._known.get(key) == content:
            return
        if len(content) > LARGEST_DEFINITION or self._size + len(content) > MOST_DEFINITIONS:
            raise ValueError(
                f"a definition of more than {LARGEST_DEFINITION} bytes, or {MOST_DEFINITIONS} bytes of them"
            )
        self._size += len(content)
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = _Schema(
                schema.name, schema.data.decode("utf-8", "replace"), schema.encoding
            )
        else:
            channel = Channel.read(stream)
            schema = self._schemas.get(channel.schema_id) or _Schema("", "", "")
            about = channel.metadata
            qos, digest = about.get("offered_qos_profiles", ""), about.get("topic_type_hash", "")
            self.topics[channel.id] = Topic(
                channel.topic, *schema, encoding=channel.message_encoding, qos=qos, digest=digest
            )
        self._known[key] = content


def read_summary(
    stream: BinaryIO, size: int, definitions: Definitions
) -> tuple[dict[int, int], tuple[int, int]] | None:
    """Return messages by channel and first and last time (ns) that the summary of a file of ``size`` B tells.

    Add what it defines. ``None`` where there is none, it is damaged, or it has no statistics.
    """
    end = size - len(MAGIC) - FOOTER.size
    stream.seek(max(end, 0))
    try:
        opcode, _, start, _, checksum = FOOTER.unpack(stream.read(FOOTER.size))
    except struct.error:
        return None
    if opcode != Opcode.FOOTER or not len(MAGIC) < start <= end or end - start > LARGEST_SUMMARY:
        return None
    stream.seek(start)
    content = stream.read(end + FOOTER.size - 4 - start)
    if checksum and zlib.crc32(content) != checksum:
        return None
    try:
        return _counts(content[: end - start], definitions)
    except BAD_BYTES:
        return None


def _counts(summary: bytes, definitions: Definitions) -> tuple[dict[int, int], tuple[int, int]] | None:
    """Return what :func:`read_summary` does of a summary that is sound.

    Raises:
        ValueError, struct.error, mcap.exceptions.McapError: it is damaged.
    """
    counts: tuple[dict[int, int], tuple[int, int]] | None = None
    at = 0
    while at < len(summary):
        opcode, length = FRAME.unpack_from(summary, at)
        at += FRAME.size
        if at + length > len(summary):
            raise ValueError("a record of the summary is cut off")
        content = summary[at : at + length]
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.take(opcode, content)
        elif opcode == Opcode.STATISTICS:
            told = Statistics.read(ReadDataStream(BytesIO(content)))
            counts = dict(told.channel_message_counts), (told.message_start_time, told.message_end_time)
        at += length
    return counts


def _fields_fit(at: int, fields: int, content: bytes, length: int) -> bool:
    """Return whether the fields from ``at`` on, each behind its length, end where the content ends.

    Those that lie further on than what is looked at are believed.
    """
    for _ in range(fields):
        if at + 4 > length:
            return False
        if at + 4 > len(content):
            return True
        (size,) = struct.unpack_from("<I", content, at)
        at += 4 + size
    return at == length


class _Schema(NamedTuple):
    name: str
    text: str
    encoding: str
