"""Worker thread of a process that hosts many nodes: their blocks, one after the other, off the executor."""

from __future__ import annotations

import contextlib
import ctypes
import queue
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from typing import Any

#: Owner of the job with which a worker ends.
_END = object()


#: s that a job may wait for the disk, as state files on a slow one take seconds.
LONGEST_DISK = 30.0
_THREAD = threading.local()


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


class HangError(BaseException):
    """Hang: what runs for so long is broken off; no handler of exceptions may keep it."""


class Worker:
    """Worker that runs jobs in order, each for an owner.

    A job that does not return is given up with its thread: another thread goes on with the jobs of all other
    owners, and nothing of theirs is lost.

    Attributes:
        done: jobs that returned.
    """

    def __init__(self) -> None:
        self.done = 0
        self._jobs: queue.SimpleQueue[tuple[object, Callable[[Any], None], Any]] = queue.SimpleQueue()
        self._current: tuple[object, float] | None = None
        self._refused: set[int] = set()
        self._turn = threading.Lock()
        self._thread = self._begun()

    @property
    def waiting(self) -> int:
        """Number of jobs that wait."""
        return self._jobs.qsize()

    def put(self, owner: object, job: Callable[[Any], None], argument: Any) -> None:
        """Let ``job(argument)`` run when its turn comes; those of an owner that hangs are dropped."""
        self._jobs.put((owner, job, argument))

    def hanging(self, longest: float) -> object | None:
        """Return the owner whose job runs for more than ``longest`` s, ``None`` where there is none."""
        current = self._current
        if current is None or time.monotonic() - current[1] <= longest:
            return None
        return current[0]

    def excuse(self, seconds: float) -> None:
        """Count the job that runs as hanging only in so many s."""
        if self._current is not None:
            self._current = self._current[0], time.monotonic() + seconds

    def give_up(self, owner: object) -> bool:
        """Leave the job of ``owner`` that hangs, and go on with those of others.

        Return whether that was done: it may have returned just now.
        """
        with self._turn:
            if self._current is None or self._current[0] is not owner:
                return False
            self._refused.add(id(owner))
            left, self._current = self._thread, None
            self._thread = self._begun()
            if (
                left.ident is not None
            ):  # in Python it ends at its next step; a kernel that never returns stays
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    ctypes.c_ulong(left.ident), ctypes.py_object(HangError)
                )
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
        try:
            while True:
                owner, job, argument = self._jobs.get()
                if owner is _END:
                    return
                if id(owner) in self._refused:
                    continue
                with self._turn:
                    self._current = owner, time.monotonic()
                try:
                    job(argument)
                except Exception:  # of what does not guard itself: the jobs of others go on
                    traceback.print_exc()
                with self._turn:  # a thread that was given up takes no further job: it is broken off
                    if self._thread is not me:
                        return
                    self._current = None
                    self.done += 1
        except HangError:
            return
