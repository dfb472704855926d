"""Replay of recorded blocks through estimator and monitor: what the live nodes do, without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from spool_core.block import Block, BlockRun
from spool_core.block_gate import BlockGate, Verdict
from spool_estimator.estimate import Estimate
from spool_estimator.gap_watch import GapWatch
from spool_estimator.plausibility import ValveCheck
from spool_estimator.refit import Refit, WindowRefits, refit
from spool_estimator.stream_estimator import Estimator

from spool_monitor.drift_trace import DriftTrace
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor


@dataclass(slots=True)
class Replay:
    """Replay of one valve: estimator and monitor, driven by its blocks in their order.

    The estimator's gate judges each block for all; one that has judged blocks before begins after a pause.

    Blocks that follow each other to the nanosecond are taken together, up to the next estimate; that changes
    nothing. What was taken shows after ``flush``.

    Attributes:
        estimates: every estimate, where ``keep`` asked for them; the last one is ``estimator.latest``.
        gap: watches what the model leaves over, as the estimator's node does.
        refitted: every refit, where ``refits`` asked for them; none is skipped here.
        trace: takes what the drift tests show, where it is given.
        learned: called with each estimate once the drift tests have learned from it.
        check: compares the valve's description with the estimates, where it is given.
        events: every event; a valve that flaps is bounded by its conditions' delays.

    """

    estimator: Estimator
    monitor: Monitor
    keep: bool = False
    refits: WindowRefits | None = None
    gap: GapWatch = field(default_factory=GapWatch)
    check: ValveCheck | None = None
    trace: DriftTrace | None = None
    learned: Callable[[Estimate], object] | None = None
    estimates: list[Estimate] = field(default_factory=list, init=False)
    events: list[Event] = field(default_factory=list, init=False)
    refitted: list[Refit] = field(default_factory=list, init=False)
    first_stamp: int | None = field(default=None, init=False)
    last_stamp: int | None = field(default=None, init=False)
    samples: int = field(default=0, init=False)
    _gate: BlockGate = field(init=False)
    _waiting: list[BlockRun] = field(default_factory=list, init=False)
    _lacking: int = field(default=0, init=False)
    _due: tuple[int, int, float] = field(default=(0, 0, 0.0), init=False)
    _nanoseconds: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._gate = self.monitor.gate = self.estimator.gate
        self._gate.resume()

    def run(self, blocks: Iterable[Block], progress: Callable[[Block], None] | None = None) -> None:
        """Drive both cores with ``blocks``; ``progress`` is called after each."""
        for block in blocks:
            self.update(block)
            if progress is not None:
                progress(block)
        self.flush()

    def update_temperature(self, stamp: int, celsius: float, deviation: float = math.nan) -> None:
        """Take the oil's temperature at ``stamp`` (ns), deg C, its standard deviation (NaN: unknown)."""
        self.flush()
        self.estimator.update_temperature(stamp, celsius, deviation)
        self._told(self.monitor.update_temperature(stamp, celsius))

    def update_command(self, stamp: int, value: float) -> None:
        """Take the solenoid's command at ``stamp`` (ns)."""
        self.flush()
        for strokes in (self.estimator.strokes, self.monitor.strokes):
            strokes.take_command(stamp, value)

    def update(self, block: Block) -> None:
        """Take one block through estimator and monitor, in the order of the data."""
        run = BlockRun.of(block)
        if run is None:
            self.flush()
            self._alone(block)
        else:
            self.update_run(run)

    def update_run(self, run: BlockRun) -> None:
        """Take the blocks of ``run``, as ``update`` does one by one."""
        at, count = 0, len(run)
        while at < count:
            ahead = run.part(at, count)
            due = self._waiting or self._begin()
            if due and (ahead.stamp, ahead.sequence, ahead.sample_period) == self._due:
                taken = min(len(ahead), -(-self._lacking // run.size))
                self._waiting.append(ahead.part(0, taken))
                stamp, sequence, period = self._due
                self._due = stamp + taken * run.size * self._nanoseconds, sequence + taken, period
                self._lacking -= taken * run.size
                if self._lacking <= 0:
                    self.flush()
            else:
                self.flush()
                self._alone(run.block(at))
                taken = 1
            at += taken

    def flush(self) -> None:
        """Pass on the blocks that wait for others."""
        if not self._waiting:
            return
        runs, self._waiting = self._waiting, []
        whole = self._gate.admit_run(runs)
        if whole is not None:
            self._through(whole, Verdict.CONTINUES)
            return
        for run in runs:
            for block in run.blocks():
                self._alone(block)

    def _begin(self) -> bool:
        """Say which block is due; return whether blocks may wait now.

        They are due to the nanosecond: stamps must not change by rounding, nor faults by waiting.
        """
        last = self._gate.last
        if last is None or not self._gate.steady:
            return False
        self._lacking = min(self.estimator.lacking, self.monitor.room(last.period))
        if self._lacking <= 0:
            return False
        self._due = last.end, last.sequence + 1, last.period
        nanoseconds = last.period * 1e9
        self._nanoseconds = round(nanoseconds)
        return nanoseconds.is_integer()

    def _alone(self, block: Block) -> None:
        self._through(block, self._gate.judge(block))

    def _through(self, block: Block, verdict: Verdict) -> None:
        estimates = self.estimator.update(block, verdict)
        if verdict is not Verdict.REFUSED:
            self.gap.take(block)
            self.samples += block.body.size
            # A clock that was set back makes no duration negative.
            self.first_stamp = min(block.stamp, self.first_stamp or block.stamp)
            self.last_stamp = max(block.end, self.last_stamp or block.end)
        if self.refits is not None:
            self.refitted += [refit(task) for task in self.refits.update(block, verdict, estimates)]
        events = self.monitor.update(block, verdict)
        if events:
            self._told(events)
        for estimate in estimates:
            event = self.gap.update(estimate)
            if event is not None:
                self.events.append(event)
            self._told(self.monitor.update_estimate(estimate))
            if self.learned is not None:
                self.learned(estimate)
            if self.trace is not None:
                self.trace.take(estimate, self.monitor.detection.parameters)
            if self.check is not None:
                self.check.update(estimate)
            if self.keep:
                self.estimates.append(estimate)

    def _told(self, events: list[Event]) -> None:
        self.events += events
        for event in events:
            raised = event.state is EventState.RAISED
            self.gap.hear(event.kind, event.source or event.cause, raised=raised)
