"""Progress of a set-up on stderr: its steps, announced and timed."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

TERMINAL_REFRESH_S = 0.5


def say(line: str) -> None:
    """One line on stderr; stdout belongs to the command's own work."""
    print(f"spool: {line}", file=sys.stderr, flush=True)


class Steps:
    """Counts the steps of a set-up.

    Attributes:
        total: how many steps there will be.
    """

    def __init__(self) -> None:
        self.total = 0
        self._number = 0
        self._began = time.monotonic()
        self._drawn = 0.0
        self._line = ""
        self._step_began = self._began

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        """Announce a step, and say how long it took."""
        self._number += 1
        self._line = f"[{self._number}/{self.total}] {what} ..."
        self._step_began = time.monotonic()
        sys.stderr.write(self._line)
        sys.stderr.flush()
        try:
            yield
        except BaseException:
            sys.stderr.write("\n")
            raise
        sys.stderr.write(f"{self._start_of_line()} {time.monotonic() - self._step_began:.0f} s\n")
        sys.stderr.flush()

    def progress(self, what: str) -> None:
        """Draw what is going on, on a terminal only and not too often."""
        now = time.monotonic()
        if sys.stderr.isatty() and now - self._drawn > TERMINAL_REFRESH_S:
            self._drawn = now
            sys.stderr.write(f"{self._start_of_line()} {now - self._step_began:.0f} s  {what[:40]}")
            sys.stderr.flush()

    def elapsed(self) -> float:
        """Seconds since the first step."""
        return time.monotonic() - self._began

    def _start_of_line(self) -> str:
        return f"\r\033[K{self._line}" if sys.stderr.isatty() else ""
