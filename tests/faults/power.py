"""Power loss: every write of a recording up to any moment, of which only what was synced is sure to be there.

Model of a file system after a power loss: bytes behind a file's last fsync are there, missing or zero from
some place on; names made or changed since the folder's last fsync are there or not, in the order in which
they were made.
"""

from __future__ import annotations

import os
import random
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from spool_bag.verification import recover
from spool_core.errors import InputError

from .disk import Disk
from .files import Contents, block
from .outcome import Outcome

_HEAD = struct.Struct("<cqqIII")
#: Times real time at which it is recorded and synced; so a second is 0.1 s.
SPEED = 10.0
COUNT = 1500


class Change(NamedTuple):
    """Change of a file: ``what`` as the shim names it, ``at`` in ns."""

    what: str
    at: int
    number: int
    path: str
    other: str
    data: bytes


def record(bag: Path, times: Path) -> None:
    """Record :data:`COUNT` blocks in parts, ten times as fast as real time; remember when each was put."""
    import time  # noqa: PLC0415 - this runs in a separate process

    from spool_bag.metadata import ACCELERATION_BLOCK, definition  # noqa: PLC0415
    from spool_bag.recorder import Recorded  # noqa: PLC0415
    from spool_bag.recording import Recording, RecordingSettings  # noqa: PLC0415
    from spool_bag.writer import PartLimits  # noqa: PLC0415
    from spool_core.cdr import encode_block  # noqa: PLC0415

    class Quiet:
        def info(self, message: str) -> None: ...
        def error(self, message: str) -> None: ...

    settings = RecordingSettings(PartLimits(duration=4.0), flush_interval=0.7 / SPEED)
    definition(ACCELERATION_BLOCK)  # loading it is not ten times as fast
    one = Recording(bag, settings, Quiet())
    put = np.zeros(COUNT, np.int64)
    due = time.monotonic()
    for number in range(COUNT):
        made = block(number)
        due += 0.02 / SPEED
        time.sleep(max(due - time.monotonic(), 0.0))
        put[number] = time.monotonic_ns()
        one.put(
            Recorded(
                "/valve_1/acceleration",
                ACCELERATION_BLOCK,
                made.stamp,
                made.stamp,
                encode_block(made, "valve_1"),
            )
        )
    one.close(60.0)
    np.save(times, put)


@dataclass
class WriteLog:
    """Log of every write of one recording, with when its blocks were put."""

    folder: Path
    changes: list[Change] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True)
        self.bag = self.folder / "bag"
        log, times = self.folder / "writes", self.folder / "times.npy"
        disk = Disk(self.bag, self.folder / "control", log)
        code = "import sys; from pathlib import Path; from tests.faults.power import record; "
        subprocess.run(
            [sys.executable, "-c", code + "record(Path(sys.argv[1]), Path(sys.argv[2]))", self.bag, times],
            env={**os.environ, **disk.environment, "PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])},
            check=True,
        )
        disk.close()
        self.put = np.load(times)
        self.changes = list(_changes(log.read_bytes()))
        self.contents = Contents(self.bag)

    def replayed(self, until: int, draw: random.Random, target: Path) -> None:
        """Write to ``target`` what a power loss behind the first ``until`` changes leaves."""
        machine = _Machine()
        for change in self.changes[:until]:
            machine.take(change)
        target.mkdir(parents=True)
        for name, content in machine.left(draw):
            (target / Path(name).name).write_bytes(content)


def _changes(data: bytes) -> Iterator[Change]:
    at = 0
    while at + _HEAD.size <= len(data):
        what, when, number, first, second, size = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        path, at = data[at : at + first].decode(), at + first
        other, at = data[at : at + second].decode(), at + second
        yield Change(what.decode(), when, number, path, other, data[at : at + size])
        at += size


@dataclass
class _File:
    data: bytearray = field(default_factory=bytearray)
    synced: int = 0


class _Machine:
    """Files as the processes see them, and as the disk has them."""

    def __init__(self) -> None:
        self.seen: dict[str, _File] = {}
        self.kept: dict[str, _File] = {}
        self.unsynced: list[tuple[str, str, _File | None]] = []

    def take(self, change: Change) -> None:
        """Do what a process did."""
        what, path = change.what, change.path
        if what == "C":
            self.seen[path] = _File()
            self.unsynced.append(("set", path, self.seen[path]))
        elif what == "W" and path in self.seen:
            self.seen[path].data += change.data
        elif what == "T" and path in self.seen:
            file = self.seen[path]
            del file.data[change.number :]
            file.synced = min(file.synced, change.number)
        elif what == "R" and path in self.seen:
            file = self.seen.pop(path)
            self.seen[change.other] = file
            self.unsynced.append(("move", path, None))
            self.unsynced.append(("set", change.other, file))
        elif what == "U":
            self.seen.pop(path, None)
            self.unsynced.append(("gone", path, None))
        elif what == "S" and path in self.seen:
            self.seen[path].synced = len(self.seen[path].data)
        elif what == "S":  # the folder
            self._keep(len(self.unsynced))

    def _keep(self, count: int) -> None:
        for what, path, file in self.unsynced[:count]:
            if what == "set" and file is not None:
                self.kept[path] = file
            else:
                self.kept.pop(path, None)
        del self.unsynced[:count]

    def left(self, draw: random.Random) -> Iterator[tuple[str, bytes]]:
        """Yield the files that the disk has, by ``draw`` where it is not sure of them."""
        count = draw.randint(0, len(self.unsynced))
        if count < len(self.unsynced) and self.unsynced[count][0] == "set" and count:
            count -= self.unsynced[count - 1][0] == "move"  # a rename is one step
        self._keep(count)
        for path, file in self.kept.items():
            end = draw.randint(file.synced, len(file.data))
            content = bytes(file.data[:end])
            if draw.random() < 0.3:
                content += bytes(len(file.data) - end)
            yield path, content


def power_loss(log: WriteLog, folder: Path, seed: int) -> Outcome:
    """Cut the power at any write: all but the last second is there, nothing is made up."""
    draw = random.Random(seed)
    first = next(place for place, change in enumerate(log.changes) if change.what == "S")
    until = draw.randint(first, len(log.changes))
    log.replayed(until, draw, folder / "bag")
    at = log.changes[until - 1].at
    promised = {number for number in range(COUNT) if log.put[number] <= at - 1e9 / SPEED}
    try:
        result = recover(folder / "bag", folder / "recovered")
    except InputError as error:
        wrong = str(error) if promised else ""
        return Outcome("power loss", seed, len(promised), len(promised) * 0.02, wrong=wrong)
    kept, foreign = log.contents.foreign(folder / "recovered") if result.messages else (set[int](), 0)
    sent = {number for number in range(COUNT) if log.put[number] <= at}
    missing = sent - kept
    ages = [float(at - log.put[number]) * 1e-9 * SPEED for number in missing]
    stated = not result.closed or bool(result.warnings) or bool(result.lost)
    return Outcome(
        "power loss",
        seed,
        len(missing),
        max(ages, default=0.0),
        0 if stated or not missing or until == len(log.changes) else len(missing),
        foreign,
    )
