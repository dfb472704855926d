"""Refits in a process of their own: one window at a time, so that the stream never waits."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from spool_core.system import give_way

from .refit import Refit, RefitSettings, RefitState, WindowTask, refit


class RefitWorker:
    """Refit worker: fits windows in a process of its own.

    Attributes:
        done: refits collected since the start.
        skipped: windows left out since the start because a fit was still running.
    """

    def __init__(self, settings: RefitSettings) -> None:
        """Start the process; it loads and compiles what it needs while the stream begins."""
        self.done = 0
        self.skipped = 0
        self._settings = settings
        self._task: WindowTask | None = None
        self._start()
        self._running: Future[Refit] | Future[int] | None = self._born

    def offer(self, task: WindowTask) -> bool:
        """Begin to fit ``task``, or count it as skipped where the last one is still running; never waits."""
        if self._task is not None or (self._running is not None and not self._running.done()):
            self.skipped += 1
            return False
        self._task = task
        try:
            self._running = self._pool.submit(refit, task)
        except BrokenProcessPool:  # it died idle
            self._start()
            self._running = self._pool.submit(refit, task)
        return True

    def collect(self) -> Refit | None:
        """Return the refit that has been finished since, ``None`` without one; never waits."""
        task, running = self._task, self._running
        if task is None or running is None or not running.done():
            return None
        self._task = self._running = None
        self.done += 1
        error = running.exception()
        if error is None:
            found = running.result()
            assert isinstance(found, Refit)
            return found
        if isinstance(error, BrokenProcessPool):
            self._pool.shutdown(wait=False)
            self._start()
            reason = "the fitting process was killed; a new one is started"
        else:
            reason = f"the fit broke off: {type(error).__name__}: {error}"
        return Refit(
            task.stamp, task.settings.model.name, RefitState.FAILED, reason, task.last_sequence,
            task.record.duration,
        )  # fmt: skip

    def wait(self, seconds: float) -> None:
        """Wait until the process is idle, at most ``seconds``; for programs without a stream.

        Raises:
            TimeoutError: it is still busy.
        """
        if self._running is not None:
            self._running.exception(timeout=seconds)

    @property
    def process(self) -> int | None:
        """Id of the process that fits, ``None`` until it runs."""
        return self._born.result() if self._born.done() and self._born.exception() is None else None

    def close(self) -> None:
        """End the process; what it is fitting is lost."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _start(self) -> None:
        # A fork of a process with threads may inherit a lock that nobody will open.
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, initializer=give_way)
        self._born: Future[int] = self._pool.submit(os.getpid)
