"""Snapshots: the last seconds in memory, and the bag that is written of them."""

from __future__ import annotations

import re
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.serde import SerdeError
from spool_core.cdr import CdrError, header_stamp
from spool_core.errors import InputError
from spool_core.events.event import snapshot_name
from spool_core.system import remove

from spool_bag.metadata import ACCELERATION_BLOCK, typestore
from spool_bag.part_records import begin_of
from spool_bag.recorder import LATCHED, MARKS, Recorded
from spool_bag.recording import Log
from spool_bag.writer import BagWriter

HEALTH_EVENT = "spool_msgs/msg/HealthEvent"

#: B of messages of one valve that are held in memory, before and after each.
MOST_BYTES = 64_000_000

#: Snapshots of one valve that may wait for their end at a time.
MOST_WAITING = 4

#: What a snapshot is named after that somebody asked for.
REQUESTED = "requested"
_RAISED, _ALARM = 1, 2

#: How much slower than time passes a clock of reception may go before less is held: that of a simulation.
SLOWEST = 2.0

#: Name of a snapshot: valve, event and time, and a number where the name was taken.
_NAME = re.compile(r".+_\w+_\d{8}T\d{6}Z(_\d+)?")
#: Snapshots that wait for the disk, each of them as large as its valve's rings.
MOST_KEPT = 4


@dataclass(slots=True)
class Snapshot:
    """The messages around ``event``, an alarm's kind or ``REQUESTED``.

    They are collected until ``end`` (ns, time of reception).
    """

    valve: str
    event: str
    stamp: int
    end: int
    latched: dict[str, Recorded]
    messages: list[Recorded]
    bytes: int

    @property
    def name(self) -> str:
        """Name of its bag, e.g. ``valve_1_resonance_20260102T030405Z``."""
        return snapshot_name(self.valve, self.event, self.stamp)

    def add(self, message: Recorded) -> None:
        """Take a message; beyond :data:`MOST_BYTES` nothing more is held."""
        if self.bytes + len(message.data) <= MOST_BYTES:
            self.messages.append(message)
            self.bytes += len(message.data)

    def write(self, folder: Path) -> Path:
        """Write the bag into ``folder`` and return its path; a taken name gets a number behind.

        Latched messages from before the snapshot stand at its beginning, so that it explains itself.

        Raises:
            InputError: the folder can't be made.
            RecordingError: the disk is full.

        """
        path, number = folder / self.name, 1
        while path.exists():
            number += 1
            path = folder / f"{self.name}_{number}"
        start = self.messages[0].received if self.messages else 0
        before = [one._replace(received=start or one.received) for one in self.latched.values()]
        with BagWriter(path, staged=True) as writer:
            for message in (*before, *self.messages):
                channel = writer.add_topic(message.topic, message.kind)
                writer.write(channel, message.received, message.data, message.published)
        return path


@dataclass(slots=True)
class SnapshotKeeper:
    """Ring buffers of the last ``before`` s of every valve; ``after`` s more are collected on an alarm.

    An alarm counts where its stamp lies within the blocks that are held: a recorder that joins late hears old
    events, too.

    Attributes:
        refused: alarms that got no separate snapshot because :data:`MOST_WAITING` were under way.

    """

    before: float = 60.0
    after: float = 60.0
    refused: int = field(default=0, init=False)
    _rings: dict[str, _Ring] = field(default_factory=dict, init=False)
    _valves: dict[str, str] = field(default_factory=dict, init=False)
    _waiting: list[Snapshot] = field(default_factory=list, init=False)

    def take(self, message: Recorded) -> None:
        """Take a message of any topic; those that belong to no valve are left out."""
        valve = self._valve(message)
        if valve is None:
            return
        ring = self._rings.get(valve)
        if ring is None:
            ring = self._rings[valve] = _Ring()
        for snapshot in self._waiting:
            if snapshot.valve == valve and message.received <= snapshot.end:
                snapshot.add(message)
        now = time.monotonic()
        ring.messages.append(message)
        ring.arrived.append(now)
        ring.bytes += len(message.data)
        if message.kind == ACCELERATION_BLOCK:
            ring.blocks.append(message.published)
        oldest = message.received - round(self.before * 1e9)
        while ring.messages and (
            ring.messages[0].received < oldest
            or now - ring.arrived[0] > SLOWEST * self.before
            or ring.bytes > MOST_BYTES
        ):
            gone = ring.messages.popleft()
            ring.arrived.popleft()
            ring.bytes -= len(gone.data)
            if gone.kind == ACCELERATION_BLOCK:
                ring.blocks.popleft()
            elif gone.topic.rpartition("/")[2] in LATCHED:
                ring.latched[gone.topic] = gone
        if message.kind == HEALTH_EVENT and message.topic == f"{valve}/events":
            self._judge(valve, ring, message)

    def due(self, now: int) -> list[Snapshot]:
        """Return the snapshots that are complete at ``now`` (ns, the clock of reception), once each.

        One that began after ``now`` is complete too: the clock was set back.
        """
        ready = [one for one in self._waiting if not one.end - self._length <= now < one.end]
        self._waiting = [one for one in self._waiting if one not in ready]
        return ready

    def rest(self) -> list[Snapshot]:
        """Return what waits, complete or not, because nothing more will come."""
        ready, self._waiting = self._waiting, []
        return ready

    @property
    def _length(self) -> int:
        return round(self.after * 1e9)

    @property
    def held(self) -> int:
        """Bytes of messages in the rings."""
        return sum(ring.bytes for ring in self._rings.values())

    def _valve(self, message: Recorded) -> str | None:
        topic = message.topic
        known = self._valves.get(topic)
        if known is not None:
            return known
        namespace, _, name = topic.rpartition("/")
        if name in MARKS or namespace in self._rings:
            self._valves[topic] = namespace
            return namespace
        return next((valve for valve in self._rings if topic.startswith(f"{valve}/")), None)

    def _judge(self, valve: str, ring: _Ring, message: Recorded) -> None:
        try:
            event: Any = typestore().deserialize_cdr(message.data, HEALTH_EVENT)
            stamp = header_stamp(message.data)
        except (CdrError, SerdeError):
            return
        raised = event.state == _RAISED and event.severity == _ALARM
        # The clock may have been set back meanwhile: the oldest block is not the one of the least stamp.
        if not raised or not ring.blocks or stamp < min(ring.blocks):
            return
        if not self._begin(valve, ring, event.kind, stamp, message.received):
            self.refused += 1

    def ask(self, valve: str, now: int) -> str:
        """Begin a snapshot of ``valve`` (its namespace) at ``now`` (ns); return why it did not begin."""
        ring = self._rings.get(valve)
        if ring is None or not ring.messages:
            return "no data of this valve is recorded"
        stamp = ring.blocks[-1] if ring.blocks else now
        if not self._begin(valve, ring, REQUESTED, stamp, now):
            return f"{MOST_WAITING} snapshots of this valve are in progress"
        return ""

    def _begin(self, valve: str, ring: _Ring, event: str, stamp: int, now: int) -> bool:
        """Begin a snapshot around ``stamp`` (ns), named after ``event``; return whether there was room."""
        if sum(one.valve == valve for one in self._waiting) >= MOST_WAITING:
            return False
        latched, messages = dict(ring.latched), list(ring.messages)
        end = now + self._length
        self._waiting.append(Snapshot(valve, event, stamp, end, latched, messages, ring.bytes))
        return True


class SnapshotWriter:
    """Writer of what ``keeper`` has complete into ``folder``, one after the other, on a separate thread.

    With a ``quota`` (B) the oldest snapshots go before the folder holds more than that. What the disk refuses
    is tried again, at most :data:`MOST_KEPT` snapshots.

    Attributes:
        written: bags that were made.

    """

    def __init__(self, keeper: SnapshotKeeper, folder: Path, log: Log, quota: int = 0) -> None:
        self.keeper = keeper
        self.written = 0
        self._folder, self._log = folder, log
        self._worker = ThreadPoolExecutor(1, "snapshots")
        self._told = False
        self._quota = quota
        self._failed: deque[Snapshot] = deque()
        self._pending: Future[None] | None = None

    def watch(self, now: int, limit: int) -> None:
        """Write what is complete at ``now`` (ns); of more than ``limit`` bags in the folder the oldest go."""
        idle = self._pending is None or self._pending.done()
        again = [self._failed.popleft()] if self._failed and idle else []
        for snapshot in (*again, *self.keeper.due(now)):
            self._pending = self._worker.submit(self._write, snapshot, limit)

    def close(self) -> None:
        """Write what waits, complete or not, and wait until it is written."""
        failed = [self._failed.popleft() for _ in range(len(self._failed))]
        for snapshot in (*failed, *self.keeper.rest()):
            self._worker.submit(self._write, snapshot, None)
        self._worker.shutdown()
        for snapshot in self._failed:
            self._report_lost(snapshot)

    def _report_lost(self, snapshot: Snapshot) -> None:
        self._log.error(f"snapshot {snapshot.name} is lost: the disk was too slow")

    def _write(self, snapshot: Snapshot, limit: int | None) -> None:
        try:
            self._make_room(snapshot.bytes, limit)
            path = snapshot.write(self._folder)
        except (OSError, InputError) as error:
            if not self._told:
                self._log.error(
                    f"snapshot of {snapshot.valve} {snapshot.event}: {error}; the recorder tries again"
                )
            self._told = True
            if len(self._failed) == MOST_KEPT:
                self._report_lost(self._failed.popleft())
            self._failed.append(snapshot)
            return
        self.written += 1
        self._told = False
        self._log.info(f"snapshot {path}: {len(snapshot.messages)} messages around {snapshot.event}")

    def _make_room(self, size: int, limit: int | None) -> None:
        """Remove the oldest snapshots until one of ``size`` B fits into quota and ``limit``."""
        if not self._folder.is_dir():
            return
        bags = sorted(filter(_is_snapshot, self._folder.iterdir()), key=lambda bag: bag.stat().st_mtime)
        sizes = [sum(file.stat().st_size for file in bag.iterdir() if file.is_file()) for bag in bags]
        held, left = sum(sizes), len(bags)
        for bag, own in zip(bags, sizes, strict=True):
            large = self._quota and held + size > self._quota
            if not large and (limit is None or left < limit):
                break
            remove(bag)
            held, left = held - own, left - 1
            because = "snapshot_max_total_size" if large else "snapshot_limit"
            self._log.info(f"snapshot {bag} is removed: {because}")


@dataclass(slots=True)
class _Ring:
    messages: deque[Recorded] = field(default_factory=deque)
    #: When each of them came, s of a clock that nobody sets.
    arrived: deque[float] = field(default_factory=deque)
    bytes: int = 0
    latched: dict[str, Recorded] = field(default_factory=dict)
    #: Acquisition times of the blocks in the ring, ns.
    blocks: deque[int] = field(default_factory=deque)


def _is_snapshot(bag: Path) -> bool:
    """Return whether a folder is a snapshot: one bag in one file; a recording in parts never goes for one."""
    if not (_NAME.fullmatch(bag.name) and bag.is_dir() and not bag.is_symlink()):
        return False
    files = list(bag.glob("*.mcap"))
    return len(files) == 1 and files[0].name == f"{bag.name}_0.mcap" and begin_of(files[0]) is None
