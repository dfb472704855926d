"""Refit of the model in the background: when it is asked for, and the process that does it."""

from __future__ import annotations

import enum
import math
import multiprocessing
import os
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from spool_core.block import Block, Samples
from spool_core.block_gate import Verdict
from spool_core.kernels.samples import OutlierFilter
from spool_core.kernels.strokes import StrokeWatch
from spool_core.system import give_way
from spool_core.uncertainty import Quantity, Validity

from spool_estimator.estimate import Estimate, State
from spool_estimator.identification.fit_result import FitSettings
from spool_estimator.identification.record import Record

if TYPE_CHECKING:  # slow to load
    from spool_sim.model import Model
    from spool_sim.valve import Valve

#: Relative error from which a model explains nothing worth the name: a fifth of the power at most.
NOTHING = 0.9

#: States of the recursion in which the window holds motion to fit.
_MOVING = (State.LEARNING, State.TRACKING)


class RefitState(enum.IntEnum):
    """State of a refit: how it ended; the numbers are those of ``spool_msgs/msg/WindowRefit``."""

    UNKNOWN = 0
    CONVERGED = 1
    NOT_CONVERGED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class RefitSettings:
    """``model`` is fitted to the last ``window`` s, every ``period`` s of data."""

    valve: Valve
    model: Model
    period: float = 5.0
    window: float = 4.0


@dataclass(frozen=True, slots=True)
class WindowTask:
    """One window on its way to a fit.

    ``stamp`` (ns) is that of its newest sample, ``last_sequence`` of the block it came in, ``start`` what the
    recursion knew by then, by name; ``idle`` why there is nothing to fit, empty where there is.
    """

    settings: RefitSettings
    stamp: int
    last_sequence: int
    record: Record
    start: Mapping[str, float]
    idle: str = ""

    def failed(self, reason: str) -> Refit:
        """Return that there is no fit, and the ``reason``."""
        return Refit(
            self.stamp, self.settings.model.name, RefitState.FAILED, reason, self.last_sequence,
            self.record.duration,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Refit:
    """Refit of a window; fields as in ``WindowRefit``. ``correlations`` is of ``fitted``, row by row."""

    stamp: int
    model: str
    state: RefitState
    reason: str
    last_sequence: int
    window: float
    parameters: tuple[Quantity, ...] = ()
    fitted: tuple[str, ...] = ()
    correlations: tuple[float, ...] = ()
    objective: Quantity = field(default_factory=lambda: Quantity("objective", "1"))
    amplitude_ratio: Quantity = field(default_factory=lambda: Quantity("amplitude_ratio", "1"))
    nrmse: Quantity = field(default_factory=lambda: Quantity("nrmse", "1"))


@dataclass(slots=True)
class WindowRefits:
    """Keeps the last seconds of one valve's stream and say when a window is due.

    Windows end at multiples of the period after the last gap, however the stream is split into blocks.
    """

    settings: RefitSettings
    outliers: OutlierFilter = field(default_factory=OutlierFilter)
    _kept: deque[tuple[Samples, Samples]] = field(default_factory=deque, init=False)
    _strokes: StrokeWatch = field(default_factory=StrokeWatch, init=False)
    _held: int = field(default=0, init=False)
    _count: int = field(default=0, init=False)
    _estimates: deque[Estimate] = field(default_factory=deque, init=False)

    def update(self, block: Block, verdict: Verdict, estimates: Sequence[Estimate]) -> list[WindowTask]:
        """Take a block, the gate's ``verdict`` and the ``estimates`` that fell due within it.

        Returns:
            The windows that fell due.
        """
        self._estimates.extend(estimates)
        if verdict is Verdict.REFUSED:
            return []
        restarts, raw = verdict is Verdict.RESTARTS, block
        block = self.outliers.cleaned(block, restarts=restarts)
        if restarts:
            self._estimates.clear()
            self._estimates.extend(estimates)
        tasks = []
        natural = self.settings.valve.natural_frequency
        for part, pause in self._strokes.kept(block, raw, natural, restarts=restarts):
            if restarts or pause is not None:
                self._kept.clear()
                self._held = self._count = 0
            restarts = False
            tasks += self._take(part)
        return tasks

    def _take(self, block: Block) -> list[WindowTask]:
        size = max(16, round(self.settings.window / block.sample_period))
        hop = max(1, round(self.settings.period / block.sample_period))
        tasks = []
        taken = 0
        while taken < block.body.size:
            count = min(hop - self._count % hop, block.body.size - taken)
            part = slice(taken, taken + count)
            self._kept.append((block.body[part], block.spool[part]))
            self._held += count
            while self._held - self._kept[0][0].size >= size:
                self._held -= self._kept.popleft()[0].size
            taken += count
            self._count += count
            if self._count % hop == 0 and self._held >= size:
                stamp = block.stamp + round((taken - 1) * block.sample_period * 1e9)
                tasks.append(self._task(stamp, block, size))
        while len(self._estimates) > 1:  # what comes next is at least as new as the newest one
            self._estimates.popleft()
        return tasks

    def _task(self, stamp: int, block: Block, size: int) -> WindowTask:
        body, spool = (np.concatenate([pair[side] for pair in self._kept])[-size:] for side in (0, 1))
        start = stamp - round((size - 1) * block.sample_period * 1e9)
        record = Record("window", start, block.sample_period, body.astype(float), spool.astype(float))
        # Stamps are rounded: half a sample later is the same sample.
        limit = stamp + round(0.5e9 * block.sample_period)
        newest = next((one for one in reversed(self._estimates) if one.stamp <= limit), None)
        idle = ""
        if newest is not None and newest.state not in _MOVING:
            idle = f"nothing to fit: the recursion is {newest.state.name.lower().replace('_', ' ')}"
        return WindowTask(self.settings, stamp, block.sequence, record, _start(self.settings, newest), idle)


def refit(task: WindowTask) -> Refit:
    """Return the fit of one window; whatever goes wrong is a result with a reason.

    A window gives the same refit in any process, so that a replay has those of the live node.
    """
    settings = task.settings
    window = task.record.duration
    if task.idle:
        return task.failed(task.idle)
    from spool_estimator.identification.fit import fit  # noqa: PLC0415 - who only collects windows needs no scipy

    found = fit(
        [task.record], settings.model, settings.valve, FitSettings(start=task.start, window=window, starts=1)
    )
    if found.reason is not None or found.agreement is None:
        return task.failed(found.reason or "the fit gave no result")
    explains = found.agreement.nrmse < NOTHING  # better than no model, whose relative error is 1
    said = ["a minimum was found" if found.converged else "the steps allowed did not reach a minimum"]
    if not explains:
        said.append("the model explains nothing of the spool's acceleration")
    if found.not_observable:
        said.append(f"the window does not determine {', '.join(found.not_observable)}")
    if found.at_bound:
        said.append(f"at its bound: {', '.join(found.at_bound)}")
    fitted = {one.name: one for one in found.parameters}
    return Refit(
        task.stamp,
        settings.model.name,
        RefitState.CONVERGED if found.converged and explains else RefitState.NOT_CONVERGED,
        "; ".join([*said, *found.warnings]),
        task.last_sequence,
        window,
        tuple(  # in the model's order; what was given is held
            fitted.get(entry.name)
            or Quantity(entry.name, entry.unit, float(found.held[entry.name]), validity=Validity.HELD)
            for entry in found.model.parameters
        ),
        found.observable,
        tuple(np.asarray(found.correlation, dtype=float).ravel().tolist()),
        _figure("objective", found.agreement.objective),
        _figure("amplitude_ratio", found.agreement.amplitude_ratio),
        _figure("nrmse", found.agreement.nrmse),
    )


class RefitWorker:
    """Fits windows in a separate process.

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
        return task.failed(reason)

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


def _start(settings: RefitSettings, newest: Estimate | None) -> dict[str, float]:
    """Return the recursion's values of what the model has, where they are known and within its bounds."""
    known = {} if newest is None else {one.name: one.value for one in newest.parameters if one.known}
    return {
        entry.name: known[entry.name]
        for entry in settings.model.parameters
        if entry.name in known and entry.low <= known[entry.name] <= entry.high
    }


def _figure(name: str, value: float) -> Quantity:
    validity = Validity.VALID if math.isfinite(value) else Validity.UNKNOWN
    return Quantity(name, "1", float(value) if math.isfinite(value) else math.nan, validity=validity)
