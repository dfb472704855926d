"""Sequential scan of the records of an MCAP file, resynchronising behind any damage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from .mcap_chunk import FREE_EXPANSION, LARGEST_CHUNK, LARGEST_RATIO, ChunkError, unpack
from .mcap_record import (
    FRAME,
    HEAD_SIZE,
    MESSAGE,
    MESSAGE_INDEX,
    Frame,
    candidates,
    chunk_head,
    index_entries,
    index_time,
    kind_of,
)

# B that are searched in one piece.
_PIECE = 1 << 20
_LOOK = FRAME.size + HEAD_SIZE
_HOLDS_DATA = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)


class Damage(NamedTuple):
    """Damage: unusable bytes of a file: where, how many, why, and messages lost (``None``: unknown)."""

    offset: int
    size: int
    reason: str
    lost: int | None = None


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
            frame, content = self._at(offset)
            if frame is None:
                offset = self._step_over(offset, "a record is cut off or its head damaged")
                continue
            if frame.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                if self._following(frame.end, chunked=True) is None:
                    break
                offset = self._step_over(offset, "the data is said to end here but goes on")
                continue
            if frame.opcode == Opcode.MESSAGE and self._chunked:
                offset = self._step_over(offset, "a message stands outside of the chunks")
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

    def _at(self, offset: int) -> tuple[Frame | None, bytes]:
        """Return the record at ``offset`` and how its content begins; no record where it cannot be one."""
        self._stream.seek(offset)
        head = self._stream.read(_LOOK)
        if len(head) < FRAME.size:
            return None, b""
        opcode, length = FRAME.unpack_from(head)
        content = head[FRAME.size : FRAME.size + min(length, HEAD_SIZE)]
        kind = kind_of(opcode, content, length)
        if kind is None or offset + FRAME.size + length > self._end:
            return None, content
        if kind != opcode:
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
            head = chunk_head(content, frame.length)
            assert head is not None  # kind_of saw it
            if head.uncompressed_size <= LARGEST_CHUNK:  # a larger one, or a damaged size, is not unpacked
                self._unpacked += head.uncompressed_size
            if self._unpacked > FREE_EXPANSION + LARGEST_RATIO * self._end:
                raise ChunkError(f"the file unpacks to more than {LARGEST_RATIO} times its size")
            self._last = RecordRun(frame, unpack(head, content))
        except (ChunkError, MemoryError) as error:
            reason = str(error) or "a chunk needs more memory than there is"
            self.damaged(Damage(frame.offset, FRAME.size + frame.length, reason))
            return None
        self.size += FRAME.size + frame.length
        return self._last

    def _index(self, content: bytes, length: int) -> None:
        """Count what the index behind a damaged place lists; that of a chunk that was read loses nothing."""
        entries, time = index_entries(content, length), index_time(content)
        if self._pending is None or self._joined or not entries or time is None:
            return
        if self._last is not None:
            if not self._listed:
                self._listed = _listed(self._last.records)
            channel, _ = MESSAGE_INDEX.unpack_from(content)
            count, times = self._listed.get(channel, (0, range(0)))
            if count == entries and time in times:
                self._listed[channel] = (0, times)  # a second index of the channel is of another chunk
                return
        self._pending = self._pending._replace(lost=(self._pending.lost or 0) + entries)

    def _step_over(self, offset: int, reason: str) -> int:
        """Report what lies between ``offset`` and the next record that can be one; return where that is."""
        following = self._following(offset + 1, chunked=True)
        if following is None and not self._chunked:
            following = self._following(offset + 1, chunked=False)
        beyond = self._end if following is None else following
        if following is None and self._quiet_tail:
            return beyond
        lost = 0 if self._within_indexes(beyond) else None
        self.damaged(Damage(offset, beyond - offset, reason, lost))
        return beyond

    def _within_indexes(self, end: int) -> bool:
        """Return whether nothing but the indexes of the last chunk can lie before ``end``."""
        if self._last is None:
            return False
        listed = _listed(self._last.records).values()
        indexes = sum(FRAME.size + MESSAGE_INDEX.size + 16 * count for count, _ in listed)
        return end <= self._last.frame.end + indexes

    def _following(self, start: int, *, chunked: bool) -> int | None:
        """Return where the next record from ``start`` on begins that can be one, of a ``chunked`` file."""
        offset = start
        while offset < self._end:
            self._stream.seek(offset)
            piece = self._stream.read(_PIECE + _LOOK)
            for place in candidates(piece, chunked=chunked):
                if place < _PIECE and self._sound(offset + place, chunked=chunked):
                    return offset + place
            offset += _PIECE
        return None

    def _sound(self, offset: int, *, chunked: bool) -> bool:
        frame = self._candidate(offset)
        if frame is None:
            return False
        if chunked:
            return frame.opcode == Opcode.CHUNK or (frame.opcode == Opcode.MESSAGE_INDEX and frame.length > 6)
        return frame.opcode in _HOLDS_DATA and (
            frame.end == self._end or self._candidate(frame.end) is not None
        )

    def _candidate(self, offset: int) -> Frame | None:
        self._stream.seek(offset)
        head = self._stream.read(_LOOK)
        if len(head) < FRAME.size:
            return None
        opcode, length = FRAME.unpack_from(head)
        kind = kind_of(opcode, head[FRAME.size : FRAME.size + min(length, HEAD_SIZE)], length)
        return (
            None if kind is None or offset + FRAME.size + length > self._end else Frame(kind, offset, length)
        )

    def _settle(self) -> None:
        if self._pending is not None:
            damage, self._pending, self._joined = self._pending, None, False
            self._tell(damage)


def _listed(records: bytes) -> dict[int, tuple[int, range]]:
    """Return the number of messages and the span of their log times (ns) by channel."""
    times: dict[int, list[int]] = {}
    for at in _messages(records):
        channel, _, log_time, _ = MESSAGE.unpack_from(records, at + FRAME.size)
        times.setdefault(channel, []).append(log_time)
    return {channel: (len(found), range(min(found), max(found) + 1)) for channel, found in times.items()}


def _messages(records: bytes) -> Iterator[int]:
    at = 0
    while at + FRAME.size <= len(records):
        opcode, length = FRAME.unpack_from(records, at)
        if opcode == Opcode.MESSAGE and at + FRAME.size + MESSAGE.size <= len(records):
            yield at
        at += FRAME.size + length
