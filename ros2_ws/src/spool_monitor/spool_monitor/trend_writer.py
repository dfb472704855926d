"""Trend writer: a valve's history, written in a thread so that a slow disk holds no message up."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from spool_core.block import Block
from spool_core.errors import InputError
from spool_estimator.estimate import Estimate

from spool_monitor.travel import TravelCounter
from spool_monitor.trend import PATIENCE, LaterVersionError, Sums, TrendStore, own_file

#: s of data between two writings: what a power loss costs.
INTERVAL = 10.0


def _always() -> bool:
    return True


class TrendWriter:
    """Trend writer of one valve, fed from its accepted blocks and its estimates.

    What can't be written, since another program holds the file or the disk is full, is held (a day of minutes
    at most) and written as soon as that is possible; :attr:`trouble` says so meanwhile. ``warn`` is called
    with one line for people when that begins and when it ends. A damaged file is put aside under
    ``NAME.damaged`` and a new one begun; one of a later version is left alone, and another kept next to it.
    Nothing is written while ``allowed`` says no: the folder may be another monitor's.
    """

    def __init__(
        self,
        path: Path,
        warn: Callable[[str], None],
        allowed: Callable[[], bool] = _always,
        patience: float = PATIENCE,
    ) -> None:
        self.travel = TravelCounter()
        self.trouble = ""
        self._path, self._warn, self._allowed, self._patience = (path, warn, allowed, patience)
        self._sums = Sums()
        self._returned = Sums()
        self._hand_back = threading.Lock()
        self._written = 0
        self._counted = (0.0, 0)
        self._store: TrendStore | None = None
        self._worker = ThreadPoolExecutor(1, "trends")
        self._writing: Future[None] | None = None

    def update(self, block: Block) -> None:
        """Take an accepted block."""
        self.travel.update(block)

    def update_estimate(self, estimate: Estimate) -> None:
        """Take an estimate; what was gathered is written where it is time for it."""
        self._sums.add_estimate(estimate)
        if not 0 <= estimate.stamp - self._written < round(INTERVAL * 1e9):
            self._written = estimate.stamp
            self.flush(estimate.stamp)

    def flush(self, stamp: int = 0) -> None:
        """Write what was gathered, unless the last writing still runs: it goes with the next one then."""
        if self._writing is not None and not self._writing.done():
            return
        with self._hand_back:  # what could not be written the last time, the many first
            self._returned.merge(self._sums)
            self._sums, self._returned = self._returned, Sums()
        if not self._allowed():
            return
        way, turns = self.travel.travel, self.travel.reversals
        self._sums.count("travel", "m", way - self._counted[0])
        self._sums.count("reversals", "1", float(turns - self._counted[1]))
        self._counted = (way, turns)
        taken, self._sums = self._sums, Sums()
        self._writing = self._worker.submit(self._write, taken, stamp)

    def close(self) -> None:
        """Write the rest and close the file; what could not be written by now is lost."""
        self._worker.shutdown()
        self._writing = None
        if not self.trouble:  # the process that holds the file must not hold up the end of the node again
            self._worker = ThreadPoolExecutor(1, "trends")
            self.flush(self._written)
            self._worker.shutdown()
        self._let_go()

    def _opened(self) -> TrendStore:
        """Return the store, opened where it is not.

        Raises:
            OSError: it can't be opened now.

        """
        if self._store is None:
            path = own_file(self._path, self._patience)
            try:
                self._store = TrendStore(path, patience=self._patience)
            except LaterVersionError as error:
                raise OSError(str(error)) from error
            except InputError as error:
                self._warn(f"{error}: it is kept as {path.name}.damaged, a new one is begun")
                path.replace(path.with_name(f"{path.name}.damaged"))
                for ending in ("-wal", "-shm"):  # they belong to the damaged one
                    path.with_name(path.name + ending).unlink(missing_ok=True)
                self._store = TrendStore(path, patience=self._patience)
            if path != self._path:
                self._warn(
                    f"{self._path}: a later version of the suite wrote it: it is left, see {path.name}"
                )
        return self._store

    def _write(self, sums: Sums, stamp: int) -> None:
        try:
            try:
                self._opened().write(sums, stamp)
            except InputError:  # damaged while it was in use: opening it again puts it aside
                self._let_go()
                self._opened().write(sums, stamp)
        except (InputError, OSError) as error:
            self._let_go()
            with self._hand_back:
                sums.merge(self._returned)
                self._returned = sums
            self._say(error)
            return
        if self.trouble:
            self.trouble = ""
            self._warn("trends are written again, with what was held meanwhile")

    def _let_go(self) -> None:
        if self._store is not None:
            self._store.close()
            self._store = None

    def _say(self, error: Exception) -> None:
        if not self.trouble:
            self._warn(f"trends can't be written, they are held in memory for a day: {error}")
        self.trouble = str(error)
