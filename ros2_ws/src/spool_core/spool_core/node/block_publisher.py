"""Block publisher: a source's blocks, to nodes of the same process as they are, to others as messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from spool_msgs.msg import AccelerationBlock

from spool_core.block import Block

from . import qos
from .block_hub import HUB
from .messages import from_block


class BlockPublisher:
    """Block publisher of a managed node; it sends while the node is active.

    Nodes of this process have the samples themselves, which nobody may change afterwards; while it is there
    they listen to no other publisher of the topic. A message is made only where another process listens.
    """

    def __init__(self, node: Any, topic: str, blocks_per_second: float) -> None:
        self._node = node
        self._publisher = node.create_lifecycle_publisher(
            AccelerationBlock, topic, qos.samples_offered(blocks_per_second)
        )
        self._topic = node.resolve_topic_name(topic)
        self._there = True
        HUB.offer(self._topic)

    @property
    def listeners(self) -> int:
        """Number of nodes of this process and of subscriptions of others that listen."""
        return int(self._publisher.get_subscription_count()) + HUB.takers(self._topic)

    def publish(self, block: Block, valve_id: str) -> None:
        """Send ``block`` as one of the valve ``valve_id``."""
        if not self._publisher.is_activated:
            return
        if HUB.takers(self._topic):
            body, spool = (np.ascontiguousarray(one, dtype=np.float32) for one in (block.body, block.spool))
            HUB.hand_over(self._topic, replace(block, body=body, spool=spool, source=valve_id))
        if self._publisher.get_subscription_count():
            self._publisher.publish(from_block(block, valve_id))

    def destroy(self) -> None:
        """Send no more; nodes of this process listen to other publishers again. Once more does nothing."""
        if not self._there:
            return
        self._there = False
        HUB.withdraw(self._topic)
        self._node.destroy_publisher(self._publisher)
