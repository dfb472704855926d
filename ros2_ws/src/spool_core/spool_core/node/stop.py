"""Request to stop a process: a signal that ends it immediately while it loads, and in order later."""

from __future__ import annotations

import enum
import os
import signal
import time
from types import FrameType

NUMBERS = (signal.SIGINT, signal.SIGTERM)

#: s from the first signal on in which further ones can't break the end off: a terminal's Ctrl-C and a launch
#: file's own signal reach a node together, and closing a recording takes a second.
PATIENCE = 3.0


class Stop:
    """The one request of this process to stop.

    Attributes:
        count: signals that came.
        phase: set by the program.
    """

    def __init__(self) -> None:
        self.count = 0
        self.phase = Phase.LOADING
        self._first = 0.0

    @property
    def requested(self) -> bool:
        """Whether a signal came."""
        return self.count > 0

    def install(self) -> None:
        """Take over both signals; has to be called in the main thread."""
        for number in NUMBERS:
            signal.signal(number, self._take)

    def finish(self) -> None:
        """Ignore further signals while the interpreter shuts down."""
        for number in NUMBERS:
            signal.signal(number, signal.SIG_IGN)

    def _take(self, number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        self._first = self._first if self.requested else now
        self.count += 1
        if self.phase is Phase.LOADING:
            os._exit(0)
        if self.count > 2 and now - self._first > PATIENCE:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        if self.phase is Phase.STARTING:
            self.phase = Phase.ENDING
            raise StopRequested


class StopRequested(BaseException):
    """Stop request, raised in the main thread by a signal while the node starts."""


class Phase(enum.Enum):
    """How far a process has come, on which the effect of a signal depends."""

    LOADING = "loading"  # nothing is open yet: the process ends immediately
    STARTING = "starting"  # what is under way, perhaps a minute of compiling, is broken off
    RUNNING = "running"  # it is noted, and the node ends in order
    ENDING = "ending"  # nothing more is begun, however often it is asked


STOP = Stop()
