"""Block hub: one subscription of a topic for all nodes of a process, decoded once, without copies."""

from __future__ import annotations

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
    """Times of a topic's blocks: messages that came and, s, the longest wait for their turn lately."""

    messages: int = 0
    longest_wait: float = 0.0
    longest_work: float = 0.0


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

        def hear(data: bytes) -> None:
            if worker is None:
                self._run(topic, (data, 0.0))
            else:
                worker.put(node, lambda item: self._run(topic, item), (data, time.monotonic()))

        topic.owner = node
        topic.subscription = node.create_subscription(AccelerationBlock, topic.name, hear, profile, raw=True)

    @staticmethod
    def _run(topic: _Topic, item: tuple[bytes, float]) -> None:
        data, heard = item
        begin = time.monotonic()
        topic.times.messages += 1
        if heard:
            topic.times.longest_wait = max(topic.times.longest_wait, begin - heard)
        try:
            block = decode_block(data)
        except CdrError as error:
            topic.owner.get_logger().warning(f"{topic.name}: a message is no block: {error}")
            return
        for _, take in tuple(topic.takers):
            take(block)
        topic.times.longest_work = max(topic.times.longest_work, time.monotonic() - begin)


#: Hub of this process.
HUB = BlockHub()
