"""Interruptions of two sensors at any moment: blocks are right after them, or the adapter says why not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from spool_bag.adapter_node import LOOK, SensorReport
from spool_core.aligner import CLOCK_STEP, Aligner, AlignerSettings, Channel
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.node.diagnostics import Level
from spool_core.sensor_stream import LONGEST_GAP

START = 1_700_000_000_000_000_000
#: Hz, and s of samples behind the last interruption.
RATE, AFTER = 200.0, 5.0
#: s: blocks and the resampler's margin at an interruption, and what is not yet sure at the end.
MARGIN, LATENCY = 0.12, 0.8
BODY, SPOOL = Channel
Times = np.ndarray


def wave(times: Times) -> Times:
    """Return what both sensors measure at true times (s), m/s^2; 1 ms is up to 0.7 m/s^2."""
    return 5.0 * np.sin(2.0 * math.pi * 15.0 * times) + 4.0 * np.sin(2.0 * math.pi * 6.1 * times + 1.0)


class Stretch(NamedTuple):
    """Samples of one sensor at true times (s) from ``begin`` to before ``end``, by a clock ``ahead`` by s.

    ``jitter`` (s) of the stamps; ``lump``: s from one delivery to the next, 0 for each sample by itself.
    """

    begin: float
    end: float
    phase: float
    ahead: float
    jitter: float
    lump: float = 0.0

    @property
    def times(self) -> Times:
        first, last = (math.ceil((at - self.phase) * RATE - 1e-6) for at in (self.begin, self.end))
        return np.arange(first, last) / RATE + self.phase

    def messages(self, channel: Channel) -> Iterator[tuple[float, int, Channel, int, float]]:
        """Yield when each arrives, the order of those that arrive together, and the message."""
        times, order = self.times, (BODY, SPOOL).index(channel)
        off = self.jitter * np.random.default_rng(times.size).uniform(-1.0, 1.0, times.size)
        stamps = START + np.rint(1e9 * (times + off + self.ahead)).astype(np.int64)
        arrivals = np.minimum(np.ceil(times / self.lump) * self.lump, self.end) if self.lump else times
        for arrival, stamp, value in zip(arrivals + 1e-5 * order, stamps, wave(times), strict=True):
            yield float(arrival), order, channel, int(stamp), float(value)


@dataclass
class Sensors:
    """Two sensors, what they have sent up to ``now`` (s), and how they send.

    ``rephased``: one of them was started again, and samples at other instants than before. ``missing``:
    samples that were not sent.
    """

    phase: dict[Channel, float]
    jitter: float
    now: float = 0.0
    ahead: dict[Channel, float] = field(default_factory=lambda: dict.fromkeys(Channel, 0.0))
    sent: dict[Channel, list[Stretch]] = field(default_factory=lambda: {one: [] for one in Channel})
    strays: dict[Channel, list[Stretch]] = field(default_factory=lambda: {one: [] for one in Channel})
    interrupted: list[tuple[float, float]] = field(default_factory=list)
    rephased: bool = False
    missing: dict[Channel, int] = field(default_factory=lambda: dict.fromkeys(Channel, 0))

    def send(self, seconds: float, but: tuple[Channel, ...] = (), lump: float = 0.0) -> None:
        end = self.now + seconds
        for one in Channel:
            stretch = Stretch(self.now, end, self.phase[one], self.ahead[one], self.jitter, lump)
            if one in but:
                self.missing[one] += stretch.times.size
            else:
                self.sent[one].append(stretch)
        self.now = end

    def interrupt(self, who: tuple[Channel, ...], kind: str, *details: float) -> None:
        begin = self.now
        since = self.interrupted[-1][0] if self.apart else begin  # it lasts until the clock is set back
        if kind == "silence":
            self.send(details[0], but=who)
        elif kind == "clock":
            self.ahead |= {one: self.ahead[one] + details[0] for one in who}
        elif kind == "restart":
            self.send(details[0], but=who)
            before = self.phase[BODY] - self.phase[SPOOL]
            self.phase |= {one: self.phase[one] + details[1] for one in who}
            self.rephased |= abs(self.phase[BODY] - self.phase[SPOOL] - before) > 1e-9
        elif kind == "second source":
            self.send(details[0])
            for one in who[:1]:
                ahead = self.ahead[one] + details[2]
                self.strays[one].append(Stretch(begin, self.now, self.phase[one] + details[1], ahead, 0.0))
        elif kind == "lumps":
            self.send(details[0], lump=details[1])
        self.interrupted.append((since, self.now))

    @property
    def apart(self) -> bool:
        """Whether the clock of one was set against the other's."""
        return abs(self.ahead[BODY] - self.ahead[SPOOL]) > 1e-6


@dataclass
class Run:
    """Adapter at work: its blocks, and what it reported, each with when (s)."""

    aligner: Aligner
    blocks: list[tuple[float, Block]] = field(default_factory=list)
    reports: list[tuple[float, Level, str]] = field(default_factory=list)

    def right(self, sensors: Sensors) -> list[Times]:
        """Return the true times of the samples of each block, none for one that is wrong."""
        return [taken_at(sensors, block) for _, block in self.blocks]


def taken_at(sensors: Sensors, block: Block) -> Times:
    stamps = 1e-9 * (block.stamp - START) + block.sample_period * np.arange(block.body.size)
    found = np.empty(0)
    for stretch in sensors.sent[BODY]:
        times = stamps - stretch.ahead
        inside = times[0] >= stretch.begin - 1e-3 and times[-1] < stretch.end + 1e-3
        rows = (block.body, block.spool)
        if inside and all(np.allclose(row, wave(times), atol=0.05) for row in rows):
            found = times
    return found


def run(sensors: Sensors) -> Run:
    found = Run(Aligner(AlignerSettings()))
    report = SensorReport({channel: channel.value for channel in Channel}, 0.5)
    events = [
        event
        for one in Channel
        for part in sensors.sent[one] + sensors.strays[one]
        for event in part.messages(one)
    ]
    looked, heard = 0.0, dict.fromkeys(Channel, 0.0)
    for arrival, _, channel, stamp, value in sorted(events, key=lambda event: event[:2]):
        while arrival - looked > LOOK:
            looked = max(looked + LOOK, arrival - 3.0)
            report.silent = {one: looked - heard[one] for one in Channel}
            report.advance(found.aligner, LOOK)
            status = report.status(found.aligner, START)
            found.reports.append((looked, status.level, status.message))
        heard[channel] = arrival
        block = found.aligner.update(channel, stamp, value)
        if block is not None:
            found.blocks.append((arrival, block))
    return found


def few(count: int) -> settings:
    """Return settings of ``count`` examples, many where new ones are searched for; none is made smaller."""
    examples = count if settings().derandomize else 300
    return settings(max_examples=examples, phases=(Phase.explicit, Phase.generate))


BOTH = (BODY, SPOOL)
WHO = st.sampled_from([(BODY,), (SPOOL,), BOTH])
STEPS = [-86_400.0, -3600.0, -1.0, -0.003, 0.003, 1.0, 3600.0, 86_400.0]
INTERRUPTIONS = st.one_of(
    st.tuples(WHO, st.just("silence"), st.sampled_from([0.1, 0.5, 0.9, 1.0, 1.1, 2.0, 5.0])),
    st.tuples(st.just(BOTH), st.just("silence"), st.sampled_from([60.0, 3600.0, 86_400.0])),
    st.tuples(WHO, st.just("clock"), st.sampled_from(STEPS)),
    st.tuples(
        WHO, st.just("restart"), st.sampled_from([0.5, 2.0, 5.0]), st.sampled_from([0.0, 0.0013, 0.0037])
    ),
    st.tuples(
        WHO,
        st.just("second source"),
        st.sampled_from([0.3, 2.0]),
        st.sampled_from([0.0007, 0.0022, 0.0041]),
        st.sampled_from([0.0, 0.1, -3600.0]),
    ),
    st.tuples(
        st.just(BOTH), st.just("lumps"), st.sampled_from([0.5, 2.0]), st.sampled_from([0.02, 0.1, 0.3])
    ),
)
PLANS = st.lists(st.tuples(st.sampled_from([1.3, 1.7, 2.5, 5.0]), INTERRUPTIONS), min_size=1, max_size=2)


@few(10)
@given(st.sampled_from([0.0, 0.0011, 0.0032]), st.sampled_from([0.0, 2e-5]), PLANS)
# Each was a fault that was none: the stamps show no rate, or the clocks drifted apart or were set.
@example(0.0, 0.0, [(1.3, (BOTH, "silence", 3600.0))])
@example(0.0011, 0.0, [(5.0, ((SPOOL,), "second source", 2.0, 0.0022, -3600.0))])
@example(0.0032, 2e-5, [(1.3, (BOTH, "lumps", 2.0, 0.02)), (1.3, (BOTH, "silence", 3600.0))])
@example(0.0032, 0.0, [(2.5, (BOTH, "lumps", 2.0, 0.1)), (1.3, (BOTH, "restart", 2.0, 0.0037))])
def test_blocks_are_right_and_complete_around_interruptions_or_the_adapter_says_why_not(
    phase: float, jitter: float, plan: list
) -> None:
    sensors = Sensors({BODY: 0.0, SPOOL: phase}, jitter)
    for calm, interruption in plan:
        sensors.send(calm)
        sensors.interrupt(*interruption)
    sensors.send(AFTER)
    found = run(sensors)
    taken = found.right(sensors)
    assert [
        block.stamp for (_, block), times in zip(found.blocks, taken, strict=True) if not times.size
    ] == []
    fault = found.aligner.fault
    if sensors.apart or (fault is not None and sensors.rephased):
        # A sensor that samples at other instants than before looks like one whose clock was set.
        assert fault is not None
        assert fault.cause == CLOCK_STEP
        assert found.reports[-1][1] is Level.ERROR
        assert found.blocks[-1][0] < sensors.interrupted[-1][1] + 1.5
        return
    assert fault is None
    assert left_out(sensors, taken) == []
    judge_reports(found)
    judge_gate(found)
    if all(kind == "silence" and seconds < LONGEST_GAP for _, (_, kind, seconds, *_) in plan):
        assert {one: stream.lost for one, stream in found.aligner.streams.items()} == sensors.missing


def left_out(sensors: Sensors, taken: list[Times]) -> list[float]:
    """Return the true times of the body's samples that are in no block, beside the interruptions."""
    times = np.concatenate([stretch.times for stretch in sensors.sent[BODY]])
    times = times[(times > MARGIN) & (times < sensors.now - LATENCY)]
    for begin, end in sensors.interrupted:
        times = times[(times < begin - MARGIN) | (times > end + MARGIN)]
    known = np.sort(np.concatenate([*taken, [-1.0, math.inf]]))
    places = np.searchsorted(known, times)
    off = np.minimum(np.abs(known[places] - times), np.abs(known[places - 1] - times))
    return times[off > 1e-3 / RATE + 5e-5].tolist()


def judge_reports(found: Run) -> None:
    """Where no blocks come the adapter is not content, and it blames no driver's stamps."""
    arrivals = [0.0, *(arrival for arrival, _ in found.blocks)]
    for last, following in pairwise(arrivals):
        meanwhile = [level for at, level, _ in found.reports if last < at < following]
        assert following - last < 1.5 or any(level is not Level.OK for level in meanwhile)
    assert [text for _, _, text in found.reports if "show no sample rate" in text] == []


def judge_gate(found: Run) -> None:
    """A consumer uses the blocks again."""
    gate = BlockGate()
    verdicts = [gate.judge(block) for _, block in found.blocks]
    assert verdicts[-1] is Verdict.CONTINUES
    assert verdicts[-100:].count(Verdict.REFUSED) == 0
