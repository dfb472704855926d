"""Replay of recorded blocks through estimator and monitor: what the live nodes do, without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from spool_core.block import Block, BlockRun
from spool_core.block_gate import Verdict
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator
from spool_estimator.gap_watch import GapWatch
from spool_estimator.plausibility import ValveCheck
from spool_estimator.refit import Refit, WindowRefits, refit

from spool_monitor.drift_trace import DriftTrace
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor


@dataclass(slots=True)
class Replay:
    """Replay of one valve: estimator and monitor, driven by its blocks in their order.

    The estimator's gate judges each block for all; one that has judged blocks before begins after a pause.

    Blocks wait for each other up to the next estimate, and the gate joins those that go on with the stream;
    that changes nothing. What was taken shows after ``flush``.

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
    _waiting: list[Block | BlockRun] = field(default_factory=list, init=False)
    _lacking: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.monitor.gate = self.estimator.gate
        self.estimator.gate.resume()

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

    def update(self, item: Block | BlockRun) -> None:
        """Take one block, or the blocks of a run, through estimator and monitor in the order of the data."""
        self._waiting.append(item)
        self._lacking -= item.body.size
        if self._lacking <= 0:
            self.flush()

    def flush(self) -> None:
        """Pass on the blocks that wait for others."""
        waiting, self._waiting = self._waiting, []
        for block, verdict in self.estimator.gate.admitted(waiting, self._room):
            self._through(block, verdict)
        self._lacking = self._room()

    def _room(self) -> int:
        """Return the samples that may be taken together."""
        last = self.estimator.gate.last
        return min(self.estimator.lacking, self.monitor.room(last.period if last is not None else 0.0))

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
