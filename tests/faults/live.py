"""Faults of a recorder that runs: real processes over DDS, blocks of a valve at 2 kHz, real time."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from spool_bag.parts import numbered
from spool_bag.reader import BagReader
from spool_core.block import Block
from spool_core.node import qos
from spool_core.node.messages import from_block
from spool_msgs.msg import AccelerationBlock

from . import disk
from .disk import Disk
from .outcome import Outcome

TOPIC = "/valve_1/acceleration"
PERIOD, SIZE = 0.0005, 40
STEP = PERIOD * SIZE
#: s between faults: longer than a recorder needs to sync what it has, and to go on after a pause.
CALM = 2.5
PATIENCE = 180.0
#: s within which a message is heard.
HEARD = 0.3
#: s between two messages of a recorder on /diagnostics.
DIAGNOSTIC_PERIOD = 1.0
START = 1_700_000_000_000_000_000


def block(number: int, shift: int = 0) -> Block:
    """Return a block that tells its number by its samples; ``shift`` (ns) of its stamp."""
    rng = np.random.default_rng(number)
    samples = rng.standard_normal((2, SIZE)).astype(np.float32)
    return Block(START + round(number * STEP * 1e9) + shift, number, PERIOD, samples[0], samples[1])


class Source(threading.Thread):
    """Source of a valve's blocks: one every 20 ms, in real time; it remembers when each was sent."""

    def __init__(self, domain: int) -> None:
        super().__init__(daemon=True)
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node(f"source_{domain}", context=self.context)
        self.publisher = self.node.create_publisher(AccelerationBlock, TOPIC, qos.samples_offered(50))
        self.sent: dict[int, float] = {}
        self.contents: dict[int, bytes] = {}
        #: When a recorder said on /diagnostics that blocks were lost on the way, and how many.
        self.missed: list[tuple[float, int]] = []
        self._said = 0
        self._ears = SingleThreadedExecutor(context=self.context)
        self._ears.add_node(self.node)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, qos.diagnostics())
        self.twice: set[int] = set()
        #: Next blocks to send twice, to exchange, or with another stamp (s).
        self.repeat = self.exchange = 0
        self.shift = 0.0
        self._ending = threading.Event()
        self._listener = threading.Thread(target=self.listen, daemon=True)

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for pair in status.values:
                if pair.key == "blocks_lost_valve_1":
                    count = int(pair.value)
                    if count != self._said:
                        self.missed.append((time.monotonic(), count - self._said))
                    self._said = count

    def begin_anew(self) -> None:
        """Expect a recorder that is started, which counts from none."""
        self._said = 0

    def listen(self) -> None:
        """Receive the messages of /diagnostics."""
        while not self._ending.is_set():
            self._ears.spin_once(timeout_sec=0.2)

    def run(self) -> None:
        self._listener.start()
        number, due = 0, time.monotonic()
        while not self._ending.wait(max(due - time.monotonic(), 0.0)):
            order = [number]
            if self.exchange:
                self.exchange -= 1
                order = [number + 1, number]
            elif self.repeat:
                self.repeat -= 1
                self.twice.add(number)
                order = [number, number]
            for one in order:
                made = block(one, round(self.shift * 1e9))
                data = bytes(serialize_message(from_block(made, "valve_1")))
                self.publisher.publish(data)
                self.sent.setdefault(one, time.monotonic())
                self.contents[one] = made.body.tobytes()
            number += len(set(order))
            due += STEP * len(set(order))

    def wait(self, met: Callable[[], bool], timeout: float = PATIENCE) -> bool:
        """Wait until ``met``; return whether it was."""
        end = time.monotonic() + timeout
        while not met():
            if time.monotonic() > end or self._ending.wait(0.02):
                return False
        return True

    def heard(self) -> bool:
        """Wait until somebody listens."""
        return self.wait(lambda: self.publisher.get_subscription_count() > 0)

    def close(self) -> None:
        self._ending.set()
        self.join()
        self._listener.join()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@dataclass(slots=True)
class Injected:
    """Fault that was put on the recorder from ``begin`` to ``end`` (s, monotonic).

    ``down``: the process ended at ``begin`` and was started again at ``restart``.
    """

    fault: str
    begin: float
    end: float = 0.0
    down: bool = False
    restart: float = 0.0
    wrong: str = ""


@dataclass
class Session:
    """Recorder that meets one fault after the other, in ``folder`` and on a separate DDS ``domain``."""

    folder: Path
    domain: int
    seed: int
    faults: list[Injected] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.bag = self.folder / "bag"
        self.disk = Disk(self.bag, self.folder / "control")
        self.log = self.folder / "recorder.log"
        self.source = Source(self.domain)
        self.process = self.started()

    def started(self) -> subprocess.Popen[bytes]:
        """Start the recorder, as a machine does that is switched on."""
        parameters = {
            "output": self.bag,
            "resume": True,
            "valves": "[valve_1]",
            "max_part_duration": 3.0,
            "minimum_free_space": 1000,
            "snapshot_limit": 0,
        }
        arguments = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value!s}")]
        with self.log.open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "spool_bag.recorder_node", "--ros-args", *arguments],
                env={
                    **os.environ,
                    **self.disk.environment,
                    "ROS_DOMAIN_ID": str(self.domain),
                    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
                },
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def calm(self, seconds: float = CALM) -> None:
        """Let it record undisturbed for a while."""
        self.source.wait(lambda: False, seconds)

    def inject(self, fault: str) -> None:
        """Put a fault on the recorder and wait until it is over."""
        one = Injected(fault, time.monotonic())
        self.faults.append(one)
        FAULTS[fault](self, one)
        one.end = time.monotonic()

    def restarted(self, one: Injected) -> None:
        """Start the recorder again behind a fault that ended it."""
        one.down = True
        before = self._newest()
        self.calm(HEARD)  # the one that ended has said its last
        self.source.begin_anew()
        one.restart = time.monotonic()
        self.process = self.started()
        # A new part grows: it receives messages.
        if not self.source.wait(lambda: self._newest() > before and self._grows()):
            one.wrong = "it did not come back"

    def _newest(self) -> int:
        return max((number for number, _ in numbered(self.bag)), default=-1)

    def _grows(self) -> bool:
        path = numbered(self.bag)[-1][1]
        size = path.stat().st_size
        return self.source.wait(lambda: path.stat().st_size > size, 2.0)

    def close(self) -> list[Outcome]:
        """End the recorder and judge what it kept."""
        self.calm()
        self.disk.tell()
        self.process.send_signal(signal.SIGINT)
        try:
            code = self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        ended = time.monotonic()
        self.source.close()
        self.disk.close()
        outcomes = self.judged(ended)
        if code and outcomes:
            outcomes[-1] = Outcome(**{**_values(outcomes[-1]), "wrong": f"it ended with {code}"})
        return outcomes

    def judged(self, ended: float) -> list[Outcome]:
        """Return what each fault cost."""
        reader = BagReader(self.bag)
        kept: dict[int, int] = {}
        foreign = 0
        for one in reader.blocks("valve_1"):
            known = self.source.contents.get(one.sequence)
            foreign += known is None or known != one.body.tobytes()
            kept[one.sequence] = kept.get(one.sequence, 0) + 1
        for number, count in kept.items():
            foreign += max(count - 1 - (number in self.source.twice), 0)
        first = min(kept, default=0)
        missing = [
            number
            for number in sorted(self.source.sent)
            if number not in kept and number > first and self.source.sent[number] < ended - 1.0
        ]
        said = self.log.read_text(errors="replace", encoding="utf-8")
        stated = sum(int(line.split()[0]) for line in reader.warnings if "messages were not recorded" in line)
        unfinished = sum("not finished" in line for line in reader.warnings)
        heard = sorted(self.source.sent[number] for number in kept if number in self.source.sent)
        return self._shared_out(missing, heard, foreign, stated, unfinished, said.count("Traceback"))

    def _shared_out(
        self,
        missing: list[int],
        heard: list[float],
        foreign: int,
        stated: int,
        unfinished: int,
        tracebacks: int,
    ) -> list[Outcome]:
        """Give each fault what was lost from its begin to the next one's, the rest to the first."""
        outcomes = []
        begins = [one.begin for one in self.faults[1:]] + [float("inf")]
        for place, (one, following) in enumerate(zip(self.faults, begins, strict=True)):
            since = one.begin - CALM / 2 if place else 0.0
            until = following - CALM / 2
            own = [
                self.source.sent[number] for number in missing if since <= self.source.sent[number] < until
            ]
            # From the end of a process until the next one hears its first block nobody records.
            back = min((at for at in heard if at > one.restart), default=one.end)
            end = back if one.down else one.end
            counted = [at for at in own if not (one.down and one.begin <= at <= end)]
            # What a process that ends had not yet synced was lost backwards from its end; no other fault can.
            early = [at for at in counted if at < one.begin]
            before = one.begin - early[0] if early and one.down else len(early) * STEP
            after = max((at - end for at in counted if at > end), default=0.0)
            within = sum(one.begin <= at <= one.end for at in counted) * STEP
            told = bool(unfinished) if one.down else False
            missed = sum(
                count for at, count in self.source.missed if since <= at < until + 2.0 * DIAGNOSTIC_PERIOD
            )
            unstated = 0 if told else max(len(counted) - stated - missed, 0)
            stated = max(stated - len(counted), 0) if not told else stated
            first = place == 0
            outcomes.append(
                Outcome(
                    one.fault,
                    self.seed,
                    len(counted),
                    max(before, after, within),
                    unstated,
                    foreign if first else 0,
                    tracebacks if first else 0,
                    one.wrong,
                )
            )
        return outcomes


def _values(one: Outcome) -> dict[str, object]:
    return {name: getattr(one, name) for name in Outcome.__slots__}


def _killed(session: Session, one: Injected) -> None:
    session.process.kill()
    session.process.wait()
    session.restarted(one)


def _terminated_twice(session: Session, one: Injected) -> None:
    session.process.terminate()
    session.calm(session.random.uniform(0.0, 0.3))
    session.process.terminate()
    if session.process.wait(PATIENCE):
        one.wrong = f"it ended with {session.process.returncode}"
    session.restarted(one)


def _disk(mode: int) -> Callable[[Session, Injected], None]:
    def fail(session: Session, one: Injected) -> None:
        session.disk.tell(mode)
        session.calm(session.random.uniform(0.2, 3.0))
        session.disk.tell()
        session.calm(1.5)

    return fail


def _slow_sync(session: Session, one: Injected) -> None:
    session.disk.tell(sync_delay=session.random.uniform(0.5, 3.0))
    session.calm(session.random.uniform(3.0, 6.0))
    session.disk.tell()
    session.calm(3.0)


def _slow_writes(session: Session, one: Injected) -> None:
    session.disk.tell(write_delay=session.random.uniform(0.05, 0.8))
    session.calm(session.random.uniform(1.0, 4.0))
    session.disk.tell()
    session.calm(3.0)


def _clock_step(session: Session, one: Injected) -> None:
    session.disk.tell(clock=session.random.choice([-1, 1]) * session.random.choice([0.5, 5.0, 60.0, 3600.0]))
    session.calm(1.5)
    session.disk.tell()
    session.calm(1.0)


def _stamp_jump(session: Session, one: Injected) -> None:
    session.source.shift = session.random.choice([-3600.0, 3600.0, -1.0, 86400.0])
    session.calm(1.5)
    session.source.shift = 0.0


def _twice(session: Session, one: Injected) -> None:
    session.source.repeat = session.random.randint(1, 20)
    session.source.wait(lambda: session.source.repeat == 0)


def _exchanged(session: Session, one: Injected) -> None:
    session.source.exchange = session.random.randint(1, 20)
    session.source.wait(lambda: session.source.exchange == 0)


#: Faults by their names.
FAULTS: dict[str, Callable[[Session, Injected], None]] = {
    "kill -9": _killed,
    "SIGTERM twice": _terminated_twice,
    "disk full": _disk(disk.FULL),
    "input/output error": _disk(disk.BROKEN),
    "read-only disk": _disk(disk.READ_ONLY),
    "slow fsync": _slow_sync,
    "slow writes": _slow_writes,
    "clock step": _clock_step,
    "jump of stamps": _stamp_jump,
    "blocks twice": _twice,
    "blocks exchanged": _exchanged,
}


def session(folder: Path, domain: int, seed: int, count: int) -> list[Outcome]:
    """Put ``count`` faults, chosen by ``seed``, on one recorder, one after the other."""
    folder.mkdir(parents=True)
    one = Session(folder, domain, seed)
    names = list(FAULTS)
    chosen = [names[(seed * count + place) % len(names)] for place in range(count)]
    one.random.shuffle(chosen)
    try:
        # A named valve's topic is listened to from the first moment on, once it is discovered.
        one.source.wait(one.bag.exists)
        one.source.start()
        one.source.heard()
        one.calm()
        for fault in chosen:
            one.inject(fault)
            one.calm()
    finally:
        outcomes = one.close()
    return outcomes
