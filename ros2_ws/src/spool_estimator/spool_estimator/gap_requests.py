"""Analyses of the gap on request: the samples that are kept for them, and the process that does the work."""

from __future__ import annotations

import json
import multiprocessing
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from spool_core.block import Block, joined
from spool_core.block_gate import Verdict
from spool_core.discovery import offered
from spool_core.errors import InputError
from spool_core.system import give_way

from spool_estimator.identification.record import Record, without_strokes

if TYPE_CHECKING:  # slow to load
    from spool_sim.model import Model
    from spool_sim.valve import Valve

#: Entry points of spool_gap, which stands above this package: ``analyse`` and ``to_dict``.
ANALYSIS = "spool.gap_analysis"
#: s, length of the runs in which recent samples are held: chosen, so much more than asked may be held.
RUN = 1.0


@dataclass(slots=True)
class RecentBlocks:
    """The last ``seconds`` s of one valve's sound blocks, and up to a second more.

    They are held as runs of about a second: thousands of small objects would make the collector stop a
    process that serves many valves.

    Attributes:
        seconds: that are kept.
        stamp: ns, of the newest sample; 0 before any.
    """

    seconds: float
    stamp: int = field(default=0, init=False)
    _runs: deque[tuple[Block, bool]] = field(default_factory=deque, init=False)
    _fresh: list[Block] = field(default_factory=list, init=False)
    _after_gap: bool = field(default=True, init=False)
    _duration: float = field(default=0.0, init=False)

    def take(self, block: Block, verdict: Verdict) -> None:
        """Keep ``block``, which the gate did not refuse, and forget what is too old."""
        if verdict is Verdict.RESTARTS:
            if self._fresh:
                self._close_run()
            self._after_gap = True
        self._fresh.append(block)
        self.stamp = block.end - round(block.sample_period * 1e9)
        if (block.end - self._fresh[0].stamp) * 1e-9 >= RUN:
            self._close_run()

    def records(self, name: str) -> list[Record]:
        """Return what is kept as stretches without gaps."""
        runs = [*self._runs, (joined(self._fresh), self._after_gap)] if self._fresh else list(self._runs)
        stretches: list[list[Block]] = []
        for run, after_gap in runs:
            if after_gap or not stretches:
                stretches.append([])
            stretches[-1].append(run)
        return [
            Record(
                name, whole.stamp, whole.sample_period, whole.body.astype(float), whole.spool.astype(float),
                origin=stretches[0][0].stamp,
            )
            for whole in map(joined, stretches)
        ]  # fmt: skip

    def _close_run(self) -> None:
        run = joined(self._fresh)
        self._runs.append((run, self._after_gap))
        self._fresh, self._after_gap = [], False
        self._duration += run.duration
        while self._duration - self._runs[0][0].duration >= self.seconds:
            self._duration -= self._runs.popleft()[0].duration


@dataclass(frozen=True, slots=True)
class GapTask:
    """Records on their way to an analysis; ``stamp`` (ns) is that of the newest sample."""

    records: Sequence[Record]
    valve: Valve
    base: Model
    stamp: int

    @property
    def seconds(self) -> float:
        """Duration of the records together, s."""
        return sum(record.duration for record in self.records)

    def failed(self, reason: str) -> GapAnswer:
        """Return that there is no verdict, and the ``reason``."""
        return GapAnswer(self.stamp, False, reason, self.seconds)


@dataclass(frozen=True, slots=True)
class GapAnswer:
    """What an analysis said; fields as in ``GapAnalysis``, ``done`` where there is a verdict."""

    stamp: int
    done: bool
    sentence: str
    duration: float
    verdict: str = ""
    confidence: float = float("nan")
    json: str = ""


def analyse_task(task: GapTask) -> GapAnswer:
    """Return the analysis of ``task``; a record that cannot be analysed is an answer with a reason."""
    entries = {one.name: one for one in offered(ANALYSIS)}
    if not entries:
        return task.failed("spool_gap is not installed: build and source it")
    parts = [without_strokes(one, task.valve.natural_frequency)[0] for one in task.records]
    try:  # loaded in the worker only
        found = entries["analyse"].load()([one for some in parts for one in some], task.valve, task.base)
    except InputError as error:
        return task.failed(str(error))
    text = json.dumps(entries["to_dict"].load()(found), allow_nan=False)
    return GapAnswer(task.stamp, True, found.sentence, task.seconds, found.verdict, found.confidence, text)


class GapWorker:
    """Each analysis in a separate process, one at a time."""

    def __init__(self) -> None:
        """Start nothing yet."""
        self._pool: ProcessPoolExecutor | None = None
        self._running: Future[GapAnswer] | None = None
        self._task: GapTask | None = None

    def offer(self, task: GapTask) -> bool:
        """Begin to analyse ``task``; return whether that began. Never waits."""
        if self._running is not None:  # an answer is still to come, or to be collected
            return False
        if self._pool is None:
            # A fork of a process with threads may inherit a lock that nobody will open.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, context, initializer=give_way)
        self._task = task
        self._running = self._pool.submit(analyse_task, task)
        return True

    def collect(self) -> GapAnswer | None:
        """Return the answer that has come since, ``None`` without one; never waits."""
        if self._running is None or self._task is None or not self._running.done():
            return None
        running, task = self._running, self._task
        self._running = self._task = None
        error = running.exception()
        self.close()  # an analysis is rare, and its process as large as that of a node
        if error is None:
            return running.result()
        return task.failed(f"the analysis broke off: {type(error).__name__}: {error}")

    def close(self) -> None:
        """End the process; what it is analysing is lost."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = self._running = self._task = None
