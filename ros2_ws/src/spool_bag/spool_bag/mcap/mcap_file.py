"""MCAP file: its messages in the order of writing, finished or not, with bounded memory."""

from __future__ import annotations

import shutil
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.opcode import Opcode
from spool_core.errors import InputError

from .mcap_definitions import Definitions, Topic, summary_counts
from .mcap_record import FOOTER, FRAME, LARGEST_SUMMARY, MAGIC, MESSAGE
from .mcap_walk import Damage, RecordRun, Walk

#: Messages of a batch at most: more would hold more memory than their chunk.
LARGEST_BATCH = 4096
#: Frame of a record and, where it is a message, its channel.
_RECORD = struct.Struct("<BQH")


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
        times: first and last time of reception (ns) by the summary, likewise.
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
                elif not self._size or not self._any_chunk(stream):
                    what = "is not an MCAP file" if self._size else "is empty"
                    raise InputError(f"{self.path} {what}: name a rosbag2 directory or an .mcap file")
                stream.seek(max(self._size - len(MAGIC), 0))
                self.closed = self._size > 2 * len(MAGIC) and stream.read() == MAGIC
                if self.closed:
                    self._read_summary(stream)
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
        report = damaged or self._refuse
        quiet_tail = damaged is None and not self.closed
        accepted: dict[int, bool] = {}
        with self.path.open("rb") as stream:
            walk = Walk(stream, self._size, self._start, report, quiet_tail=quiet_tail)
            for run in walk:
                try:
                    yield from self._batches(run, walk, wanted, accepted)
                except InputError:
                    raise
                except Exception as error:  # struct, Unicode, mcap, MemoryError: whatever a bad byte brings
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
                opcode, length, channel = unpack(data, at) if at + _RECORD.size <= end else _frame(data, at)
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
            reason = "messages of a channel that is nowhere described"
            walk.damaged(Damage(run.frame.offset, FRAME.size + run.frame.length, reason, nowhere))

    def _any_chunk(self, stream: BinaryIO) -> bool:
        """Return whether a chunk can be read behind a damaged beginning."""
        return next(iter(Walk(stream, self._size, 0, lambda _: None, quiet_tail=True)), None) is not None

    def _read_summary(self, stream: BinaryIO) -> None:
        """Take topics and counts from a sound summary; without one they cost a pass over the file."""
        summary = _summary(stream, self._size)
        if summary is None:
            return
        try:
            counts = summary_counts(summary, self._definitions)
        except Exception:  # as above
            return
        if counts is not None:
            found, self.times = counts
            self.counts = dict.fromkeys(self.topics, 0) | found

    def _refuse(self, damage: Damage) -> None:
        raise InputError(
            f"{self.path}: damaged at byte {damage.offset} ({damage.reason}): "
            "make a readable bag of it with `./spool recover`"
        )


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


def _frame(data: bytes, at: int) -> tuple[int, int, int]:
    """Return kind and length of a record that ends before a channel could, and none."""
    return (*FRAME.unpack_from(data, at), -1)


def _summary(stream: BinaryIO, size: int) -> bytes | None:
    """Return the summary section if there is one and its checksum, where it has one, is right."""
    at = size - len(MAGIC) - FOOTER.size
    stream.seek(max(at, 0))
    try:
        opcode, _, start, _, checksum = FOOTER.unpack(stream.read(FOOTER.size))
    except struct.error:
        return None
    if opcode != Opcode.FOOTER or not len(MAGIC) < start <= at or at - start > LARGEST_SUMMARY:
        return None
    stream.seek(start)
    content = stream.read(at + FOOTER.size - 4 - start)
    if checksum and zlib.crc32(content) != checksum:
        return None
    return content[: at - start]
