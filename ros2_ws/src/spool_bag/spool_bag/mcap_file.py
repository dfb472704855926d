"""An MCAP file read as far as it is whole: by its index, or walked record by record where it is damaged."""

from __future__ import annotations

import shutil
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.opcode import Opcode
from spool_core.errors import InputError
from spool_core.uncertainty import named

from spool_bag import mcap_record
from spool_bag.mcap_record import FRAME, MAGIC, MESSAGE, ChunkHead, Definitions, Frame, Topic

#: Messages of a batch at most: more would hold more memory than their chunk.
LARGEST_BATCH = 4096
#: Frame of a record and, where it is a message, its channel.
_RECORD = struct.Struct("<BQH")

# B that are searched in one piece.
_PIECE = 1 << 20
_LOOK = FRAME.size + mcap_record.HEAD_SIZE
_HOLDS_DATA = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)

#: B of one chunk, packed or not. Writers close theirs at 1 MB (rosbag2: 768 kB, Foxglove: 4 MB) or after
#: one message.
LARGEST_CHUNK = 1 << 27
#: Unpacked over packed bytes of a file as a whole, beyond ``FREE_EXPANSION``; blocks of zeros give 40.
LARGEST_RATIO = 1000
FREE_EXPANSION = 1 << 28


class _Decompressor(threading.local):
    """Decompressor of a thread: to make one costs as much as to unpack a small chunk."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_THREAD = _Decompressor()


class McapMessage(NamedTuple):
    """Message as stored; times in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass(frozen=True, slots=True)
class MessageBatch:
    """Batch of messages in the order of writing: their records, and where in those each one lies.

    ``places``: of each message its channel, and where its bytes begin and end in ``records``.
    """

    records: bytes
    places: list[tuple[int, int, int]] = field(default_factory=list)

    def log_time(self, start: int) -> int:
        """Return when the message whose bytes begin at ``start`` was received, ns."""
        time: int = MESSAGE.unpack_from(self.records, start - MESSAGE.size)[2]
        return time

    def messages(self) -> Iterator[McapMessage]:
        """Yield the messages one by one."""
        for _, start, end in self.places:
            channel, sequence, log_time, publish_time = MESSAGE.unpack_from(
                self.records, start - MESSAGE.size
            )
            yield McapMessage(channel, sequence, log_time, publish_time, self.records[start:end])


@dataclass(slots=True)
class McapFile:
    """MCAP file, finished or not.

    Attributes:
        closed: the file ends as a finished one does.
        counts: messages by channel number from the summary, ``None`` where there is none.
        times: first and last time of reception (ns) by the summary.
        density: messages per B of the chunks that were read last, for an estimate of what others held.
    """

    path: Path
    closed: bool = False
    counts: dict[int, int] | None = None
    times: tuple[int, int] | None = None
    density: float = 0.0
    _definitions: Definitions = field(default_factory=Definitions)
    _size: int = 0
    _start: int = 0

    def __post_init__(self) -> None:
        try:
            with self.path.open("rb") as stream:
                start = stream.read(len(MAGIC))
                self._size = stream.seek(0, 2)
                if start == MAGIC:
                    self._start = len(MAGIC)
                elif not self._size or not any(
                    True for _ in Walk(stream, self._size, 0, lambda _: None, quiet_tail=True)
                ):
                    what = "is not an MCAP file" if self._size else "is empty"
                    raise InputError(f"{self.path} {what}: name a rosbag2 directory or an .mcap file")
                stream.seek(max(self._size - len(MAGIC), 0))
                self.closed = self._size > 2 * len(MAGIC) and stream.read() == MAGIC
                if self.closed:  # without a summary, topics and counts cost a pass over the file
                    told = mcap_record.read_summary(stream, self._size, self._definitions)
                    if told is not None:
                        self.counts = dict.fromkeys(self.topics, 0) | told[0]
                        self.times = told[1]
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from error

    @property
    def topics(self) -> dict[int, Topic]:
        """What the channels carry by their number, as far as read; complete where the file has a summary."""
        return self._definitions.topics

    def records(
        self, wanted: Callable[[Topic], bool], damaged: Callable[[Damage], None] | None = None
    ) -> Iterator[McapMessage]:
        """Yield the messages of the ``wanted`` topics in the order of writing.

        Damage inside the file goes to ``damaged`` and is stepped over; without it, it is an error. A file
        that merely ends too early (a killed recorder) gives what it holds.

        Raises:
            InputError: the file is damaged and ``damaged`` is not given.
        """
        for batch in self.batches(wanted, damaged):
            yield from batch.messages()

    def batches(
        self, wanted: Callable[[Topic], bool], damaged: Callable[[Damage], None] | None = None
    ) -> Iterator[MessageBatch]:
        """Yield what ``records`` yields, many messages at once.

        Raises:
            InputError: as ``records``.
        """

        def refuse(damage: Damage) -> None:
            raise InputError(
                f"{self.path}: damaged at byte {damage.offset} ({damage.reason}): "
                "make a readable bag of it with `./spool recover`"
            )

        quiet_tail = damaged is None and not self.closed
        accepted: dict[int, bool] = {}
        with self.path.open("rb") as stream:
            walk = Walk(stream, self._size, self._start, damaged or refuse, quiet_tail=quiet_tail)
            for run in walk:
                try:
                    yield from self._batches(run, walk, wanted, accepted)
                except InputError:
                    raise
                except mcap_record.BAD_BYTES as error:
                    size = FRAME.size + run.frame.length
                    walk.damaged(Damage(run.frame.offset, size, str(error) or type(error).__name__))
            self.density = walk.messages / walk.size if walk.size else 0.0

    def _batches(
        self, run: RecordRun, walk: Walk, wanted: Callable[[Topic], bool], accepted: dict[int, bool]
    ) -> Iterator[MessageBatch]:
        data = run.records
        batch = MessageBatch(data)
        at, end, found, nowhere = 0, len(data), 0, 0
        unpack, message, head = _RECORD.unpack_from, int(Opcode.MESSAGE), MESSAGE.size
        try:
            while at < end:
                # Most records are messages; behind the frame stands their channel.
                opcode, length, channel = (
                    unpack(data, at) if at + _RECORD.size <= end else (*FRAME.unpack_from(data, at), -1)
                )
                at += 9
                if at + length > end:
                    raise ValueError("a record in a chunk claims to be longer than the chunk")
                if opcode == message:
                    found += 1
                    if length < head:
                        MESSAGE.unpack_from(data, at)
                    take = accepted.get(channel)
                    if take is None:
                        topic = self.topics.get(channel)
                        if topic is not None:
                            take = accepted[channel] = wanted(topic)
                        else:
                            nowhere += 1
                    if take:
                        batch.places.append((channel, at + head, at + length))
                        if len(batch.places) == LARGEST_BATCH:
                            yield batch
                            batch = MessageBatch(data)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._definitions.take(opcode, data[at : at + length])
                at += length
        except Exception:
            yield batch  # what stands ahead of the damage
            raise
        yield batch
        walk.messages += found
        if nowhere:
            reason = "messages of a channel without description"
            walk.damaged(Damage(run.frame.offset, FRAME.size + run.frame.length, reason, nowhere))


def decompressed(path: Path, folder: Path) -> Path:
    """Return the file at ``path``, which rosbag2 or zstd compressed as a whole, decompressed into ``folder``.

    Raises:
        InputError: it is damaged, or the disk is full.
    """
    plain = folder / path.stem
    try:
        with path.open("rb") as packed, plain.open("wb") as stream:
            reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            shutil.copyfileobj(reader, stream, 1 << 20)
    except zstandard.ZstdError as error:
        raise InputError(f"{path}: it cannot be decompressed ({error}): copy it again") from error
    except OSError as error:
        raise InputError(f"{path}: it cannot be decompressed into {folder}: {error.strerror}") from error
    return plain


@dataclass(frozen=True, slots=True)
class Damage:
    """Unusable bytes of a file: where, how many, why, and messages lost (``None``: unknown)."""

    offset: int = field(metadata=named("offset_bytes"))
    size: int = field(metadata=named("size_bytes"))
    reason: str
    lost: int | None = field(default=None, metadata=named("lost_messages"))


class RecordRun(NamedTuple):
    """Run of records as they were written: those of one chunk, or one that stands outside of chunks."""

    frame: Frame
    records: bytes


class Walk:
    """Sequential scan of one file: its runs of records.

    A record that cannot be one is damaged; the walk goes on with the next chunk or index of one, wherever it
    begins. What was lost in between is counted from the index that follows each chunk.

    Attributes:
        messages, size: messages and B of the chunks that were read, for an estimate of what others held.
    """

    def __init__(
        self, stream: BinaryIO, size: int, start: int, report: Callable[[Damage], None], *, quiet_tail: bool
    ) -> None:
        self.messages = 0
        self.size = 0
        self._stream = stream
        self._end = size
        self._start = start
        self._tell = report
        self._quiet_tail = quiet_tail
        self._unpacked = 0
        self._chunked = False
        self._pending: Damage | None = None
        self._joined = False
        self._last: RecordRun | None = None
        self._listed: dict[int, tuple[int, range]] = {}

    def __iter__(self) -> Iterator[RecordRun]:
        offset = self._start
        while offset < self._end:
            frame, content = self._at(offset, tell=True)
            if frame is None:
                offset = self._step_over(offset, "a record is cut off or its head damaged")
                continue
            if frame.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                if self._following(frame.end, chunked=True) is None:
                    break
                offset = self._step_over(offset, "a record marks the end of the data, but data follow")
                continue
            if frame.opcode == Opcode.MESSAGE and self._chunked:
                offset = self._step_over(offset, "a message lies outside of the chunks")
                continue
            if frame.opcode == Opcode.CHUNK:
                run = self._chunk(frame)
                if run is not None:
                    yield run
            elif frame.opcode == Opcode.MESSAGE_INDEX:
                self._index(content, frame.length)
            elif frame.opcode in _HOLDS_DATA:
                yield RecordRun(frame, self._read(frame, whole=True))
            offset = frame.end
        self._settle()

    def damaged(self, damage: Damage) -> None:
        """Report ``damage`` once the records behind it have told how much was lost.

        What joins a damaged chunk whose index was not seen is one place with it: the next index may be of
        either chunk, so that only the size tells.
        """
        last = self._pending
        if last is not None and last.lost is None and last.offset + last.size == damage.offset:
            self._pending = Damage(last.offset, last.size + damage.size, last.reason)
            self._joined = True
            return
        self._settle()
        self._pending = damage

    def _at(self, offset: int, *, tell: bool = False) -> tuple[Frame | None, bytes]:
        """Return the record at ``offset`` and how its content begins; no record where it cannot be one.

        ``tell`` reports a wrong kind.
        """
        self._stream.seek(offset)
        head = self._stream.read(_LOOK)
        if len(head) < FRAME.size:
            return None, b""
        opcode, length = FRAME.unpack_from(head)
        content = head[FRAME.size : FRAME.size + min(length, mcap_record.HEAD_SIZE)]
        kind = mcap_record.kind_of(opcode, content, length)
        if kind is None or offset + FRAME.size + length > self._end:
            return None, content
        if tell and kind != opcode:
            self.damaged(Damage(offset, 1, "the kind of a chunk is wrong, its content was read", 0))
        return Frame(kind, offset, length), content

    def _read(self, frame: Frame, *, whole: bool = False) -> bytes:
        self._stream.seek(frame.offset + (0 if whole else FRAME.size))
        if frame.length > LARGEST_CHUNK:
            raise ChunkError(f"a record of {frame.length} bytes, more than the {LARGEST_CHUNK} that are read")
        return self._stream.read(frame.length + (FRAME.size if whole else 0))

    def _chunk(self, frame: Frame) -> RecordRun | None:
        if self._pending is None or self._pending.offset != frame.offset:
            self._settle()
        self._chunked, self._last, self._listed = True, None, {}
        try:
            content = self._read(frame)
            head = mcap_record.chunk_head(content, frame.length)
            assert head is not None  # kind_of saw it
            if head.uncompressed_size <= LARGEST_CHUNK:  # a larger one, or a damaged size, is not unpacked
                self._unpacked += head.uncompressed_size
            if self._unpacked > FREE_EXPANSION + LARGEST_RATIO * self._end:
                raise ChunkError(f"the file unpacks to more than {LARGEST_RATIO} times its size")
            self._last = RecordRun(frame, unpack(head, content))
        except (ChunkError, MemoryError) as error:
            reason = str(error) or "a chunk needs more memory than is available"
            self.damaged(Damage(frame.offset, FRAME.size + frame.length, reason))
            return None
        self.size += FRAME.size + frame.length
        return self._last

    def _index(self, content: bytes, length: int) -> None:
        """Count what the index behind a damaged place lists; that of a chunk that was read loses nothing."""
        entries = mcap_record.index_entries(content, length)
        if self._pending is None or self._joined or not entries:
            return
        if self._last is not None:
            if not self._listed:
                self._listed = _listed(self._last.records)
            channel, _, time = struct.unpack_from("<HIQ", content)  # of its first message
            count, times = self._listed.get(channel, (0, range(0)))
            if count == entries and time in times:
                self._listed[channel] = (0, times)  # a second index of the channel is of another chunk
                return
        self._pending = replace(self._pending, lost=(self._pending.lost or 0) + entries)

    def _step_over(self, offset: int, reason: str) -> int:
        """Report what lies between ``offset`` and the next record that can be one; return where that is."""
        following = self._following(offset + 1, chunked=True)
        if following is None and not self._chunked:
            following = self._following(offset + 1, chunked=False)
        beyond = self._end if following is None else following
        if following is None and self._quiet_tail:
            return beyond
        lost = None
        if self._last is not None:
            listed = _listed(self._last.records).values()
            head = FRAME.size + mcap_record.MESSAGE_INDEX.size
            indexes = sum(head + mcap_record.INDEX_ENTRY * count for count, _ in listed)
            if beyond <= self._last.frame.end + indexes:  # nothing but the indexes of the last chunk
                lost = 0
        self.damaged(Damage(offset, beyond - offset, reason, lost))
        return beyond

    def _following(self, start: int, *, chunked: bool) -> int | None:
        """Return where the next record from ``start`` on begins that can be one, of a ``chunked`` file."""
        offset = start
        while offset < self._end:
            self._stream.seek(offset)
            for place in mcap_record.candidates(self._stream.read(_PIECE + _LOOK), chunked=chunked):
                if place < _PIECE and self._sound(offset + place, chunked=chunked):
                    return offset + place
            offset += _PIECE
        return None

    def _sound(self, offset: int, *, chunked: bool) -> bool:
        frame, _ = self._at(offset)
        if frame is None:
            return False
        if chunked:
            return frame.opcode == Opcode.CHUNK or (frame.opcode == Opcode.MESSAGE_INDEX and frame.length > 6)
        return frame.opcode in _HOLDS_DATA and (frame.end == self._end or self._at(frame.end)[0] is not None)

    def _settle(self) -> None:
        if self._pending is not None:
            damage, self._pending, self._joined = self._pending, None, False
            self._tell(damage)


class ChunkError(ValueError):
    """Chunk that is not what its head says."""


def unpack(head: ChunkHead, content: bytes) -> bytes:
    """Return the records in the chunk ``content`` (with its head).

    Raises:
        ChunkError: larger than ``LARGEST_CHUNK`` or than it claims, not unpackable, or a wrong checksum.
    """
    size = head.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ChunkError(f"a chunk claims {size} bytes, more than the {LARGEST_CHUNK} that are unpacked")
    packed = memoryview(content)[head.start :]
    try:
        if head.compression == "zstd":
            claimed = zstandard.get_frame_parameters(packed).content_size
            if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                raise ChunkError(f"a chunk unpacks to {claimed} bytes where it claims {size}")
            data = _THREAD.zstd.decompress(packed, max_output_size=size) if size else b""
        elif head.compression == "lz4":
            data = bytes(LZ4FrameDecompressor().decompress(bytes(packed), max_length=size + 1))
        else:
            data = bytes(packed)
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise ChunkError(f"a chunk cannot be unpacked ({error})") from error
    if len(data) != size:
        raise ChunkError(f"a chunk holds {len(data)} bytes where it claims {size}")
    if head.uncompressed_crc and zlib.crc32(data) != head.uncompressed_crc:
        raise ChunkError("the checksum of a chunk is wrong")
    return data


def _listed(records: bytes) -> dict[int, tuple[int, range]]:
    """Return the number of messages and the span of their log times (ns) by channel."""
    times: dict[int, list[int]] = {}
    at = 0
    while at + FRAME.size <= len(records):
        opcode, length = FRAME.unpack_from(records, at)
        if opcode == Opcode.MESSAGE and at + FRAME.size + MESSAGE.size <= len(records):
            channel, _, log_time, _ = MESSAGE.unpack_from(records, at + FRAME.size)
            times.setdefault(channel, []).append(log_time)
        at += FRAME.size + length
    return {channel: (len(found), range(min(found), max(found) + 1)) for channel, found in times.items()}
