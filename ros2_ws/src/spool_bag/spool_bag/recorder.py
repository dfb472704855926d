"""What is recorded: topics and their queue, and whether the valve is watched meanwhile."""

from __future__ import annotations

import enum
import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Qos
from spool_core.errors import InputError
from spool_core.system import expanded

from spool_bag.metadata import ACCELERATION_BLOCK, ACCELERATION_BLOCKS, FLOAT64, TEMPERATURE

DIAGNOSTICS = "/diagnostics"
#: Changes of limits belong to what was judged by them.
PARAMETER_EVENTS = "/parameter_events"
TOPICS = {
    "acceleration": ACCELERATION_BLOCK,
    "estimate": "spool_msgs/msg/ModelEstimate",
    "health": "spool_msgs/msg/ValveHealth",
    "events": "spool_msgs/msg/HealthEvent",
    "valve": "spool_msgs/msg/ValveDescription",
    "refit": "spool_msgs/msg/WindowRefit",
    "gap": "spool_msgs/msg/GapAnalysis",
    "oil_temperature": TEMPERATURE,
    "speed": FLOAT64,
    "command": FLOAT64,
}
#: Topics that the suite's nodes offer latched.
LATCHED = ("estimate", "health", "events", "valve", "refit", "gap")
#: What makes a namespace a valve; an oil temperature alone may be anybody's.
MARKS = ("acceleration", "estimate", "health", "events")

#: Times the blocks that fit into the time that the stamps say went by, and blocks on top, that can be lost:
#: clocks and block lengths vary, but not by more.
LIKELY, SLACK = 3.0, 100.0

#: B that a message costs in the queue besides its own, and waiting messages that wake the consumer.
OVERHEAD, WAKE = 300, 1000

#: s between two messages of a monitor's health are 1: five that are missing are no jitter of a busy machine.
SILENT = 5.0
#: s that a monitor may take to start: kernels of several nodes may be compiled, one after the other.
STARTS = 180.0
#: s after which acceleration no longer counts as flowing.
FLOWS = 2.0


def valve_namespaces(graph: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the namespaces (``/valve_1``) in which a topic of ours with our type lives.

    ``graph`` holds the types by topic, as ROS 2 tells them.
    """
    found = set()
    for topic, types in graph.items():
        namespace, _, name = topic.rpartition("/")
        if name in MARKS and TOPICS[name] in types:
            found.add(namespace)
    return sorted(found)


def select_topics(graph: Mapping[str, Sequence[str]], valves: Sequence[str] = ()) -> dict[str, str]:
    """Return the type by topic of everything to be recorded.

    That is every visible topic in the namespaces of the valves (``valves`` without leading slash, or those
    found where it is empty), those with blocks of many valves, ``/diagnostics`` and ``/parameter_events``.
    The topics of named valves belong to it before anybody publishes on them, so that not one block is missed.
    A topic with several types is left out.
    """
    namespaces = [f"/{valve.strip('/')}" for valve in valves] or valve_namespaces(graph)
    chosen = {
        f"{namespace}/{name}": kind for namespace in namespaces for name, kind in TOPICS.items() if valves
    }
    for topic, types in graph.items():
        hidden = any(part.startswith("_") for part in topic.split("/"))
        if hidden or len(types) != 1:
            continue
        # Everything would be inside the root: of a valve without namespace only the known topics count.
        inside = any(
            topic.startswith(f"{namespace}/") if namespace else topic.lstrip("/") in TOPICS
            for namespace in namespaces
        )
        if topic in (DIAGNOSTICS, PARAMETER_EVENTS) or types[0] == ACCELERATION_BLOCKS or inside:
            chosen[topic] = types[0]
    return dict(sorted(chosen.items()))


@dataclass(slots=True)
class LossCount:
    """Blocks that never arrived, by topic, from jumps in ``sequence``.

    A jump that is far beyond what the stamps say went by is a wrong number, not a loss. Where the next block
    goes on from there it is another source, of which nothing is lost. A block that goes on from before a jump
    shows that nothing was lost there: two sources send, or blocks changed places.
    """

    lost: dict[str, int] = field(default_factory=dict)
    _last: dict[str, _LastBlock] = field(default_factory=dict)
    _left: dict[str, _LastBlock] = field(default_factory=dict)
    _doubted: dict[str, int] = field(default_factory=dict)

    def take(self, topic: str, sequence: int, stamp: int) -> bool:
        """Count a block with its ``stamp`` (ns); return whether others were lost before it."""
        last = self._last.get(topic)
        if last is None:
            self.lost.setdefault(topic, 0)
            self._last[topic] = _LastBlock(sequence, stamp)
            return False
        jump = sequence - last.sequence - 1
        if jump == 0 and not self._doubted:  # as nearly all are
            if stamp > last.stamp:
                last.step = float(stamp - last.stamp)
            last.sequence, last.stamp = sequence, stamp
            return False
        left = self._left.get(topic)
        if left is not None and sequence == left.sequence + 1:
            self.lost[topic] -= left.missed
            self._left[topic] = last
            self._last[topic] = _LastBlock(sequence, stamp, last.step)
            return False
        # What can have been lost since then, by the stamps.
        likely = 0.0 if math.isnan(last.step) else LIKELY * max(stamp - last.stamp, 0) / last.step
        if jump > SLACK + likely:
            if self._doubted.get(topic) != sequence - 1:
                self._doubted[topic] = sequence
                return False
            jump = 0
        self._doubted.pop(topic, None)
        missed = max(jump, 0)
        self.lost[topic] += missed
        if sequence != last.sequence + 1:
            self._left[topic] = _LastBlock(last.sequence, last.stamp, missed=missed)
        elif stamp > last.stamp:
            last.step = float(stamp - last.stamp)
        last.sequence, last.stamp = sequence, stamp
        return missed > 0


def new_bag(
    output: str,
    now: datetime | None = None,
    activation: int = 0,
    *,
    number: bool = False,
    resume: bool = False,
) -> Path:
    """Return where to record: ``output``, or ``recording_<UTC time>`` in the working directory.

    From the second ``activation`` (1) on a number is put behind ``output``; with ``number`` also where the
    place is taken, the first one that is free. With ``resume`` it is ``output``, whatever is there.

    Raises:
        InputError: the place is taken.
    """
    moment = now or datetime.now(timezone.utc)
    name = output or f"recording_{moment:%Y%m%dT%H%M%S}Z"
    if resume and output:
        return expanded(name)
    path = expanded(name if activation == 0 else f"{name.rstrip('/')}_{activation}")
    while number and path.exists():
        activation += 1
        path = expanded(f"{name.rstrip('/')}_{activation}")
    if path.exists():
        raise InputError(f"output: {path} exists already: name a bag that does not, or remove it")
    return path


class Recorded(NamedTuple):
    """Message as received: ``received`` and ``published`` in ns, ``data`` its CDR."""

    topic: str
    kind: str
    received: int
    published: int
    data: bytes
    latched: bool = False
    qos: Sequence[Qos] = ()

    @property
    def cost(self) -> int:
        """B that it takes in the queue."""
        return len(self.data) + OVERHEAD


class MessageQueue:
    """Queue of at most ``largest`` B from any thread to one consumer.

    A message that was taken stays known until it is :meth:`confirmed`, so that a failed disk costs nothing:
    :meth:`take_back` puts all that was not confirmed at the head again. The consumer looks by itself every
    tenth of a second: to wake it for each message would cost more than to write it. ``WAKE`` messages wake
    it. The newest message of each latched topic finds room even if the queue is full: it is sent but once.
    """

    def __init__(self, largest: int) -> None:
        self.largest = largest
        self.messages = self.bytes = 0
        self._ahead: deque[Recorded] = deque()
        self._taken: deque[Recorded] = deque()
        self._newest: dict[str, Recorded] = {}
        self._in = self._out = 0
        self._changed = threading.Condition()

    @property
    def waiting(self) -> int:
        """B of messages that are not on the disk."""
        return self._in - self._out

    def put(self, message: Recorded) -> Recorded | None:
        """Append a message; return the one there is no room for: it, or one that it replaces."""
        cost = len(message.data) + OVERHEAD
        with self._changed:
            full = self._in - self._out + cost > self.largest
            if full and not message.latched:
                return message
            self._in += cost
            older = self._newest.pop(message.topic, None) if message.latched else None
            if older is not None:
                self._in -= older.cost
            if full:
                self._newest[message.topic] = message
            else:
                self._ahead.append(message)
            if len(self._ahead) == WAKE:
                self._changed.notify()
        return older

    def wake(self) -> None:
        """Wake the consumer."""
        with self._changed:
            self._changed.notify()

    def wait(self, timeout: float) -> None:
        """Wait ``timeout`` s, or until ``WAKE`` messages wait or :meth:`wake` is called."""
        with self._changed:
            if len(self._ahead) < WAKE:
                self._changed.wait(timeout)

    def take(self) -> Recorded | None:
        """Return the next message, ``None`` where there is none."""
        if not self._ahead:
            if not self._newest:
                return None
            with self._changed:
                self._ahead.extend(self._newest.values())
                self._newest.clear()
        message = self._ahead.popleft()
        self._taken.append(message)
        return message

    def confirmed(self, count: int) -> list[Recorded]:
        """Forget the first ``count`` messages that were taken, and return them: they are on the disk."""
        gone = self.uncertain(count)
        self.messages += count
        self.bytes += sum(len(message.data) for message in gone)
        return gone

    def drop(self) -> None:
        """Forget the message that was taken last: it cannot be recorded."""
        self._out += self._taken.pop().cost

    def uncertain(self, count: int) -> list[Recorded]:
        """Forget the first ``count`` messages that were taken, and return them: they may be on the disk."""
        gone = [self._taken.popleft() for _ in range(count)]
        self._out += sum(message.cost for message in gone)
        return gone

    def take_back(self) -> None:
        """Put all that was not confirmed at the head of the queue."""
        with self._changed:
            self._ahead.extendleft(reversed(self._taken))
        self._taken.clear()

    def clear(self) -> list[Recorded]:
        """Return all that is not on the disk, and forget it."""
        self.take_back()
        rest = [*self._ahead, *self._newest.values()]
        self._ahead.clear()
        self._newest.clear()
        self._out += sum(message.cost for message in rest)
        return rest


class Monitored(enum.Enum):
    """State of supervision of a valve; the value is the text people read."""

    YES = "monitored"
    NOT_YET = "not monitored yet: no health message since data arrived"
    NO = "not monitored"
    IDLE = "no data"


@dataclass(slots=True)
class MonitoringWatch:
    """Watchdog of the monitors: which valves nobody monitors, by what arrives of each; times in steady s."""

    _valves: dict[str, _Heard] = field(default_factory=dict)

    def saw_data(self, valve: str, now: float) -> None:
        """Record that acceleration of ``valve`` arrived at ``now`` (s)."""
        heard = self._valves.setdefault(valve, _Heard())
        if now - heard.data > FLOWS:
            heard.since = now
        heard.data = now

    def saw_health(self, valve: str, now: float) -> None:
        """Record that the health of ``valve`` arrived at ``now`` (s)."""
        self._valves.setdefault(valve, _Heard()).health = now

    def states(self, now: float) -> dict[str, Monitored]:
        """Return the state of each valve that was heard of.

        A monitor that was heard and is silent is missed whether or not data flow: it tells of silence, too.
        """
        return {valve: heard.state(now) for valve, heard in self._valves.items()}


@dataclass(slots=True)
class _LastBlock:
    sequence: int
    stamp: int
    step: float = math.nan
    missed: int = 0


@dataclass(slots=True)
class _Heard:
    data: float = -math.inf
    since: float = math.inf
    health: float | None = None

    def state(self, now: float) -> Monitored:
        if self.health is not None:
            return Monitored.NO if now - self.health > SILENT else Monitored.YES
        if now - self.data > FLOWS or now - self.since <= SILENT:
            return Monitored.IDLE
        return Monitored.NO if now - self.since > STARTS else Monitored.NOT_YET
