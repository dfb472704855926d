"""Gap of a running valve: the watch that reports what the model leaves more than usual, and analyses."""

from __future__ import annotations

import json
import multiprocessing
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from statistics import fmean, median
from typing import TYPE_CHECKING

import numpy as np
from spool_core.block import Block, joined
from spool_core.block_gate import Verdict
from spool_core.discovery import offered
from spool_core.errors import InputError
from spool_core.events.event import Event, EventState, Facts, Namur, Severity, Urgency, urgency_of
from spool_core.numbers import MEDIAN_TO_DEVIATION
from spool_core.system import give_way

from spool_estimator.estimate import Estimate, State
from spool_estimator.identification.channel_faults import flat_share
from spool_estimator.identification.record import Record, without_strokes

if TYPE_CHECKING:  # slow to load
    from spool_sim.model import Model
    from spool_sim.valve import Valve

#: Kind and code of the event, and the status after NE 107 that it gives the valve.
MODEL_GAP, MODEL_GAP_CODE, NAMUR = "model_gap", 500, Namur.OUT_OF_SPECIFICATION
#: Kinds of the events that explain whatever the model leaves over.
FAULTS = ("sensor_fault", "data_fault")
#: Estimates from which the median is learned: chosen, more scatter less and watch later.
LEARNED = 20
#: Estimates in a row that close the gap, and the least that open it: chosen, one or two may be chance.
IN_A_ROW = 3
#: Deviations above the median that an estimate must reach, too, and the smallest deviation over the median.
DEVIATIONS, LEAST_DEVIATION = 6.0, 0.05
#: Share of the force below which the remainder does not matter: where the spool sticks at every turn the
#: online estimator itself leaves up to 3 %.
MATTERS = 0.04
#: Share of the way from the median to the limit below which the gap has closed again: chosen, hysteresis.
CLOSED = 0.5
#: Times of the estimator's memory for which the residual must stay up, and s at most.
PATIENCE, LONGEST_PATIENCE = 2.5, 30.0
#: Growth of the residual from one half of that time to the other that says: still growing.
GROWING = 1.3
#: Relative change of a parameter, over the residual, that explains the residual by the estimator's lag.
LAGGING = 0.1
#: Dry friction over the spring's force, rms, from which the spool sticks most of the time.
STICKING = 3.0
#: Stiffness over the median one, either way, that is no spring's: channels are exchanged or read wrongly.
NO_SPRING = 3.0
#: s of samples that are looked at for a channel that clips.
LOOKED_AT = 1.0
#: Entry points of spool_gap, which stands above this package: ``analyse`` and ``to_dict``.
ANALYSIS = "spool.gap_analysis"
#: s, length of the runs in which recent samples are held: chosen, so much more than asked may be held.
RUN = 1.0


@dataclass(frozen=True, slots=True)
class ResidualLevel:
    """Level of one measure of the residual: its median, and the limit above which it counts as grown."""

    median: float
    limit: float

    @classmethod
    def learned(cls, values: list[float], growth: float, least: float = 0.0) -> ResidualLevel:
        """Return the level of ``values``; its limit is ``growth`` times the median and ``least``, or more."""
        middle = median(values)
        deviation = MEDIAN_TO_DEVIATION * median(abs(one - middle) for one in values)
        deviation = max(deviation, LEAST_DEVIATION * middle)
        return cls(middle, max(growth * middle, middle + DEVIATIONS * deviation, least))


@dataclass(slots=True)
class GapWatch:
    """Learns the median of what the model leaves over, and says when that grows.

    Two measures must grow: the residual over the inertia force, which a weaker or faster excitation raises
    because the noise stays, and the force that is left (N), which a stronger excitation raises because the
    forces grow. Both medians are of the first ``LEARNED`` estimates while the estimator tracks. Below
    ``MATTERS`` no gap opens.

    What the estimator follows is no gap: while a parameter drifts it lags behind, and leaves more. So the gap
    opens once both measures stayed up for ``PATIENCE`` memories in which neither the residual grew on nor a
    parameter changed; nor does it open while a sensor is at fault, a channel clips or the channels show no
    spring like the median one. What is not tracked says nothing, and neither does a spool that sticks most of
    the time.

    Attributes:
        growth: residual over its median from which the gap is open.
        raised: it is open.
        median: learned, relative; ``None`` while it is being learned.
        limit: residual above which the gap opens.
    """

    growth: float = 2.0
    raised: bool = field(default=False, init=False)
    _relative: ResidualLevel | None = field(default=None, init=False)
    _force: ResidualLevel | None = field(default=None, init=False)
    _stiffness: float = field(default=0.0, init=False)
    _first: list[tuple[float, float, float]] = field(default_factory=list, init=False)
    _last: deque[float] = field(default_factory=lambda: deque(maxlen=IN_A_ROW), init=False)
    _up: deque[Estimate] = field(default_factory=deque, init=False)
    _faults: set[str] = field(default_factory=set, init=False)
    _opened: int = field(default=0, init=False)
    _recent: deque[Block] = field(default_factory=deque, init=False)
    _kept: float = field(default=0.0, init=False)

    @property
    def median(self) -> float | None:
        """Median of the residual, relative; ``None`` while that is being learned."""
        return None if self._relative is None else self._relative.median

    @property
    def limit(self) -> float:
        """Residual above which the gap opens; 0 while that is being learned."""
        return 0.0 if self._relative is None else self._relative.limit

    def take(self, block: Block) -> None:
        """Keep the samples of ``block`` as long as they may be looked at."""
        if self._recent and abs(block.stamp - self._recent[-1].end) >= LOOKED_AT * 1e9:
            self._up.clear()  # a pause, or a clock that was set: what was up before it stayed up no longer
        self._recent.append(block)
        self._kept += block.duration
        while self._kept - self._recent[0].duration >= LOOKED_AT:
            self._kept -= self._recent.popleft().duration

    def hear(self, kind: str, source: str, *, raised: bool) -> None:
        """Take an event of the monitor: no gap opens while sensors or data are known to be at fault."""
        if kind in FAULTS:
            (self._faults.add if raised else self._faults.discard)(source)

    def update(self, estimate: Estimate) -> Event | None:
        """Take an estimate of what was taken; return the event that follows, if any."""
        if estimate.state is State.NOT_EXCITED:
            self._up.clear()  # a standstill: what was up before it stayed up no longer
        if estimate.state is not State.TRACKING or not _says_something(estimate):
            return None
        value, force = estimate.residual.value, estimate.residual_force.value
        if self._relative is None or self._force is None:
            self._first.append((value, force, _stiffness(estimate)))
            if len(self._first) == LEARNED:
                relative, forces, stiffnesses = (list(row) for row in zip(*self._first, strict=True))
                self._relative = ResidualLevel.learned(relative, self.growth, MATTERS)
                self._force = ResidualLevel.learned(forces, self.growth)
                self._stiffness = median(stiffnesses)
                self._first.clear()
            return None
        self._last.append(value)
        closed = self._relative.median + CLOSED * (self._relative.limit - self._relative.median)
        if self.raised:
            closes = len(self._last) == IN_A_ROW and max(self._last) < closed
            return self._change(estimate, opens=False) if closes else None
        up = value > self._relative.limit and force > self._force.limit
        if up and self._believes(estimate):
            self._up.append(estimate)
        else:
            self._up.clear()
        return self._change(estimate, opens=True) if self._stays() else None

    def _change(self, estimate: Estimate, *, opens: bool) -> Event:
        assert self._relative is not None
        now, median = estimate.stamp, self._relative.median
        up_since = self._up[0].stamp if self._up else now
        facts = replace(
            Facts.of(estimate.residual, self._relative.limit),
            baseline=median,
            change=estimate.residual.value - median,
            began=up_since if opens else self._opened,
            urgency=urgency_of(NAMUR, Severity.WARNING) if opens else Urgency.NONE,
            advice=MODEL_GAP_CODE if opens else 0,
        )
        self.raised = opens
        self._up.clear()
        self._opened = now
        state = EventState.RAISED if opens else EventState.CLEARED
        return Event(
            now, MODEL_GAP, state, Severity.WARNING, "", estimate.residual, "", MODEL_GAP_CODE, facts
        )

    def _stays(self) -> bool:
        """Whether the residual stayed up long enough, while nothing changed that explains it."""
        if len(self._up) < IN_A_ROW:
            return False
        patience = min(PATIENCE * self._up[-1].memory, LONGEST_PATIENCE)
        due = self._up[-1].stamp - round(patience * 1e9)
        if self._up[0].stamp > due:
            return False
        while len(self._up) > IN_A_ROW and self._up[1].stamp <= due:
            self._up.popleft()
        half = len(self._up) // 2
        before, after = list(self._up)[:half], list(self._up)[half:]
        if fmean(one.residual.value for one in after) > GROWING * fmean(one.residual.value for one in before):
            return False
        return not any(_changes(before, after, quantity.name) for quantity in after[-1].parameters)

    def _believes(self, estimate: Estimate) -> bool:
        """Whether the channels can be those of this valve."""
        ratio = _stiffness(estimate) / self._stiffness
        if self._faults or not 1.0 / NO_SPRING < ratio < NO_SPRING:
            return False
        clips = self._recent and any(
            flat_share(np.concatenate([getattr(block, name) for block in self._recent])) > 0.0
            for name in ("body", "spool")
        )
        return not clips


def _says_something(estimate: Estimate) -> bool:
    """Whether the remainder is known, and the spool does not stick most of the time."""
    known = estimate.residual.known and estimate.residual_force.known and estimate.relative_displacement.known
    return known and estimate.parameter("coulomb_force").value <= STICKING * _spring_force(estimate)


def _stiffness(estimate: Estimate) -> float:
    return max(estimate.parameter("spring_stiffness").value, 1e-9)


def _spring_force(estimate: Estimate) -> float:
    return _stiffness(estimate) * estimate.relative_displacement.value


def _changes(before: list[Estimate], after: list[Estimate], name: str) -> bool:
    """Whether a parameter changed so that the lag behind it explains the residual.

    A force is measured by the spring's, too: dry friction may be next to nothing.
    """
    first, last = (fmean(one.parameter(name).value for one in part) for part in (before, after))
    newest = after[-1]
    quantity = newest.parameter(name)
    scale = max(abs(first), abs(last))
    if quantity.unit == "N":
        scale += _spring_force(newest)
    tolerated = LAGGING * newest.residual.value * scale + quantity.standard_deviation
    return abs(last - first) > tolerated


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
