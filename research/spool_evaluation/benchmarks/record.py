"""Benchmark of recording: blocks of many valves by the recorder, and by a plain one with the library mcap.

Blocks of 40 samples at 2 kHz come from one process. The plain one keeps no parts, hashes, losses or
snapshots, and syncs nothing: what it has not written when the power fails is lost.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from spool_bag.reader import BagReader
from spool_core.cdr import block_head
from spool_core.errors import InputError
from spool_core.node.network import isolate
from spool_tools.operations.node_processes import Nodes

from spool_evaluation.benchmarks.load import plain_recorder
from spool_evaluation.benchmarks.load.valve_source import memory, processor_time, sending

VALVES = (32,)
#: s that blocks are sent, after which processor time is taken, and that nodes have to start.
SECONDS, SETTLED, START = 60.0, 10.0, 5.0
#: Blocks by which each valve's run is ahead of the one before it, longer than a chunk of 32 valves: equal
#: samples would pack better.
SHIFT = 93
#: s that a recorder may take to end.
PATIENCE = 60.0


@dataclass(frozen=True, slots=True)
class RecordingCost:
    """Cost of recording so many ``valves``.

    ``cores`` is processor time over wall time, ``bytes_per_second`` what the disk took, ``resident`` memory
    in B; ``lost`` are the blocks that lack between the first recorded and the last sent.
    """

    valves: int
    recorder: str
    seconds: float
    cores: float
    bytes_per_second: float
    resident: int
    blocks: int
    lost: int

    def cells(self) -> dict[str, str]:
        """Return the row of the table."""
        return {
            "valves": str(self.valves),
            "recorder": self.recorder,
            "seconds": f"{self.seconds:.0f}",
            "cores": f"{self.cores:.3f}",
            "kB/s on the disk": f"{1e-3 * self.bytes_per_second:.0f}",
            "RSS, MB": f"{1e-6 * self.resident:.0f}",
            "blocks recorded": str(self.blocks),
            "blocks lost": str(self.lost),
        }


def run(seconds: float = SECONDS, valves: Sequence[int] = VALVES) -> Iterator[RecordingCost]:
    """Yield two rows for each number of valves."""
    isolate()
    for count in valves:
        for recorder in ("spool_bag", "plain, mcap"):
            yield _measured(count, seconds, recorder)


def _measured(count: int, seconds: float, recorder: str) -> RecordingCost:
    Console(stderr=True).print(f"{count} valves, {recorder}: {seconds:g} s ...", highlight=False)
    names = [f"valve_{number + 1}" for number in range(count)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = folder / "bag"
        with Nodes(folder / "nodes.log") as nodes:
            if recorder == "spool_bag":
                given = ["-p", f"output:={bag}", "-p", f"valves:=[{','.join(names)}]"]
                nodes.start(recorder, "spool_bag", "recorder", ["--ros-args", *given])
            else:
                topics = [f"/{one}/acceleration" for one in names]
                bag = bag.with_suffix(".mcap")
                nodes.running[recorder] = subprocess.Popen(
                    [sys.executable, "-m", plain_recorder.__name__, str(bag), *topics], start_new_session=True
                )
            time.sleep(START)
            with sending(folder, count, seconds, shift=SHIFT) as saw:
                time.sleep(min(SETTLED, 0.25 * seconds))
                process = nodes.running[recorder].pid
                before, begin = processor_time(process), time.monotonic()
                time.sleep(0.7 * seconds)
                cores = (processor_time(process) - before) / (time.monotonic() - begin)
                resident = memory(process)[1]
                sent = int(saw()["blocks"])
            time.sleep(1.0)  # what was sent last is still on its way
            nodes.stop(recorder, patience=PATIENCE)
        files = [bag] if bag.is_file() else list(bag.glob("*.mcap"))
        size = sum(file.stat().st_size for file in files)
        found = _sequences(bag)
    lacking = [one for one in names if one not in found]
    if lacking:
        raise InputError(f"bench record: nothing of {lacking[0]} was recorded")
    lost = sum(sent - min(of_one) - len(of_one) for of_one in found.values())
    blocks = sum(map(len, found.values()))
    return RecordingCost(count, recorder, seconds, cores, size / seconds, resident, blocks, lost)


def _sequences(bag: Path) -> dict[str, set[int]]:
    """Return the sequences that were recorded of each valve."""
    found: dict[str, set[int]] = {}
    for topic, record in BagReader(bag).records():
        if topic.name.endswith("/acceleration"):
            found.setdefault(topic.name.split("/")[1], set()).add(block_head(record.data)[0])
    return found
