"""Source of the blocks of many valves: a recorded run sent again, cheaply, and when the estimates come back.

Run as ``python -m spool_evaluation.benchmarks.load.valve_source FILE OPTIONS``, where ``OPTIONS`` are fields
of ``ValveSource`` as JSON; what it saw is written to ``FILE``. Besides: what running processes cost, as the
kernel accounts for it.
"""

from __future__ import annotations

import json
import math
import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.serialization import deserialize_message, serialize_message
from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.messages import from_block
from spool_msgs.msg import AccelerationBlock, AccelerationBlocks, HealthEvent, ModelEstimate
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

SAMPLE_RATE, BLOCK_RATE = 2000.0, 50.0
#: Groups of valves whose blocks are due one after the other within a period: machines do not sample in step.
GROUPS = 10
#: s that it may be behind before it gives up.
LONGEST_BEHIND = 20.0
#: s after which a valve that was found counts as run in, and that nodes may take until they listen.
RUN_IN, PATIENCE = 20, 60.0
VALVE = "4weh10_soft"
#: Number of the alarm that no acceleration arrives.
SILENCE = 801


@dataclass(slots=True)
class ValveSource:
    """Source of the blocks of ``count`` valves for ``seconds``.

    Attributes:
        shift: blocks that each valve's run is ahead of the one before.
        sent: when each of the last blocks of a valve was sent, by its sequence, s of the monotonic clock.
        tracking: when each valve was first told to be tracking, s after its first block was heard.
        run_in: s after which a valve that was heard counts as run in.
        listeners: of each valve, that are waited for before the first block.
        shared: one message for all valves, of the same samples, instead of one for each.
        ages: from block to estimate (s), for estimates after the first ``run_in`` seconds, and before.
        delay: s, of the filter, as the last estimate says.
        lost: blocks that each estimator counts as lost.
        blocks: that were sent of each valve. cores: processor time of the source over the wall time.
        late: s, longest that a block was sent after its time.
        longest_wait: s, that a block waited for its turn in a host: while it starts, and later.
        silences: alarms 801 of a monitor, each of which is false.
    """

    count: int
    seconds: float
    shift: int = 0
    run_in: int = RUN_IN
    listeners: int = 0
    shared: bool = False
    delay: float = 0.0
    tracking: dict[int, float] = field(default_factory=dict)
    first: dict[int, float] = field(default_factory=dict)
    ages: list[float] = field(default_factory=list)
    start_ages: list[float] = field(default_factory=list)
    lost: dict[int, int] = field(default_factory=dict)
    longest_wait: dict[str, float] = field(default_factory=lambda: {"start": 0.0, "later": 0.0})
    sent: dict[int, list[float]] = field(default_factory=dict)
    blocks: int = 0
    late: float = 0.0
    silences: int = 0
    cores: float = math.nan
    _begin: float = 0.0

    def run(self) -> None:
        """Send at the pace of the clock until the time is over.

        Raises:
            InputError: the listeners did not come.
        """
        messages, at = self._messages()
        rclpy.init()
        node = rclpy.create_node("source")
        executor = EventsExecutor()
        executor.add_node(node)
        publishers = []
        for valve in range(self.count):
            name = f"/valve_{valve + 1}"
            profile = qos.samples_offered(BLOCK_RATE)
            if self.shared and valve == 0:
                publishers.append(node.create_publisher(AccelerationBlocks, "/accelerations", profile))
            elif not self.shared:
                publishers.append(node.create_publisher(AccelerationBlock, f"{name}/acceleration", profile))
            heard = partial(self._heard, valve)
            node.create_subscription(ModelEstimate, f"{name}/estimate", heard, qos.state(depth=10))
            node.create_subscription(HealthEvent, f"{name}/events", self._raised, qos.state(depth=100))
            self.sent[valve] = [math.nan] * 1000
        node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, qos.diagnostics())
        end = time.monotonic() + PATIENCE
        while any(publisher.get_subscription_count() < self.listeners for publisher in publishers):
            if time.monotonic() > end:
                raise InputError(f"the nodes do not listen after {PATIENCE:g} s")
            executor.spin_once(timeout_sec=0.05)
        if self.listeners:
            time.sleep(1.0)  # who is counted may still be about to hear
        parts = 1 if self.shared else GROUPS
        groups = [range(group, self.count, parts) for group in range(parts)]
        step = 1.0 / BLOCK_RATE / parts
        self._begin, begin, used = time.monotonic(), time.time_ns(), time.process_time()
        for turn in range(round(self.seconds * BLOCK_RATE) * parts):
            number, group = divmod(turn, parts)
            self.blocks = number + 1 if group == parts - 1 else number
            due = self._begin + (turn + 1) * step
            self.late = max(self.late, time.monotonic() - due)
            if self.late > LONGEST_BEHIND:
                break  # no processor is left: what was seen until now is the result
            while (left := due - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left)
            # Stamped by the clock of the acquisition: how busy this process is changes no stamp.
            first = begin + round(1e9 * ((turn + 1) * step - 1.0 / BLOCK_RATE))
            seconds, nanoseconds = divmod(first, 1_000_000_000)
            for valve in groups[group]:
                self.sent[valve][number % 1000] = time.monotonic()
                if valve == 0 or not self.shared:
                    message = messages[(number + self.shift * valve) % len(messages)]
                    struct.pack_into("<iI", message, 4, seconds, nanoseconds)
                    struct.pack_into("<Q", message, at, number)
                    publishers[valve].publish(self._of_all(message) if self.shared else bytes(message))
        self.cores = (time.process_time() - used) / (time.monotonic() - self._begin)
        executor.spin_once(timeout_sec=0.5)
        executor.shutdown()
        rclpy.shutdown()

    def _of_all(self, message: bytearray) -> bytes:
        """Return one message that has this block for each valve."""
        names = [f"valve_{valve + 1}" for valve in range(self.count)]
        blocks = [deserialize_message(bytes(message), AccelerationBlock)] * self.count
        return bytes(serialize_message(AccelerationBlocks(names=names, blocks=blocks)))

    def _messages(self) -> tuple[list[bytearray], int]:
        """Return a run's blocks as CDR and where the sequence stands in each."""
        noisy = Sensor(noise=0.03)
        source = Simulator(
            find_valve(VALVE),
            PRESETS["multisine"],
            coulomb_force=0.2,
            sample_rate=SAMPLE_RATE,
            block_size=round(SAMPLE_RATE / BLOCK_RATE),
            seed=1,
            body_sensor=noisy,
            spool_sensor=noisy,
        )
        found = [
            bytearray(serialize_message(from_block(block, VALVE))) for block in source.records(self.seconds)
        ]
        (length,) = struct.unpack_from("<I", found[0], 12)
        return found, ((12 + length + 7) & ~7) + 4

    def _heard(self, valve: int, message: ModelEstimate) -> None:
        now = time.monotonic()
        self.lost[valve] = message.lost_blocks
        self.delay = message.delay
        self.first.setdefault(valve, now)
        if message.state == ModelEstimate.STATE_TRACKING:
            self.tracking.setdefault(valve, now - self._begin)
        age = now - self.sent[valve][message.last_sequence % 1000]
        if 0.0 <= age < 10.0:
            (self.ages if now - self.first[valve] > self.run_in else self.start_ages).append(age)

    def _raised(self, event: HealthEvent) -> None:
        self.silences += event.code == SILENCE and event.state == HealthEvent.STATE_RAISED

    def _diagnosed(self, message: DiagnosticArray) -> None:
        running_in = len(self.tracking) < self.count
        for status in message.status:
            if status.name.startswith("host") and status.name.endswith(": host"):
                waits = [float(one.value) for one in status.values if one.key == "longest_wait_s"]
                key = "start" if running_in else "later"
                self.longest_wait[key] = max([self.longest_wait[key], *waits])

    def to_dict(self) -> dict[str, object]:
        """Return what was seen, times in s."""

        def quantile(ages: list[float], share: float) -> float | None:
            return float(np.quantile(ages, share)) if ages else None

        return {
            "blocks": self.blocks,
            "estimates": len(self.ages),
            "p50_s": quantile(self.ages, 0.5),
            "p99_s": quantile(self.ages, 0.99),
            "worst_at_start_s": quantile(self.start_ages, 1.0),
            "wait_at_start_s": self.longest_wait["start"],
            "wait_later_s": self.longest_wait["later"],
            "tracking": len(self.tracking),
            "all_tracking_s": max(self.tracking.values(), default=None),
            "first_heard_s": min(self.first.values(), default=math.nan) - self._begin,
            "lost": sum(self.lost.values()),
            "longest_late_s": self.late,
            "delay_s": self.delay,
            "source_cores": self.cores,
            "silences": self.silences,
        }


def family(process: int) -> list[int]:
    """Return ``process`` and all that it started."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii").split()
    return [process, *(one for child in children for one in family(int(child)))]


def processor_time(process: int) -> float:
    """Return user and system time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(process: int) -> tuple[int, int]:
    """Return the memory of a process, B: its share of what it shares, and all that is resident."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii").splitlines()[1:]
    found = {name: 1024 * int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines)}
    return found["Pss"], found["Rss"]


@contextmanager
def sending(
    folder: Path, count: int, seconds: float, **more: float
) -> Iterator[Callable[[], dict[str, Any]]]:
    """Run this module as a process that is ended at the end; yield a wait for what it saw.

    ``more`` are further fields of ``ValveSource``. Where processors are busy the process begins late.

    Raises:
        InputError: it failed, or does not end.
    """
    report = folder / "report.json"
    options = json.dumps({"count": count, "seconds": seconds, **more})
    with (folder / "source.log").open("wb") as log:
        source = subprocess.Popen(
            [sys.executable, "-m", __name__, str(report), options], stdout=log, stderr=log
        )

    def saw() -> dict[str, Any]:
        try:
            source.wait(timeout=seconds + LONGEST_BEHIND + 2.0 * PATIENCE)
        except subprocess.TimeoutExpired:
            raise InputError("bench: this machine is too busy for the blocks; try fewer --valves") from None
        if not report.exists():
            raise InputError(f"bench: the source of blocks failed: {last_words(folder / 'source.log')}")
        seen: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
        return seen

    try:
        yield saw
    finally:
        source.kill()
        source.wait()


def last_words(log: Path) -> str:
    """Return the end of a log."""
    return log.read_text(encoding="utf-8", errors="replace").strip()[-300:]


def main(file: str, options: str) -> None:
    """Send, then write what was seen."""
    source = ValveSource(**json.loads(options))
    source.run()
    Path(file).write_text(json.dumps(source.to_dict()), encoding="utf-8")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except InputError as error:
        sys.exit(str(error))
