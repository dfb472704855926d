"""Block hub: one subscription of a topic for all nodes of a process, decoded once, without copies."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from spool_msgs.msg import AccelerationBlock
from spool_stream.block import Block
from spool_stream.format.cdr import CdrError, decode_block

from . import qos
from .worker import Worker

#: Blocks of a topic that may wait in a process that hosts many nodes: five seconds at 50 blocks/s.
HOSTED_DEPTH = 250
Take = Callable[[Block], None]


@dataclass(slots=True)
class TopicTimes:
    """Times of a topic's blocks in a process that hosts many nodes.

    Attributes:
        messages, late: that came since the start; those done with later than a period after they came.
        work: s, of the worker thread, since the start.
        longest_wait: s, from a message's coming to its turn, since this was last read.
        age: s, from a block's last sample to its turn, by both clocks; the last one.
        blocks_lost: by jumps of the sequence.
        waiting: messages whose turn has not come.
    """

    messages: int = 0
    waiting: int = 0
    late: int = 0
    work: float = 0.0
    longest_wait: float = 0.0
    age: float = 0.0
    blocks_lost: int = 0
    sequence: int = -1
    _told: tuple[int, int, int, float] = (0, 0, 0, 0.0)

    def since(self) -> TopicTimes:
        """Return messages, late and lost ones, and work since the last call."""
        now = self.messages, self.late, self.blocks_lost, self.work
        before, self._told = self._told, now
        messages, late, lost, work = (one - other for one, other in zip(now, before, strict=True))
        return TopicTimes(int(messages), late=int(late), blocks_lost=int(lost), work=work)

    def take(self, block: Block, heard: float, begun: float, done: float) -> None:
        """Count a block that was heard, begun and done at these times of the monotonic clock."""
        self.messages += 1
        self.work += done - begun
        self.longest_wait = max(self.longest_wait, begun - heard)
        length = len(block.body) * block.sample_period
        if math.isfinite(length):  # else it is refused
            self.late += done - heard > length > 0.0
            self.age = time.time() - (done - begun) - 1e-9 * block.stamp - length
        if self.sequence >= 0:
            self.blocks_lost += max(0, block.sequence - self.sequence - 1)
        self.sequence = block.sequence


@dataclass(slots=True)
class _Topic:
    name: str
    takers: list[tuple[Any, Take]] = field(default_factory=list)
    subscription: Any = None
    owner: Any = None
    times: TopicTimes = field(default_factory=TopicTimes)


class BlockHub:
    """Block hub of a process.

    Attributes:
        worker: runs what nodes do with their blocks; ``None`` in a process of one node, which does it itself.
    """

    def __init__(self) -> None:
        self.worker: Worker | None = None
        self._topics: dict[str, _Topic] = {}

    @property
    def times(self) -> dict[str, TopicTimes]:
        """Times by topic."""
        return {name: topic.times for name, topic in self._topics.items()}

    def subscribe(self, node: Any, name: str, take: Take) -> Callable[[], None]:
        """Let ``take`` have each block of the topic ``name`` of ``node``; return what ends it."""
        resolved = node.resolve_topic_name(name)
        topic = self._topics.setdefault(resolved, _Topic(resolved))
        topic.takers.append((node, take))
        if topic.owner is None:
            self._own(topic, node)

        def end() -> None:
            topic.takers.remove((node, take))
            if topic.owner is node:
                node.destroy_subscription(topic.subscription)
                topic.owner = topic.subscription = None
                if topic.takers:
                    self._own(topic, topic.takers[0][0])

        return end

    def _own(self, topic: _Topic, node: Any) -> None:
        worker = self.worker
        profile = qos.samples_wanted(HOSTED_DEPTH) if worker is not None else qos.samples_wanted()

        run = functools.partial(self._run, topic)

        def hear(data: bytes) -> None:
            if worker is None:
                run((data, 0.0))
            else:
                topic.times.waiting += 1
                worker.put(node, run, (data, time.monotonic()))

        topic.owner = node
        topic.subscription = node.create_subscription(AccelerationBlock, topic.name, hear, profile, raw=True)

    @staticmethod
    def _run(topic: _Topic, item: tuple[bytes, float]) -> None:
        data, heard = item
        topic.times.waiting -= bool(heard)
        begun = time.monotonic()
        try:
            block = decode_block(data)
        except CdrError as error:
            topic.owner.get_logger().warning(f"{topic.name}: a message is no block: {error}")
            return
        for _, take in tuple(topic.takers):
            take(block)
        if heard:
            topic.times.take(block, heard, begun, time.monotonic())


#: Hub of this process.
HUB = BlockHub()
