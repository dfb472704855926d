"""Thinning of a recording: of old parts only estimates, health and events stay, accelerations go."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from spool_core.errors import InputError

from spool_bag.format.definitions import Definition
from spool_bag.format.metadata import PartCount
from spool_bag.mcap.mcap_file import McapFile
from spool_bag.mcap.part_chain import BEGIN, END, LOSSES, begin_of, end_of, losses_of

from .mcap_part import McapPart
from .recorder import PARAMETER_EVENTS, TOPICS
from .writer import CHUNK_SIZE, BagWriter, RecordingError

#: Names of topics that stay.
KEPT = {*TOPICS, PARAMETER_EVENTS.strip("/")} - {"acceleration"}
#: What the file is called until it takes the place of the part.
STAGED = ".thinned"
#: s between two looks for parts that are old enough, and ns by which one part ages those before it at most: a
#: clock that jumps, or a machine that was off, makes no part old by itself.
LOOK, LONGEST_STEP = 60.0, 86_400 * 10**9


class Log(Protocol):
    """Log for people."""

    def info(self, message: str) -> object:
        """Say what was done."""

    def error(self, message: str) -> object:
        """Say what went wrong."""


def is_kept(topic: str) -> bool:
    """Return whether messages of ``topic`` stay in a part that is thinned."""
    return topic.rpartition("/")[2] in KEPT


def thin(path: Path, target: Path, sign: Callable[[str], str] | None = None) -> PartCount | None:
    """Write to ``target`` what stays of the finished part at ``path``, and return its count.

    It keeps its place in the chain of hashes, and says its own hash besides; ``None`` of a part that was
    never finished, whose place nobody could vouch for.

    Raises:
        InputError: the part is damaged.
        OSError: it cannot be read, or ``target`` not be written.
    """
    begin, ended = begin_of(path), end_of(path)
    if begin is None or ended is None:
        return None
    end = ended.end
    if (end.thinned or end.content) != ended.content or not ended.sound:
        raise InputError(f"{path}: its content was edited: it is left as it is")
    target.unlink(missing_ok=True)
    file = McapFile(path)
    part = McapPart(target, begin.number, CHUNK_SIZE, {BEGIN: begin.content()})
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
        thinned = replace(end, thinned=part.digest)
        if sign is not None:
            thinned = replace(thinned, thinned_signature=sign(thinned.thinned_link))
        part.add_metadata(END, thinned.record())
        part.finish()
    except BaseException:
        part.abandon(cut=False)
        target.unlink(missing_ok=True)
        raise
    count = part.count
    count.file = path.name
    return count


class Thinning:
    """Thinning of the parts of the recording in ``path`` that ended more than ``after`` s ago; 0: none.

    The work is done beside the recording, one part at a time; :meth:`look` takes what is ready over. Age is
    by the times of reception from part to part.
    """

    def __init__(self, path: Path, after: float, sign: Callable[[str], str] | None, log: Log) -> None:
        self._path, self._after, self._sign, self._log = path, after, sign, log
        self._worker = ThreadPoolExecutor(1, "thinning") if after > 0.0 else None
        self._under_way: tuple[Path, Future[PartCount | None]] | None = None
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
        if time.monotonic() - self._looked < LOOK:
            return
        for count in older(writer, self._after * 1e9):
            if count.file not in self._done and not all(is_kept(topic) for topic in count.messages):
                self._done.add(count.file)
                part = self._path / count.file
                self._under_way = part, self._worker.submit(thin, part, _staged(part), self._sign)
                return
        self._looked = time.monotonic()
        self._done &= {count.file for count in writer.finished_parts}

    def close(self) -> None:
        """Leave what is under way; the next recorder begins it anew."""
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)
        if self._under_way is not None:
            _staged(self._under_way[0]).unlink(missing_ok=True)

    def _take_over(self, writer: BagWriter, part: Path, future: Future[PartCount | None]) -> None:
        staged = _staged(part)
        try:
            count = future.result()
            if count is None:
                self._log.info(f"{part.name} was never finished: it is not thinned")
            elif writer.replace(count, staged):
                self._log.info(f"{part.name} is thinned to {count.size / 1e6:.1f} MB (thin_after)")
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


def _staged(part: Path) -> Path:
    return part.with_name(f".{part.name}{STAGED}.{os.getpid()}")
