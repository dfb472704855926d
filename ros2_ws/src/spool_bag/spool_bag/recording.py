"""A recording in parts, and the thinning of old ones."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Protocol

from spool_core.errors import InputError
from spool_core.faults import unexpected

from spool_bag.mcap_file import McapFile
from spool_bag.metadata import Definition, PartCount, is_unfinished
from spool_bag.part_records import BEGIN, LOSSES, begin_of, file_hash, losses_of
from spool_bag.parts import McapPart, numbered
from spool_bag.recorder import PARAMETER_EVENTS, TOPICS, MessageQueue, Recorded
from spool_bag.writer import BagWriter, Before, PartLimits, RecordingError

#: B of messages that may wait for the disk: 80 valves at 2 kHz for 20 s.
LARGEST_QUEUE = 64_000_000
#: s between two turns of writing what waits, between two looks at the disk, and between two tries to go on.
TURN, LOOK, RETRY = 0.1, 0.2, 1.0
#: s after which it looks at all else though messages wait, where they come faster than the disk takes them.
LONGEST_TURN = 1.0

#: Names of topics that stay.
KEPT = {*TOPICS, PARAMETER_EVENTS.strip("/")} - {"acceleration"}
#: What the file is called until it takes the place of the part.
STAGED = ".thinned"
#: s between two looks for parts that are old enough, and ns by which one part ages those before it at most: a
#: clock that jumps, or a machine that was off, makes no part old by itself.
THINNING_LOOK, LONGEST_STEP = 60.0, 86_400 * 10**9


class Log(Protocol):
    """Log for people."""

    def info(self, message: str) -> object:
        """Say what was done."""

    def error(self, message: str) -> object:
        """Say what went wrong."""


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """Settings of a recording.

    ``limits`` of its parts; ``minimum_free`` (B) on the disk, below which the oldest parts go and then
    recording pauses; ``flush_interval`` (s); ``custom`` stands in the metadata; ``resume``: go on in a
    recording that is there; ``sign`` signs the list of parts; ``thin_after`` (s) removes the accelerations of
    older parts, 0 never.
    """

    limits: PartLimits = field(default_factory=PartLimits)
    minimum_free: int = 0
    flush_interval: float = 0.7
    custom: Mapping[str, str] = field(default_factory=dict)
    resume: bool = False
    sign: Callable[[str], str] | None = None
    thin_after: float = 0.0


@dataclass(frozen=True, slots=True)
class RecordingState:
    """State of a recording: ``paused`` says why it pauses, "" while it records.

    ``messages`` and ``bytes`` recorded; ``lost`` since its start, and ``unstated`` of these not yet told in
    the bag; ``waiting`` B in the queue; ``parts``, ``size`` (B) and ``removed`` of its parts; ``free`` B.
    """

    paused: str = ""
    messages: int = 0
    bytes: int = 0
    lost: int = 0
    unstated: int = 0
    waiting: int = 0
    parts: int = 0
    size: int = 0
    removed: int = 0
    free: int = 0


class Recording:
    """Recording in the folder ``path``, on a separate thread, from the first call until :meth:`close`.

    The thread alone touches the disk, so a slow disk never holds up the subscriptions. If the disk is full,
    read-only or gone, messages wait in the queue, those that find it full are counted, and recording goes on
    by itself once it can.

    Raises:
        InputError: ``path`` exists, or cannot be made.
        RecordingError: it cannot be written to.
    """

    def __init__(self, path: Path, settings: RecordingSettings, log: Log) -> None:
        self.path = path
        self._settings, self._log = settings, log
        self._queue = MessageQueue(LARGEST_QUEUE)
        self._removed = self._free = self._confirmed = 0
        self._lost: dict[str, int] = {}
        self._unstated, self._because = 0, ""
        self._paused = ""
        self._lock = threading.Lock()
        self._ending = False
        self._latched: dict[str, Recorded] = {}
        self._oldest = 0
        self._cut_off = settings.resume and is_unfinished(path)
        self._writer: BagWriter | None = None
        try:
            self._writer = self._opened(resume=settings.resume)
        except RecordingError as error:
            if not settings.resume:
                raise
            # A machine that is switched on with a full disk: it records once there is room.
            self._paused = str(error)
            log.error(f"recording pauses: {error}")
        self._thinning = Thinning(path, settings.thin_after, log)
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def put(self, message: Recorded) -> None:
        """Take a message; what finds the queue full is counted as lost. Never waits for the disk."""
        lost = self._queue.put(message)
        if lost is not None:
            self._lose(lost.topic, 1, f"{self._paused or 'the disk is too slow'}: the queue is full")

    @property
    def state(self) -> RecordingState:
        """What is going on; messages count once they are on the disk."""
        writer = self._writer
        dead = not (self._thread.is_alive() or self._ending)
        with self._lock:
            return RecordingState(
                self._paused or ("the recording thread ended: restart the recorder" if dead else ""),
                self._queue.messages,
                self._queue.bytes,
                sum(self._lost.values()),
                self._unstated,
                self._queue.waiting,
                writer.parts if writer is not None else 0,
                writer.size if writer is not None else 0,
                self._removed + (writer.removed if writer is not None else 0),
                self._free,
            )

    @property
    def lost(self) -> dict[str, int]:
        """Messages that were not recorded, by topic."""
        with self._lock:
            return dict(self._lost)

    def close(self, timeout: float | None = None) -> bool:
        """Write what waits and finish; return whether that was done within ``timeout`` s."""
        self._ending = True
        self._queue.wake()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _opened(self, *, resume: bool, lost: int = 0) -> BagWriter:
        before = Before((lost, self._because), tuple(self._latched.values()), self._oldest, self._cut_off)
        writer = BagWriter(
            self.path,
            flush_interval=self._settings.flush_interval,
            custom=self._settings.custom,
            limits=self._settings.limits,
            resume=resume,
            sign=self._settings.sign,
            before=before,
        )
        self._cut_off = False
        return writer

    def _run(self) -> None:
        looked = -math.inf
        while not self._ending:
            writer = self._writer
            self._queue.wait(RETRY if writer is None else min(TURN, writer.flush_due_in))
            with self._kept_alive():
                self._empty()
                if time.monotonic() - looked >= (RETRY if self._writer is None else LOOK):
                    looked = time.monotonic()
                    self._look()
        with self._kept_alive():
            self._empty()
            if self._writer is None:
                self._look()
                self._empty()
            self._attempt(BagWriter.close)
        for message in self._queue.clear():
            self._lose(message.topic, 1, self._paused)
        with self._lock:
            self._writer, self._paused = None, self._paused or "closed"
        if self._unstated:
            self._log.error(f"{self._unstated} messages were not recorded at the end: {self._because}")
            with contextlib.suppress(InputError, OSError):  # there is room for that, or for nothing
                self._opened(resume=True, lost=self._unstated).close()
                self._unstated = 0
        self._thinning.close()

    @contextlib.contextmanager
    def _kept_alive(self) -> Iterator[None]:
        """Keep the thread alive: any call may meet a failing disk, and the next one tries again."""
        try:
            yield
        except Exception as error:
            foreseen = isinstance(error, (OSError, InputError, MemoryError))
            because = f"{type(error).__name__}: {error}" if foreseen else unexpected(error)
            writer = self._writer
            if writer is not None:
                writer.abandon()
                self._fail(because, writer)
            elif because != self._paused:
                self._log.error(f"recording pauses: {because}")
                with self._lock:
                    self._paused = because

    def _empty(self) -> None:
        """Write what waits, then sync: else the first message would be synced without the rest."""
        begin = time.monotonic()
        end = math.inf if self._ending else begin + LONGEST_TURN
        while (
            (writer := self._writer) is not None
            and (now := time.monotonic()) < end
            and (message := self._queue.take()) is not None
        ):
            try:
                channel = writer.add_topic(message.topic, message.kind, message.qos, latched=message.latched)
                writer.write(
                    channel, message.received, message.data, message.published, flush=now - begin >= TURN
                )
            except RecordingError as error:
                self._fail(str(error), writer)
            except InputError as error:
                self._log.error(f"a message is not recorded: {error}")
                self._queue.drop()
                self._lose(message.topic, 1, str(error))
            else:
                if writer.synced != self._confirmed:
                    self._confirm(writer)
        self._attempt(BagWriter.flush_if_due)
        # What was lost is written into the bag while it can be written on.
        with self._lock:
            count, because = self._unstated, self._because
        if count and self._attempt(lambda writer: writer.state_loss(count, because)):
            with self._lock:
                self._unstated -= count

    def _attempt(self, action: Callable[[BagWriter], object]) -> bool:
        """Do something with the writer and return True; a failing disk makes it pause, and the rest waits.

        Raises:
            InputError: it cannot be written, whatever the disk.
        """
        writer = self._writer
        if writer is None:
            return False
        try:
            action(writer)
        except RecordingError as error:
            self._fail(str(error), writer)
            return False
        self._confirm(writer)
        return True

    def _confirm(self, writer: BagWriter) -> None:
        """Drop messages from the queue that are on the disk."""
        self._leave(self._queue.confirmed(writer.synced - self._confirmed))
        self._confirmed = writer.synced

    def _leave(self, messages: Iterable[Recorded]) -> None:
        """Remember the latched ones of messages that the queue has forgotten: further parts repeat them."""
        self._latched |= {message.topic: message for message in messages if message.latched}

    def _lose(self, topic: str, count: int, because: str) -> None:
        """Count messages that are not recorded."""
        with self._lock:
            self._lost[topic] = self._lost.get(topic, 0) + count
            self._unstated += count
            self._because = because

    def _look(self) -> None:
        """Keep room on the disk, notice a removed folder, go on after a pause, thin what is old."""
        writer = self._writer
        if writer is not None and _is_gone(writer.file):
            self._begin_anew(writer)
            writer = None
        self._free = _free(self.path)
        if writer is None:
            self._go_on()
            return
        least = self._settings.minimum_free
        while self._free < least and writer.parts > 1:
            if not self._attempt(BagWriter.remove_oldest):
                return
            self._free = _free(self.path)
        if self._free < least:
            if self._attempt(BagWriter.close):
                self._pause(f"only {self._free / 1e6:.0f} MB are free (minimum_free_space)", writer)
            return
        self._attempt(self._thinning.look)

    def _fail(self, because: str, writer: BagWriter) -> None:
        """Pause after a failure, or begin another file where the removal of this one is its cause."""
        gone = False
        with contextlib.suppress(OSError):
            gone = writer.withdrawn is None and _is_gone(writer.file)
        if gone:
            self._begin_anew(writer)
        else:
            self._pause(because, writer)

    def _begin_anew(self, writer: BagWriter) -> None:
        """Tell what a removed file took with it, and pause, to begin another."""
        gone = writer.messages
        self._log.error(
            f"{writer.file} was removed while it was recorded: {gone} messages are lost; "
            f"the recorder starts {self.path} again"
        )
        with contextlib.suppress(OSError):
            writer.close()
        self._leave(self._queue.uncertain(writer.written - self._confirmed))
        self._queue.take_back()
        self._lose("removed files", gone, "the file was removed")
        with self._lock:
            self._writer, self._paused = None, "the recording was removed"

    def _pause(self, because: str, writer: BagWriter) -> None:
        """Stop writing; what may be on the disk or not counts as lost, all else waits."""
        self._confirm(writer)
        if not writer.certain:
            gone = self._queue.uncertain(writer.written - writer.synced)
            self._leave(gone)
            for message in gone:
                self._lose(message.topic, 1, because)
        self._queue.take_back()
        if because != self._paused:
            self._log.error(f"recording pauses: {because}")
        with self._lock:
            self._writer, self._paused = None, because
            self._removed += writer.removed
            if writer.withdrawn is not None:
                self._unstated += writer.withdrawn.lost
                self._cut_off = writer.withdrawn.cut_off

    def _go_on(self) -> None:
        """Begin the next part where the cause of the pause is gone."""
        least = self._settings.minimum_free
        if self._free < 2 * least and "minimum_free_space" in self._paused:
            return
        self._make_room(least)
        lost = self._unstated  # told in the part's first record
        try:
            writer = self._opened(resume=True, lost=lost)
        except (InputError, OSError):
            return
        self._confirmed = 0
        with self._lock:
            self._unstated -= lost
            self._writer = writer
        self._empty()
        if not self._attempt(BagWriter.flush):  # the disk takes no more than a name
            return
        with self._lock:
            self._paused = ""
        self._log.info(f"recording continues in {writer.file}: {lost} messages were not recorded")

    def _make_room(self, least: int) -> None:
        """Remove the oldest parts but the last one where a disk filled faster than was looked at."""
        if self._free >= least:
            return
        try:
            files = numbered(self.path)
        except OSError:
            return
        for (_, oldest), (following, _) in pairwise(files):
            if self._free >= least:
                return
            try:
                oldest.unlink()
            except OSError:
                return
            self._removed += 1
            self._oldest = following
            self._free = _free(self.path)


def is_kept(topic: str) -> bool:
    """Return whether messages of ``topic`` stay in a part that is thinned."""
    return topic.rpartition("/")[2] in KEPT


def thin(path: Path, target: Path, hashes: Collection[str] = ()) -> tuple[PartCount, str] | None:
    """Write to ``target`` what stays of the finished part at ``path``; return its count and its SHA-256.

    The part must have one of ``hashes``, if there are any; ``None`` of a part that was never finished.

    Raises:
        InputError: the part is damaged.
        OSError: it cannot be read, or ``target`` not be written.
    """
    begin, file = begin_of(path), McapFile(path)
    if begin is None or not file.closed:
        return None
    if hashes and file_hash(path) not in hashes:
        raise InputError(f"{path}: its content was edited: it is left as it is")
    target.unlink(missing_ok=True)
    part = McapPart(target, begin.number, {BEGIN: begin.content()})
    try:
        channels: dict[int, int] = {}
        for record in file.records(lambda topic: is_kept(topic.name)):
            topic = file.topics[record.channel]
            if record.channel not in channels:
                described = Definition(topic.type, topic.schema, topic.digest, topic.schema_encoding)
                channels[record.channel] = part.add(topic.name, topic.type, described, topic.qos)
            part.write(
                channels[record.channel],
                topic.name,
                record.log_time,
                bytes(record.data),
                record.publish_time,
                record.sequence,
            )
        part.flush()
        for told in losses_of(path):
            part.add_metadata(LOSSES, told)
        part.finish()
    except BaseException:
        part.abandon(cut=False)
        target.unlink(missing_ok=True)
        raise
    count = part.count
    count.file = path.name
    return count, part.digest


class Thinning:
    """Thinning of the parts of the recording in ``path`` that ended more than ``after`` s ago; 0: none.

    The work is done beside the recording, one part at a time; :meth:`look` takes what is ready over. Age is
    by the times of reception from part to part.
    """

    def __init__(self, path: Path, after: float, log: Log) -> None:
        self._path, self._after, self._log = path, after, log
        self._worker = ThreadPoolExecutor(1, "thinning") if after > 0.0 else None
        self._under_way: tuple[Path, Future[tuple[PartCount, str] | None]] | None = None
        self._done: set[str] = set()
        self._looked = -math.inf
        for left in path.glob(f".*.mcap{STAGED}.*") if after > 0.0 else ():
            left.unlink(missing_ok=True)  # of a recorder that was killed

    def look(self, writer: BagWriter) -> None:
        """Take over what is done, and begin with the next part that is old enough.

        Raises:
            RecordingError: the recording could not be written on.
        """
        if self._worker is None:
            return
        if self._under_way is not None:
            part, future = self._under_way
            if not future.done():
                return
            self._under_way = None
            self._take_over(writer, part, future)
        if time.monotonic() - self._looked < THINNING_LOOK:
            return
        for count in older(writer, self._after * 1e9):
            if count.file not in self._done and not all(is_kept(topic) for topic in count.messages):
                self._done.add(count.file)
                part, hashes = self._path / count.file, writer.hashes(count.number)
                self._under_way = part, self._worker.submit(thin, part, _staged(part), hashes)
                return
        self._looked = time.monotonic()
        self._done &= {count.file for count in writer.finished_parts}

    def close(self) -> None:
        """Leave what is under way; the next recorder begins it again."""
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)
        if self._under_way is not None:
            _staged(self._under_way[0]).unlink(missing_ok=True)

    def _take_over(self, writer: BagWriter, part: Path, future: Future[tuple[PartCount, str] | None]) -> None:
        staged = _staged(part)
        try:
            thinned = future.result()
            if thinned is None:
                self._log.info(f"{part.name} was never finished: it is not thinned")
            elif writer.replace(thinned[0], staged, thinned[1]):
                self._log.info(f"{part.name} is thinned to {thinned[0].size / 1e6:.1f} MB (thin_after)")
        except RecordingError:
            raise
        except (InputError, OSError) as error:
            self._log.error(f"{part.name} cannot be thinned: {error}")
        finally:
            with contextlib.suppress(OSError):
                staged.unlink(missing_ok=True)


def older(writer: BagWriter, age: float) -> list[PartCount]:
    """Return the finished parts that ended more than ``age`` ns before the newest message, oldest first."""
    found, passed, following = [], 0, writer.newest
    for count in reversed(writer.finished_parts):
        if count.start is None:
            continue
        passed += min(max(following - count.end, 0), LONGEST_STEP)
        if passed > age:
            found.append(count)
        passed += min(count.duration, LONGEST_STEP)
        following = count.start
    return found[::-1]


def _is_gone(path: Path) -> bool:
    """Return whether a file was removed."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    return False


def _free(path: Path) -> int:
    """Return the free B on the disk of ``path``, 0 where that cannot be told."""
    for folder in (path, *path.absolute().parents):
        try:
            return shutil.disk_usage(folder).free
        except OSError:
            continue
    return 0


def _staged(part: Path) -> Path:
    return part.with_name(f".{part.name}{STAGED}.{os.getpid()}")
