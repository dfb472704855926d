"""Gather a valve's history and write it beside the work, so that a slow disk holds no message up."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from spool_estimator.estimate import Estimate
from spool_stream.block import Block
from spool_stream.errors import InputError

from .travel import TravelCounter
from .trend import Sums, TrendStore

#: s of data between two writings: what a power loss costs.
INTERVAL = 10.0


class TrendWriter:
    """Feed the trends of one valve from its accepted blocks and its estimates.

    ``warn`` is called with one line for people, once; after that nothing is written. A damaged file is put
    aside under ``NAME.damaged`` and a new one begun.
    """

    def __init__(self, path: Path, warn: Callable[[str], None]) -> None:
        self.travel = TravelCounter()
        self._path, self._warn = path, warn
        self._sums = Sums()
        self._written = 0
        self._counted = (0.0, 0)
        self._store: TrendStore | None = None
        self._worker = ThreadPoolExecutor(1, "trends")
        self._writing: Future[None] | None = None
        try:
            try:
                self._store = TrendStore(path)
            except InputError as error:
                warn(f"{error}: it is kept as {path.name}.damaged, a new one is begun")
                path.replace(path.with_name(f"{path.name}.damaged"))
                self._store = TrendStore(path)
        except OSError as error:
            warn(f"no trends are kept: {error}")

    def update(self, block: Block) -> None:
        """Take an accepted block."""
        self.travel.update(block)

    def update_estimate(self, estimate: Estimate) -> None:
        """Take an estimate; what was gathered is written where it is time for it."""
        if self._store is None:
            return
        self._sums.add_estimate(estimate)
        if not 0 <= estimate.stamp - self._written < round(INTERVAL * 1e9):
            self._written = estimate.stamp
            self.flush(estimate.stamp)

    def flush(self, stamp: int = 0) -> None:
        """Write what was gathered, unless the last writing still runs: it goes with the next one then."""
        if self._store is None or (self._writing is not None and not self._writing.done()):
            return
        way, turns = self.travel.travel, self.travel.reversals
        self._sums.count("travel", "m", way - self._counted[0])
        self._sums.count("reversals", "1", float(turns - self._counted[1]))
        self._counted = (way, turns)
        taken, self._sums = self._sums, Sums()
        self._writing = self._worker.submit(self._write, taken, stamp)

    def close(self) -> None:
        """Write the rest and let go of the file."""
        self._worker.shutdown()
        if self._store is not None:
            self._writing = None
            self._worker = ThreadPoolExecutor(1, "trends")
            self.flush(self._written)
            self._worker.shutdown()
        if self._store is not None:
            self._store.close()
            self._store = None

    def _write(self, sums: Sums, stamp: int) -> None:
        if self._store is None:
            return
        try:
            self._store.write(sums, stamp)
        except OSError as error:
            self._store = None
            self._warn(f"no more trends are kept: {error}")
