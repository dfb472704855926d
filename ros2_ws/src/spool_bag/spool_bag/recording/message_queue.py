"""Queue of messages on their way to the disk, bounded in bytes, with what the disk has not confirmed yet."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from rosbags.interfaces import Qos

#: B that a message costs in the queue besides its own.
OVERHEAD = 300


@dataclass(frozen=True, slots=True)
class Recorded:
    """Message to be recorded: ``received`` and ``published`` in ns, ``data`` its CDR."""

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
    :meth:`take_back` puts all that was not confirmed at the head again.
    """

    def __init__(self, largest: int) -> None:
        self.largest = largest
        self.messages = self.bytes = 0
        self._ahead: deque[Recorded] = deque()
        self._taken: deque[Recorded] = deque()
        self._in = self._out = 0
        self._changed = threading.Condition()

    @property
    def waiting(self) -> int:
        """B of messages that are not on the disk."""
        return self._in - self._out

    def put(self, message: Recorded) -> bool:
        """Append a message; return whether there was room for it."""
        with self._changed:
            if self.waiting + message.cost > self.largest:
                return False
            self._in += message.cost
            self._ahead.append(message)
            if len(self._ahead) == 1:
                self._changed.notify()
        return True

    def wake(self) -> None:
        """Let the consumer look now."""
        with self._changed:
            self._changed.notify()

    def wait(self, timeout: float, *, more: bool = False) -> None:
        """Wait at most ``timeout`` s until there is a message, or with ``more`` until one is added."""
        with self._changed:
            if more or not self._ahead:
                self._changed.wait(timeout)

    def take(self) -> Recorded | None:
        """Return the next message, ``None`` where there is none."""
        if not self._ahead:
            return None
        message = self._ahead.popleft()
        self._taken.append(message)
        return message

    def confirmed(self, count: int) -> None:
        """Forget the first ``count`` messages that were taken: they are on the disk."""
        for _ in range(count):
            message = self._taken.popleft()
            self._out += message.cost
            self.messages += 1
            self.bytes += len(message.data)

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
        rest = list(self._ahead)
        self._ahead.clear()
        self._out += sum(message.cost for message in rest)
        return rest
