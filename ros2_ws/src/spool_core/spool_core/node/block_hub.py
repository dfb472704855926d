"""Blocks between nodes: heard once a process, worked on in a thread, published."""

from __future__ import annotations

import contextlib
import ctypes
import math
import queue
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from spool_msgs.msg import AccelerationBlock, AccelerationBlocks

from spool_core.block import Block
from spool_core.block_gate import LONGEST_PERIOD, SHORTEST_PERIOD, Fault, departure, place_of
from spool_core.cdr import CdrError, decode_block, decode_blocks
from spool_core.node import qos
from spool_core.node.messages import from_block
from spool_core.system import ThreadTimes, thread_times

#: Blocks of a topic that may wait in a process that hosts many nodes: five seconds at 50 blocks/s.
HOSTED_DEPTH = 250
#: s of samples that are taken together at most, where more wait: cores take less than 0.5 s at a time.
LONGEST_TOGETHER = 0.4
#: s of samples of a valve that may wait: beyond, all but the newest :data:`LONGEST_TOGETHER` s are dropped:
#: what is judged stays near real time. Twice what is taken together, and room for a turn of all valves.
LONGEST_BEHIND = 1.0
Take = Callable[[Sequence[Block]], None]
Room = Callable[[], int]
#: Message as it came, or a block that a source in this process handed over.
Heard = bytes | Block


class BlockHub:
    """Block hub of a process.

    In a process that hosts many nodes a valve's blocks wait for each other, up to ``together`` s of samples,
    and no longer than until an estimate falls due: taken together they cost little more than one.

    Attributes:
        worker: runs what nodes do with their blocks; ``None`` in a process of one node, which does it itself.
        together: s.
        starting: whether this process starts, and loses nothing by what it drops.
    """

    def __init__(self) -> None:
        self.worker: Worker | None = None
        self.together = 0.0
        self.starting = False
        self._topics: dict[str, _Topic] = {}
        self._shared: _Topic | None = None

    @property
    def times(self) -> dict[str, TopicTimes]:
        """Times by topic."""
        for topic in self._topics.values():
            topic.times.waiting = len(topic.heard)
        return {name: topic.times for name, topic in self._topics.items()}

    @property
    def behind(self) -> float:
        """Samples of a topic that wait, beyond those that wait for each other; the most of a topic, s."""
        return max((one.behind for one in tuple(self._topics.values())), default=0.0)

    def share(self, node: Any, name: str) -> None:
        """Hear the topic ``name`` of ``node``, whose messages have blocks of many valves, by their names.

        Each counts as if it had come by itself on the topic ``acceleration`` of its valve.
        """
        self._shared = _Topic(node.resolve_topic_name(name), owner=node)
        self._shared.mailbox = node.open_mailbox(AccelerationBlocks, name, qos.samples_wanted(HOSTED_DEPTH))

    def subscribe(self, node: Any, name: str, take: Take, room: Room) -> Callable[[], None]:
        """Pass the blocks of the topic ``name`` of ``node`` to ``take``; return a call that ends this.

        They wait for each other until ``room()`` samples have come.
        """
        resolved = node.resolve_topic_name(name)
        topic = self._topics.setdefault(resolved, _Topic(resolved))
        taker = (node, take, room)
        topic.takers.append(taker)
        if topic.owner is None:
            topic.heard.clear()
            topic.dropped = 0
            topic.times.last = None  # what was not wanted meanwhile is not lost
            self._own(topic, node)
        return lambda: self._end(topic, taker)

    def give_up(self, node: Any) -> None:
        """Remove ``node``, which hangs, from its topics, so that other nodes get their blocks."""
        for topic in self._topics.values():
            for taker in [one for one in topic.takers if one[0] is node]:
                self._end(topic, taker)

    def _end(self, topic: _Topic, taker: tuple[Any, Take, Room]) -> None:
        if taker not in topic.takers:
            return  # it was given up
        topic.takers.remove(taker)
        if topic.owner is taker[0]:
            self._unsubscribe(topic)
            topic.owner = None
            if topic.takers:
                self._own(topic, topic.takers[0][0])

    def collect(self) -> None:
        """Hear what came, in a process that hosts many nodes; its host does that every few ms."""
        now = time.monotonic()
        if self._shared is not None:
            for data in self._shared.mailbox.empty():
                self._hear_each(self._shared, data)
        for topic in self._topics.values():
            if topic.mailbox is None or now < topic.due:
                continue
            for data in topic.mailbox.empty():
                self._hear(topic, data)
            # No turn can be due before, and each look costs a few us.
            topic.due = now + (topic.together - len(topic.heard) - 1) * topic.period

    def waits(self, node: Any, name: str) -> bool:
        """Whether blocks of the topic ``name`` of ``node`` came whose turn has not come or is not over."""
        topic = self._topics.get(node.resolve_topic_name(name))
        return topic is not None and (bool(topic.heard) or topic.busy)

    def flush(self, waited: float) -> None:
        """Process blocks that have waited for others for more than ``waited`` s."""
        before = time.monotonic() - waited
        for topic in self._topics.values():
            with contextlib.suppress(IndexError):  # the worker took them meanwhile
                if topic.heard[0][1] < before and not topic.busy:
                    self._ask(topic)

    def offer(self, name: str) -> None:
        """Take the blocks of the full topic ``name`` from a source of this process only."""
        topic = self._topics.setdefault(name, _Topic(name))
        topic.local = True
        self._unsubscribe(topic)

    def withdraw(self, name: str) -> None:
        """Listen to the topic ``name`` again: its source in this process ends."""
        topic = self._topics[name]
        if not topic.local:
            return
        topic.local = False
        if topic.owner is not None:
            self._own(topic, topic.owner)

    def takers(self, name: str) -> int:
        """Return how many nodes of this process take the blocks of topic ``name``."""
        topic = self._topics.get(name)
        return len(topic.takers) if topic is not None else 0

    def hand_over(self, name: str, block: Block) -> None:
        """Pass ``block`` to the subscribers of topic ``name`` as if it had come as a message."""
        topic = self._topics[name]
        if topic.owner is not None:
            self._hear(topic, block)

    def _own(self, topic: _Topic, node: Any) -> None:
        topic.together, topic.busy = 1, False
        topic.owner = node
        if topic.local:
            return
        if self.worker is None:
            # A clock that is played may run faster than a busy consumer reads for a moment.
            played = node.get_parameter("use_sim_time").value
            quality = qos.samples_wanted(HOSTED_DEPTH) if played else qos.samples_wanted()
            topic.subscription = node.create_subscription(
                AccelerationBlock, topic.name, partial(self._hear, topic), quality, raw=True
            )
        else:
            topic.mailbox = node.open_mailbox(AccelerationBlock, topic.name, qos.samples_wanted(HOSTED_DEPTH))
            topic.subscription, topic.due = topic.mailbox.subscription, 0.0

    @staticmethod
    def _unsubscribe(topic: _Topic) -> None:
        if topic.subscription is not None:
            topic.owner.destroy_subscription(topic.subscription)
            topic.subscription = topic.mailbox = None

    def _hear_each(self, shared: _Topic, data: bytes) -> None:
        try:
            blocks = decode_blocks(data)
        except CdrError as error:
            _ignored(shared, error)
            return
        for name, block in blocks:  # of a valve of another process as well
            topic = self._topics.get(f"/{name.strip('/')}/acceleration")
            if topic is not None and topic.owner is not None and not topic.local:
                self._hear(topic, block)

    def _hear(self, topic: _Topic, data: Heard) -> None:
        if self.worker is None:
            self._take(topic, [data])
            return
        topic.heard.append((data, time.monotonic()))
        if len(topic.heard) >= topic.together and not topic.busy:
            self._ask(topic)

    def _ask(self, topic: _Topic) -> None:
        owner = topic.owner  # another thread may end it between two looks
        if owner is not None and self.worker is not None:
            topic.busy = True
            self.worker.put(owner, self._run, topic)

    def _run(self, topic: _Topic) -> None:
        try:
            due, begun = topic.together, time.monotonic()
            topic.times.longest_wait = max(topic.times.longest_wait, topic.behind)
            self._drop(topic)
            items: list[tuple[Heard, float]] = []
            while topic.heard and len(items) < topic.most:
                items.append(topic.heard.popleft())
            blocks = self._take(topic, [data for data, _ in items])
            if blocks:
                self._plan(topic, blocks[-1])
                # Those that stopped coming were asked for before they were due.
                asked = items[due - 1][1] if len(items) >= due else begun
                topic.times.take(blocks, asked, begun, time.monotonic())
        finally:
            topic.busy = False
        if len(topic.heard) >= topic.together:
            self._ask(topic)

    def _drop(self, topic: _Topic) -> None:
        """Drop all but the newest messages, undecoded, where too much waits."""
        waiting = len(topic.heard)
        if waiting < HOSTED_DEPTH and (waiting - 1) * topic.period <= LONGEST_BEHIND:
            return
        dropped = waiting - topic.most
        for _ in range(dropped):
            topic.heard.popleft()
        topic.dropped += -dropped if self.starting else dropped
        topic.times.dropped += dropped
        topic.times.seconds_dropped += dropped * topic.period

    def _plan(self, topic: _Topic, last: Block) -> None:
        """Say how many blocks are taken together the next time."""
        size, length = len(last.body), len(last.body) * last.sample_period
        if not (math.isfinite(length) and length > 0.0):
            topic.together = topic.most = 1
            return
        topic.period = length
        topic.most = max(1, int(LONGEST_TOGETHER / length))
        room = min((room() for _, _, room in tuple(topic.takers)), default=0)
        topic.together = max(1, min(int(self.together / length + 1e-6), -(-room // size), topic.most))

    @staticmethod
    def _take(topic: _Topic, messages: Sequence[Heard]) -> list[Block]:
        """Decode messages, let all takers have them, and return what they had."""
        blocks = []
        for data in messages:
            try:
                blocks.append(data if isinstance(data, Block) else decode_block(data))
            except CdrError as error:
                _ignored(topic, error)
        if blocks:
            if topic.dropped:
                blocks[0], topic.dropped = replace(blocks[0], dropped=topic.dropped), 0
            for _, take, _ in tuple(topic.takers):
                take(blocks)
        return blocks


def _ignored(topic: _Topic, error: CdrError) -> None:
    owner, count = topic.owner, topic.throttle.take("no block")
    if owner is not None and count:
        owner.get_logger().warning(f"{topic.name}: ignored {count} messages that are not blocks: {error}")


#: Owner of the job with which a worker ends.
_END = object()
_THREAD = threading.local()

#: s between two lines about the same: an operator's log of a day holds 8640 at most.
PERIOD = 10.0


@dataclass(slots=True)
class TopicTimes:
    """Times of a topic's blocks in a process that hosts many nodes.

    Attributes:
        messages, late: that came since the start; those done with later than a period after they were due.
        work: s, of the worker thread, since the start.
        longest_wait: s, from when blocks were due to their turn, since this was last read; they are due when
            the last one comes that the others wait for.
        age: s, from a block's last sample to its turn, by both clocks; the last one.
        blocks_lost: between a block and the one before, by the rule of the gate.
        dropped, seconds_dropped: messages that were dropped as too many waited, and their length, s.
        last: the newest block, ``None`` before any.
        waiting: messages whose turn has not come.
    """

    messages: int = 0
    waiting: int = 0
    late: int = 0
    work: float = 0.0
    longest_wait: float = 0.0
    age: float = 0.0
    blocks_lost: int = 0
    dropped: int = 0
    seconds_dropped: float = 0.0
    last: Block | None = None
    _told: tuple[int, int, int, float] = (0, 0, 0, 0.0)

    def since(self) -> TopicTimes:
        """Return messages, late and lost ones, and work since the last call."""
        now = self.messages, self.late, self.blocks_lost, self.work
        before, self._told = self._told, now
        messages, late, lost, work = (one - other for one, other in zip(now, before, strict=True))
        return TopicTimes(int(messages), late=int(late), blocks_lost=int(lost), work=work)

    def take(self, blocks: Sequence[Block], due: float, begun: float, done: float) -> None:
        """Count blocks that were due, begun and done at these times of the monotonic clock."""
        self.messages += len(blocks)
        self.work += done - begun
        self.longest_wait = max(self.longest_wait, begun - due)
        last = blocks[-1]
        length = len(last.body) * last.sample_period
        if math.isfinite(length):  # else it is refused
            self.late += len(blocks) if done - due > length > 0.0 else 0
            self.age = time.time() - (done - begun) - 1e-9 * last.stamp - length
        for block in blocks:
            if not SHORTEST_PERIOD <= block.sample_period <= LONGEST_PERIOD:
                continue  # it is refused
            last = self.last or block
            missing = block.sequence - last.sequence - 1
            if missing > 0 and departure(place_of(last), place_of(block)) is Fault.LOST:
                self.blocks_lost += missing
            self.last = block


class HangError(BaseException):
    """What runs for so long is broken off; no handler of exceptions may keep it."""


@dataclass(slots=True)
class _Job:
    """Job that runs: its owner, when it began, and for how long it had a processor or slept, s."""

    owner: object
    begun: float
    served: float = 0.0


def _spent(before: ThreadTimes | None, now: ThreadTimes | None) -> ThreadTimes | None:
    """Return what a thread has spent since ``before``, ``None`` where that is not known."""
    if before is None or now is None:
        return None
    return ThreadTimes(now.used - before.used, now.waited - before.waited, now.ready)


class Worker:
    """Worker that runs jobs in order, each for an owner.

    A job that does not return is given up with its thread: another thread goes on with the jobs of all other
    owners, and nothing of theirs is lost. A job hangs that was served for too long: it had a processor,
    or slept although it could have had one. What other programs keep from a processor does not.

    Attributes:
        done: jobs that returned.
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        times: Callable[[int], ThreadTimes | None] = thread_times,
    ) -> None:
        """Begin; ``clock`` and ``times`` say how late it is, s, and what a thread has used."""
        self.done = 0
        self._clock, self._times = clock, times
        self._looked = clock()
        self._busy_since = math.inf
        self._before: dict[int | None, ThreadTimes | None] = {}
        self._jobs: queue.SimpleQueue[tuple[object, Callable[[Any], None], Any]] = queue.SimpleQueue()
        self._current: _Job | None = None
        self._refused: set[int] = set()
        self._turn = threading.Lock()
        self._thread = self._begun()

    @property
    def waiting(self) -> int:
        """Number of jobs that wait."""
        return self._jobs.qsize()

    @property
    def busy(self) -> float:
        """Time since it last had nothing to do, s; 0 while it has nothing."""
        return max(0.0, self._clock() - self._busy_since)

    def put(self, owner: object, job: Callable[[Any], None], argument: Any) -> None:
        """Queue ``job(argument)``; jobs of an owner that hangs are dropped."""
        self._jobs.put((owner, job, argument))

    def look(self, most: float) -> None:
        """Count the time since the last look for the job that runs, ``most`` s at most.

        The time in which its thread waited for a processor, or the one that looks had one or waited for it,
        does not count.
        """
        now, looked, job = self._clock(), self._looked, self._current
        numbers = self._thread.native_id, threading.get_native_id()
        before, times = self._before, tuple(self._times(one) if one is not None else None for one in numbers)
        self._looked, self._before = now, dict(zip(numbers, times, strict=True))
        if job is None:
            return
        span = min(now - max(looked, job.begun), most)
        own, mine = (_spent(before.get(one), later) for one, later in zip(numbers, times, strict=True))
        if own is not None and mine is not None:
            # The wait of a thread that has no processor yet is counted when it gets one. One that sleeps may
            # wait for the interpreter, which the thread that looks holds meanwhile.
            waited = max(own.waited, mine.waited) + mine.used
            span = min(span, own.used) if own.ready else span - waited
        job.served += max(0.0, span)

    def hanging(self, longest: float) -> object | None:
        """Return the owner whose job was served for more than ``longest`` s, ``None`` where there is none."""
        job = self._current
        return job.owner if job is not None and job.served > longest else None

    def excuse(self, seconds: float) -> None:
        """Count the job that runs as hanging only in so many s."""
        if self._current is not None:
            self._current.served = -seconds

    def give_up(self, owner: object) -> bool:
        """Leave the job of ``owner`` that hangs, and go on with those of others.

        Return whether that was done: it may have returned just now.
        """
        with self._turn:
            if self._current is None or self._current.owner is not owner:
                return False
            self._refused.add(id(owner))
            left, self._current = self._thread, None
            self._thread = self._begun()
            if left.ident is not None:
                # In Python it ends at its next step; a kernel that never returns stays.
                number, end = ctypes.c_ulong(left.ident), ctypes.py_object(HangError)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(number, end)
            return True

    def admit(self, owner: object) -> None:
        """Take jobs of ``owner`` again."""
        self._refused.discard(id(owner))

    def close(self, timeout: float = 2.0) -> None:
        """Run what waits and end."""
        self.put(_END, lambda _: None, None)
        self._thread.join(timeout)

    def _begun(self) -> threading.Thread:
        thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread = thread
        thread.start()
        return thread

    def _run(self) -> None:
        me, _THREAD.worker = threading.current_thread(), self
        with contextlib.suppress(HangError):
            while True:
                if self._jobs.empty():
                    self._busy_since = math.inf
                owner, job, argument = self._jobs.get()
                self._busy_since = min(self._busy_since, self._clock())
                if owner is _END:
                    return
                if id(owner) in self._refused:
                    continue
                with self._turn:
                    self._current = _Job(owner, self._clock())
                try:
                    job(argument)
                except Exception:  # of what does not guard itself: the jobs of others go on
                    traceback.print_exc()
                with self._turn:  # a thread that was given up takes no further job: it is broken off
                    if self._thread is not me:
                        return
                    self._current = None
                    self.done += 1


@dataclass(slots=True)
class Throttle:
    """Passes the first of a kind and then one in ``period`` s, with how many there were between.

    ``clock`` gives s of a steady clock.
    """

    period: float = PERIOD
    clock: Callable[[], float] = time.monotonic
    _kept_back: dict[str, int] = field(default_factory=dict)
    _said: dict[str, float] = field(default_factory=dict)

    def take(self, kind: str) -> int:
        """Return how many of ``kind`` to tell of now, this one included; 0: none."""
        now = self.clock()
        count = self._kept_back.get(kind, 0) + 1
        if kind in self._said and now - self._said[kind] < self.period:
            self._kept_back[kind] = count
            return 0
        self._said[kind], self._kept_back[kind] = now, 0
        return count


@dataclass(slots=True)
class Silence:
    """Watched time without an arrival: while a process was held up, it could not have heard anything.

    Attributes:
        longest: s between two looks that count at most.
        seconds: of silence, at the last look.
    """

    longest: float
    seconds: float = 0.0
    _looked: float = field(default_factory=time.monotonic)

    def end(self) -> None:
        """Begin again: something arrived, or nothing could."""
        self.seconds, self._looked = 0.0, time.monotonic()

    def look(self) -> None:
        """Count the time since the last look."""
        now = time.monotonic()
        self.seconds += min(now - self._looked, self.longest)
        self._looked = now


@dataclass(slots=True)
class _Topic:
    """Topic of a valve's blocks: its takers, and the messages whose turn has not come with their times.

    ``together``: blocks that are taken together, and ``most`` of them; ``busy``: their turn is asked for;
    ``period``: s, between two blocks, 0 before any; ``due``: when to look into the mailbox again, s of the
    monotonic clock; ``local``: a source in this process hands its blocks over; ``dropped``: messages ahead of
    the first one that waits.
    """

    name: str
    takers: list[tuple[Any, Take, Room]] = field(default_factory=list)
    subscription: Any = None
    mailbox: Any = None
    owner: Any = None
    times: TopicTimes = field(default_factory=TopicTimes)
    heard: deque[tuple[Heard, float]] = field(default_factory=partial(deque, maxlen=HOSTED_DEPTH))
    together: int = 1
    most: int = 1
    busy: bool = False
    period: float = 0.0
    due: float = 0.0
    local: bool = False
    dropped: int = 0
    throttle: Throttle = field(default_factory=Throttle)

    @property
    def behind(self) -> float:
        """Samples that wait beyond those that wait for each other, s."""
        return max(0, len(self.heard) - self.together) * self.period


#: s that a job may wait for the disk, as state files on a slow one take seconds.
LONGEST_DISK = 30.0


@contextlib.contextmanager
def waiting_for_disk() -> Iterator[None]:
    """Say that the job of this thread waits for the disk meanwhile: it does not hang."""
    worker: Worker | None = getattr(_THREAD, "worker", None)
    if worker is not None:
        worker.excuse(LONGEST_DISK)
    try:
        yield
    finally:
        if worker is not None:
            worker.excuse(0.0)


class BlockPublisher:
    """Block publisher of a managed node; it sends while the node is active.

    Nodes of this process have the samples themselves, which nobody may change afterwards; while it is there
    they listen to no other publisher of the topic. A message is made only where another process listens.
    """

    def __init__(self, node: Any, topic: str, blocks_per_second: float) -> None:
        self._node = node
        self._hub: BlockHub = node.host.hub
        self._publisher = node.create_lifecycle_publisher(
            AccelerationBlock, topic, qos.samples_offered(blocks_per_second)
        )
        self._topic = node.resolve_topic_name(topic)
        self._there = True
        self._hub.offer(self._topic)

    @property
    def listeners(self) -> int:
        """Number of nodes of this process and of subscriptions of others that listen."""
        return int(self._publisher.get_subscription_count()) + self._hub.takers(self._topic)

    def publish(self, block: Block, valve_id: str) -> None:
        """Send ``block`` as one of the valve ``valve_id``."""
        if not self._publisher.is_activated:
            return
        if self._hub.takers(self._topic):
            body, spool = (np.ascontiguousarray(one, dtype=np.float32) for one in (block.body, block.spool))
            self._hub.hand_over(self._topic, replace(block, body=body, spool=spool, source=valve_id))
        if self._publisher.get_subscription_count():
            self._publisher.publish(from_block(block, valve_id))

    def destroy(self) -> None:
        """Send no more; nodes of this process listen to other publishers again. Again does nothing."""
        if not self._there:
            return
        self._there = False
        self._hub.withdraw(self._topic)
        self._node.destroy_publisher(self._publisher)
