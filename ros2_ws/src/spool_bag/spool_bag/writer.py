"""Writer of a bag: a folder that is claimed, parts, metadata, and what survives a power cut."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rosbags.interfaces import Qos
from spool_core.errors import InputError
from spool_core.system import leftovers, lock_file, open_folder, partial_name, remove, sync_folder

from spool_bag import metadata
from spool_bag.part_records import BEGIN, LOSSES, PartBegin, PartList
from spool_bag.parts import McapPart, existing_parts
from spool_bag.recorder import Recorded

#: s between two ``metadata.yaml`` of a recording under way, 250 messages of a valve.
METADATA_INTERVAL = 5.0
#: B by which a part grows between two looks at its size, besides its index: chunks that pack badly. And the
#: share of small parts and quotas that this takes at most.
MARGIN, MARGIN_SHARE = 1 << 20, 1 / 8
#: Times that writing ``metadata.yaml`` took after which it is written again: it never takes more than 1 %.
METADATA_SHARE = 100.0


class RecordingError(OSError):
    """The bag could not be written on; what was flushed before is kept and readable."""


@dataclass(frozen=True, slots=True)
class PartLimits:
    """Limits of the parts of a recording: ``duration`` (s) and ``size`` (B) of one, ``total`` (B) of all.

    ``total`` 0: no quota. A part is at most a quarter of the quota, so that what is kept reaches back.
    """

    duration: float = math.inf
    size: float = math.inf
    total: int = 0

    @property
    def largest(self) -> float:
        """B of a part at most."""
        return min(self.size, 0.25 * self.total) if self.total else self.size

    @property
    def margin(self) -> float:
        """B that are left free of a part and of the quota."""
        return min(MARGIN, MARGIN_SHARE * self.largest)


@dataclass(frozen=True, slots=True)
class Before:
    """What a recorder remembers for the next part that it begins.

    ``lost``: messages since then, and why. ``repeat``: last messages of latched topics. ``oldest``: number of
    the first part that the recorder did not remove. ``cut_off``: the recorder before did not end.
    """

    lost: tuple[int, str] = (0, "")
    repeat: Sequence[Recorded] = ()
    oldest: int = 0
    cut_off: bool = False


class BagWriter:
    """Writer of a rosbag2 directory: ``metadata.yaml``, ``NAME_0.mcap``, and with ``limits`` further parts.

    Chunks are closed and synced to the disk once ``flush_interval`` seconds of wall time have passed; call
    :meth:`flush_if_due` as well where messages may stay away.

    ``staged`` writes under another name in the same folder, which :meth:`close` changes to ``path`` once the
    bag is whole; where an exception (Ctrl-C) leaves the ``with`` block, nothing stays. A recording is not
    staged: what it has on the disk is to be found under its name whatever happens. ``custom`` goes into the
    metadata as ``custom_data``.

    With ``limits`` the bag is a recording in parts, each of which stands by itself: definitions and the last
    message of each latched topic are repeated at its start. A list of hashes (:mod:`spool_bag.part_records`),
    signed by ``sign``, shows later edits. ``resume`` goes on in an existing recording, with what its recorder
    remembers of it ``before``.

    Attributes:
        removed: parts that went by the quota. written: messages that it took, and synced: how
            many of these are on the disk. certain: after a failure, none of the others is. withdrawn: what a
            part stated that a failure left nothing of.

    Raises:
        InputError: ``path`` exists already or cannot be made.
        RecordingError: from any method, on the first failure to write (disk full); the file is then cut back
            to its last complete chunk and closed.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        flush_interval: float = 1.0,
        staged: bool = False,
        custom: Mapping[str, str] | None = None,
        limits: PartLimits | None = None,
        resume: bool = False,
        sign: Callable[[str], str] | None = None,
        before: Before | None = None,
    ) -> None:
        self.path = Path(path)
        self.limits = limits
        self.removed = self.written = self.synced = 0
        self.withdrawn: PartBegin | None = None
        self.certain = True
        self._custom = dict(custom or {})
        self._interval = flush_interval
        self._channels: list[_Channel] = []
        self._numbers: dict[str, int] = {}
        self._parts: list[metadata.PartCount] = []
        self._described, self._metadata_interval = 0.0, METADATA_INTERVAL
        self._allowed = 0.0
        self._open = False
        self._claim: FolderClaim | None = None
        self._folder = partial_name(self.path) if staged else self.path
        before = before or Before()
        try:
            files, finished = self._claimed(resume=resume)
            self._list = PartList(self._folder, sign, files, before.oldest) if limits is not None else None
        except OSError as error:
            self.release()
            raise InputError(f"{self.path}: cannot be made: {error.strerror}") from error
        number = self._list.next if self._list is not None else len(files)
        try:
            self._begin_first(number, before, cut_off=before.cut_off and finished)
        except OSError as error:
            self.release()
            raise RecordingError(f"{self._file_of(number)}: {error.strerror}") from error
        self._open = True
        self._flushed = time.monotonic()

    def _claimed(self, *, resume: bool) -> tuple[list[tuple[int, Path]], bool]:
        """Make the folder, or take over the parts in it; return their files, and whether they had ended."""
        there = self.path.exists() or self.path.is_symlink()
        if there and not (resume and self.path.is_dir()):
            raise InputError(f"{self.path} exists already: name a bag that does not, or remove it")
        for left in leftovers(self.path):
            remove(left)
        self._folder.mkdir(parents=True, exist_ok=there)
        self._claim = FolderClaim(self._folder)
        if not there:
            return [], False
        self._parts, topics, files, finished = existing_parts(self._folder)
        for topic, earlier in topics:
            described = earlier
            with contextlib.suppress(InputError):  # messages from now on follow the installed definition
                described = metadata.definition(earlier.name)
            self._append(_Channel(topic, described, latched=False))
        return files, finished

    def _begin_first(self, number: int, before: Before, *, cut_off: bool) -> None:
        """Begin the first part that this writer writes, with the last latched messages of those before."""
        # The part before may hold nothing but repeated messages, 1 ns ahead of the next message.
        at = 2 + max((self._parts[-1].end if self._parts else 0, *(one.received for one in before.repeat)))
        self._part = self._begin(PartBegin(number, at if before.repeat else 0, *before.lost, cut_off))
        try:
            for message in before.repeat:
                if message.topic not in self._numbers:
                    described, qos = metadata.definition(message.kind), tuple(message.qos)
                    counted = metadata.TopicCount(message.topic, message.kind, described.digest, qos)
                    self._append(_Channel(counted, described, latched=True))
                one = self._channels[self._numbers[message.topic]]
                one.latched, one.last = True, (message.data, message.published, 0)
                self._part.write(self._register(one), message.topic, at, *one.last)
            self._write_metadata()
            sync_folder(self._folder.absolute().parent)
        except OSError:
            self._part.discard()  # else each try on a disk that is full leaves a file behind
            raise

    @property
    def file(self) -> Path:
        """The file that is written."""
        return self._part.path

    def add_topic(
        self,
        topic: str,
        type_name: str,
        qos: Sequence[Qos] = (),
        described: metadata.Definition | None = None,
        *,
        latched: bool = False,
    ) -> int:
        """Return the channel number of ``topic``; asking again for the same topic returns the same number.

        ``described`` stands in for the installed definition, e.g. the one of a bag that is copied. The last
        message of a ``latched`` topic stands at the start of each further part as well.

        Raises:
            InputError: the topic was added with another type, or the type is unknown.
        """
        number = self._numbers.get(topic)
        if number is not None:
            known = self._channels[number]
            if known.topic.type != type_name:
                raise InputError(f"{topic} is already recorded as {known.topic.type}, not {type_name}")
            known.latched = known.latched or latched
            return number
        described = described or metadata.definition(type_name)
        counted = metadata.TopicCount(topic, type_name, described.digest, tuple(qos))
        self._append(_Channel(counted, described, latched))
        with self._guarded():
            self._register(self._channels[-1])
        self._described = -math.inf  # metadata.yaml lists it with the next chunk
        return len(self._channels) - 1

    def write(
        self,
        channel: int,
        log_time: int,
        data: bytes,
        publish_time: int | None = None,
        sequence: int = 0,
        *,
        flush: bool = True,
    ) -> None:
        """Append the CDR ``data``; times in ns, ``publish_time`` defaults to ``log_time``.

        Without ``flush``, the caller calls :meth:`flush_if_due` behind the last of what waits.
        """
        published = log_time if publish_time is None else publish_time
        one = self._channels[channel]
        if not self._open:
            raise self._closed()
        try:
            if self._is_full(log_time):
                self._split(log_time)
            elif self._part.size > self._allowed and self._keep_quota():
                self._write_metadata()
            number = self._register(one) if one.part is None else one.part
            self._part.write(number, one.topic.name, log_time, data, published, sequence)
        except OSError as error:
            raise self._failed(error) from error
        self.written += 1
        one.topic.messages += 1
        if one.latched and self.limits is not None:
            one.last = data, published, sequence
        if flush:
            self.flush_if_due()

    def flush_if_due(self) -> None:
        """Close the chunk and sync it if the last time was ``flush_interval`` ago."""
        if time.monotonic() - self._flushed >= self._interval:
            self.flush()

    @property
    def flush_due_in(self) -> float:
        """Seconds until the next flush is due, at least 0: who looks later syncs later than promised."""
        return max(self._flushed + self._interval - time.monotonic(), 0.0)

    def flush(self) -> None:
        """Close the chunk in progress and sync it to the disk; keep the quota."""
        with self._guarded():
            self._sync()
            self._flushed = time.monotonic()
            if self._keep_quota() or self._flushed - self._described >= self._metadata_interval:
                self._write_metadata()

    def close(self) -> None:
        """Write index, footer and the final ``metadata.yaml``; closing again does nothing.

        Raises:
            InputError: something took the place of a staged bag meanwhile.
        """
        self.finish()
        if self._folder != self.path:
            if self.path.exists() or self.path.is_symlink():
                remove(self._folder)
                raise InputError(f"{self.path} exists already: name a bag that does not, or remove it")
            self._folder.replace(self.path)
            sync_folder(self.path.absolute().parent)
            self._folder, self._part.path = self.path, self.path / self._part.path.name

    def finish(self) -> None:
        """Do what :meth:`close` does, but leave a staged bag under its other name, to be read again."""
        if not self._open:
            return
        with self._guarded():
            self._end_part()
            if self._list is not None:
                self._list.end(self._part.digest)
            self._write_metadata(finished=True)
        self._open = False
        self.release()

    def discard(self) -> None:
        """Leave nothing of a staged bag that is not closed; close any other."""
        if self._folder == self.path:
            self.close()
            return
        if self._open:
            self._open = False
            self._part.abandon(cut=False)
        self.release()
        remove(self._folder)
        self._folder = self.path

    def state_loss(self, count: int, because: str) -> None:
        """State in the bag that ``count`` messages were not recorded: in the file, and in ``custom_data``."""
        told = {"lost_messages": str(count), "lost_because": because, "at_ns": str(time.time_ns())}
        self._custom["lost_messages"] = str(int(self._custom.get("lost_messages", "0")) + count)
        with self._guarded():
            self._sync()
            self._part.add_metadata(LOSSES, told)
            self._sync()
        # With the next chunk: if metadata.yaml failed here, the loss would be stated again.
        self._described = -math.inf

    def remove_oldest(self) -> bool:
        """Remove the oldest finished part; return whether there was one."""
        if not self._parts:
            return False
        with self._guarded():
            self._remove(1)
            self._write_metadata()
        return True

    def hashes(self, number: int) -> tuple[str, ...]:
        """Return the SHA-256 that the file of a part may have."""
        return self._list.hashes(number) if self._list is not None else ()

    def replace(self, count: metadata.PartCount, staged: Path, sha256: str) -> bool:
        """Replace a finished part by the file ``staged`` with this SHA-256; return whether it is still there.

        Raises:
            OSError: it could not.
        """
        for place, part in enumerate(self._parts):
            if part.file == count.file and self._list is not None:
                with self._guarded():
                    self._list.thin(count.number, sha256)
                staged.replace(self._folder / part.file)
                self._parts[place] = count
                with self._guarded():
                    self._write_metadata()
                return True
        return False

    @property
    def finished_parts(self) -> tuple[metadata.PartCount, ...]:
        """Parts that are kept, without the one that is written."""
        return tuple(self._parts)

    @property
    def newest(self) -> int:
        """Time of reception of the newest message in the part that is written or before it, ns."""
        counts = [one for one in (*self._parts[-1:], self._part.count) if one.start is not None]
        return counts[-1].end if counts else 0

    @property
    def size(self) -> int:
        """B of all parts."""
        return sum(part.size for part in self._parts) + self._part.size

    @property
    def parts(self) -> int:
        """Number of parts that are kept."""
        return len(self._parts) + 1

    @property
    def messages(self) -> int:
        """Number of messages written, repeated ones left out."""
        return sum(one.topic.messages for one in self._channels)

    @property
    def counts(self) -> dict[str, int]:
        """Messages per topic."""
        return {one.topic.name: one.topic.messages for one in self._channels}

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            try:
                self.close()
            except BaseException:
                self.discard()
                raise
        else:
            self.discard()

    def _file_of(self, number: int) -> Path:
        return self._folder / f"{self.path.name}_{number}.mcap"

    def _begin(self, begin: PartBegin, ended: str = "") -> McapPart:
        about = {BEGIN: begin.content()} if self.limits is not None else None
        if self._list is not None:
            self._list.begin(begin.number, ended)
        part = McapPart(self._file_of(begin.number), begin.number, about)
        self._begun = begin
        for one in self._channels:
            one.part = None
        return part

    def _append(self, one: _Channel) -> None:
        self._numbers[one.topic.name] = len(self._channels)
        self._channels.append(one)

    def _register(self, one: _Channel) -> int:
        topic = one.topic
        one.part = self._part.add(topic.name, topic.type, one.described, metadata.qos_text(topic.qos))
        return one.part

    def _is_full(self, log_time: int) -> bool:
        limits, count = self.limits, self._part.count
        if limits is None or count.start is None:
            return False
        grown = self._part.size + self._part.closing + limits.margin
        return log_time - count.start >= limits.duration * 1e9 or grown > limits.largest

    def _split(self, log_time: int) -> None:
        """Finish the part and begin the next; latched messages are repeated ahead of its first message."""
        self._end_part()
        self._parts.append(self._part.count)
        repeated = [one for one in self._channels if one.last is not None]
        at = log_time - 1 if repeated else 0
        self._part = self._begin(PartBegin(self._part.count.number + 1, at), self._part.digest)
        for one in repeated:
            assert one.last is not None
            self._part.write(self._register(one), one.topic.name, at, *one.last)
        self._sync()
        self._keep_quota()
        self._write_metadata()

    def _end_part(self) -> None:
        """Write what ends a part: the bag's metadata and the index."""
        self._sync()
        # As rosbag2's own plugin does, so that the file by itself tells its distribution and counts.
        alone = metadata.BagMetadata((self._part.count,), self._topics(), finished=True, custom=self._custom)
        self._part.add_metadata("rosbag2", {"serialized_metadata": metadata.metadata_text(alone)})
        self._part.finish()

    def _keep_quota(self) -> bool:
        """Remove the oldest parts where all come near the quota; return whether there were such.

        Until the newest part is as large as is allowed then, it need not be called again.
        """
        if self.limits is None or not self.limits.total:
            self._allowed = math.inf
            return False
        total = self.limits.total - self.limits.margin - self._part.closing
        excess, many = self.size - total, 0
        while many < len(self._parts) and excess > 0:
            excess -= self._parts[many].size
            many += 1
        if many:
            self._remove(many)
        self._allowed = total - sum(part.size for part in self._parts) if self._parts else math.inf
        return many > 0

    def _remove(self, many: int) -> None:
        """Remove the oldest parts; the list leaves them out first: it is no tampering."""
        following = self._parts[many] if many < len(self._parts) else self._part.count
        self._sync()
        if self._list is not None:
            self._list.forget(following.number)
        for _ in range(many):
            (self._folder / self._parts[0].file).unlink(missing_ok=True)
            self._parts.pop(0)
            self.removed += 1

    def _sync(self) -> None:
        self._part.flush()
        self.synced = self.written

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        if not self._open:
            raise self._closed()
        try:
            yield
        except OSError as error:
            raise self._failed(error) from error

    def _closed(self) -> RecordingError:
        return RecordingError(f"{self.file} is closed")

    def _failed(self, error: OSError) -> RecordingError:
        """Write no more after ``error`` of the disk; return what to raise."""
        self.abandon()
        return RecordingError(
            f"{self.file}: {error.strerror}; earlier data is kept ({self._part.good} bytes)"
        )

    def abandon(self) -> None:
        """Write no more: cut the part back to what is on the disk, and leave it as it is."""
        if not self._open:
            return
        self._open = False
        self.certain = self._part.abandon(cut=True)
        self.release()
        # A part without messages: on a disk that stays full each try would leave one behind.
        empty = self.certain and self._part.good == self._part.head and self._part.path.is_file()
        if self.limits is not None and empty:
            self._part.discard()
            self.withdrawn = self._begun
            with contextlib.suppress(OSError):
                self._write_metadata(without_last=True)

    def release(self) -> None:
        """Release the folder for another writer."""
        if self._claim is not None:
            self._claim.release()

    def _topics(self) -> tuple[metadata.TopicCount, ...]:
        return tuple(one.topic for one in self._channels)

    def _write_metadata(self, *, finished: bool = False, without_last: bool = False) -> None:
        begin = time.monotonic()
        parts = (*self._parts, *(() if without_last else (self._part.count,)))
        about = metadata.BagMetadata(parts, self._topics(), finished=finished, custom=self._custom)
        metadata.write_metadata(self._folder, about)
        self._described = time.monotonic()
        self._metadata_interval = max(METADATA_INTERVAL, METADATA_SHARE * (self._described - begin))


class FolderClaim:
    """Claim on ``folder`` (flock(2)), until it is released or the process ends, however that ends.

    Raises:
        InputError: another recorder has it.
        OSError: the folder cannot be opened.
    """

    def __init__(self, folder: Path) -> None:
        self._descriptor = open_folder(folder)
        if self._descriptor is None:
            return
        try:
            lock_file(self._descriptor, wait=False)
        except BlockingIOError:
            self.release()
            raise InputError(
                f"{folder}: another recorder writes there: stop it, or name another output"
            ) from None
        except OSError:  # a file system without locks
            return

    def release(self) -> None:
        """Release the claim; a second call does nothing."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)


@dataclass(slots=True)
class _Channel:
    """Channel of a bag: topic, definition, number in the present part, and the last latched message."""

    topic: metadata.TopicCount
    described: metadata.Definition
    latched: bool
    part: int | None = None
    last: tuple[bytes, int, int] | None = None
