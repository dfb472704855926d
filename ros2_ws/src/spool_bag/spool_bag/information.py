"""What is in a bag: topics, valves, what was lost, and the samples over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from spool_core.block import Block, BlockRun
from spool_core.block_gate import LONGEST_PERIOD, SHORTEST_PERIOD, BlockGate, Verdict
from spool_core.cdr import OilTemperature, Reading, Speed
from spool_core.text import plural, printable
from spool_core.uncertainty import BY_NAME, named

from spool_bag.blocks import Span
from spool_bag.mcap_file import Damage
from spool_bag.reader import BagReader

#: Steps of a valve's time that are listed one by one.
MOST_STEPS = 10

#: ns, beyond what lost blocks explain, by which a stamp may be ahead: as the judgement of blocks has it.
AHEAD = 1_000_000_000
#: ns of blocks lost in one piece that a jump in sequence explains: a day.
LONGEST_LOSS = 86_400_000_000_000


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """Summary of a topic; ``rate_per_s`` over the bag's duration, ``None`` where that is not known."""

    name: str
    type: str
    messages: int
    rate_per_s: float | None


@dataclass(frozen=True, slots=True)
class ValveSummary:
    """Summary of the accelerations of one valve.

    ``sample_rate`` in Hz, ``first_stamp_ns`` and ``end_stamp_ns`` are those of the usable blocks, ``None``
    without any; ``lost_blocks`` come from jumps in ``sequence``; ``refused_blocks`` are malformed,
    ``undecodable_blocks`` no blocks at all; ``duration_s`` leaves out where the time stepped, and ``times``
    counts its own times; ``faults`` counts each kind by its text.
    """

    name: str
    blocks: int
    samples: int
    lost_blocks: int
    refused_blocks: int
    undecodable_blocks: int
    times: int
    temperatures: int
    faults: Mapping[str, int]
    sample_rate: float | None = field(metadata=named("sample_rate_Hz"))
    duration_s: float
    first_stamp_ns: int | None
    end_stamp_ns: int | None
    speeds: int = 0


@dataclass(frozen=True, slots=True)
class BagInformation:
    """Summary of a bag as a whole, as ``--json`` writes it.

    ``duration_s`` is by acquisition time, without the steps of a clock that was set; ``lost_messages`` were
    in damaged places, and are ``lost_messages_estimated`` where nothing but their size tells.
    """

    bag: Path
    size_bytes: int
    closed: bool
    duration_s: float | None
    first_stamp_ns: int | None
    topics: tuple[TopicSummary, ...] = ()
    valves: tuple[ValveSummary, ...] = field(default=(), metadata=BY_NAME)
    damages: tuple[Damage, ...] = ()
    lost_messages: int = 0
    lost_messages_estimated: bool = False
    undecodable_messages: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def describe(path: Path | str, span: Span | None = None) -> BagInformation:
    """Return what lies in the bag at ``path``, read through; damage is listed, not raised. Of ``span`` only
    what lies in it.

    Raises:
        InputError: there is no bag at ``path``.
    """
    reader = BagReader(path, skip_damage=True, span=span or Span())
    passes = {name: _Pass() for name in reader.valves}
    for name, item in reader.streams():
        passes[name].take(item)
    undecodable = {topic.strip("/"): count for topic, count in reader.undecodable.items()}
    valves = tuple(
        one.summary(name, undecodable.get(f"{name}/acceleration".strip("/"), 0))
        for name, one in passes.items()
    )
    first = min((valve.first_stamp_ns for valve in valves if valve.first_stamp_ns is not None), default=None)
    duration = duration_of([one.timeline for one in passes.values()])
    if first is None:
        first, duration = _logged(reader)
    topics = tuple(
        TopicSummary(name, topic.type, topic.messages, topic.messages / duration if duration else None)
        for name, topic in reader.topics.items()
    )
    lost, estimated = reader.lost()
    warnings = list(reader.warnings)
    # Messages that metadata.yaml counts, but that neither exist nor are explained by damage.
    short = reader.told - sum(topic.messages for topic in topics) - lost
    if short > 0 and reader.span.is_all:
        warnings.append(
            f"{reader.path}: metadata.yaml counts {reader.told} messages: at least {short} more are missing"
        )
    warnings += [
        step_text(name, step) for name, one in passes.items() for step in one.timeline.steps[:MOST_STEPS]
    ]
    warnings += [
        f"{topic}: {plural(count, 'message')} left out: the bytes do not fit the type"
        for topic, count in reader.undecodable.items()
    ]
    return BagInformation(
        Path(path),
        sum(file.path.stat().st_size for file in reader.files),
        reader.closed,
        duration,
        first,
        topics,
        valves,
        tuple(reader.damages),
        lost,
        estimated,
        dict(reader.undecodable),
        tuple(printable(warning) for warning in warnings),
    )


def summarise(name: str, items: Iterable[Block | Reading]) -> ValveSummary:
    """Return what ``items`` hold of the valve ``name``, whatever they were read from."""
    one = _Pass()
    for item in items:
        one.take(item)
    return one.summary(name, 0)


class TimeSpan(NamedTuple):
    """Stamps of the first sample and behind the last, what had passed ``before``; in ns."""

    first: int
    end: int
    before: int


class ClockStep(NamedTuple):
    """``at`` s after the record's beginning, by ``by`` s (negative: back)."""

    at: float
    by: float


@dataclass(slots=True)
class Timeline:
    """Time base of one valve: the spans that its blocks cover, in their order.

    A block that does not follow begins a new span only if the next one follows it: a wrong stamp is none.
    """

    spans: list[TimeSpan] = field(default_factory=list)
    _last: _BlockPlace | None = None
    _unconfirmed: _BlockPlace | None = None

    def take(self, block: Block) -> None:
        """Take a block; malformed ones are left out."""
        usual = SHORTEST_PERIOD <= block.sample_period <= LONGEST_PERIOD
        if not (usual and block.body.size and block.stamp > 0):
            return
        place = _BlockPlace(block.stamp, block.end, block.sequence)
        if self._last is None:
            self.spans.append(TimeSpan(place.first, place.end, 0))
        elif _follows(self._last, place):
            span = self.spans[-1]
            if place.end > span.end:
                self.spans[-1] = span._replace(end=place.end)
        elif self._unconfirmed is not None and _follows(self._unconfirmed, place):
            before = self.spans[-1].before + self.spans[-1].end - self.spans[-1].first
            self.spans.append(TimeSpan(self._unconfirmed.first, place.end, before))
        else:
            self._unconfirmed = place
            return
        self._last, self._unconfirmed = place, None

    def take_run(self, run: BlockRun) -> None:
        """Take the blocks of ``run``, as ``take`` does one by one."""
        for block in run.blocks():
            self.take(block)
            if self._last is not None and self._last.first == block.stamp and self._unconfirmed is None:
                # The others follow it, and only the last one says where the span ends.
                self.take(run.last)
                return

    @property
    def duration(self) -> int:
        """All spans together, ns; never negative."""
        return self.spans[-1].before + self.spans[-1].end - self.spans[-1].first if self.spans else 0

    @property
    def steps(self) -> list[ClockStep]:
        """Where the clock was set, or a source started again."""
        return [
            ClockStep(later.before * 1e-9, (later.first - earlier.end) * 1e-9)
            for earlier, later in pairwise(self.spans)
        ]

    def since(self, stamp: int, earliest: int = 0) -> int:
        """Return the ns that had passed at ``stamp`` since the first sample; of several spans the last one.

        ``earliest`` is a time that had passed already, for stamps that were told one after the other.
        """
        if not self.spans:
            return 0
        inside = [span for span in self.spans if span.first <= stamp <= span.end]
        if not inside:
            inside = [min(self.spans, key=lambda span: max(span.first - stamp, stamp - span.end))]
        passed = [span.before + stamp - span.first for span in inside]
        return next((one for one in passed if one >= earliest), passed[-1])


def duration_of(timelines: Sequence[Timeline]) -> float | None:
    """Return the time (s) that the valves' spans cover together, at least that of the longest valve."""
    spans = sorted((span.first, span.end) for timeline in timelines for span in timeline.spans)
    if not spans:
        return None
    covered, gaps, reached = 0, 0, spans[0][0]
    for first, end in spans:
        gaps += max(first - reached, 0)
        covered += max(end - max(first, reached), 0)
        reached = max(reached, end)
    # Without a step, what lies between valves that were recorded one after another is time as well.
    whole = all(len(timeline.spans) < 2 for timeline in timelines)
    return max(covered + whole * gaps, *(timeline.duration for timeline in timelines)) / 1e9


def step_text(valve: str, step: ClockStep) -> str:
    """Return the line that tells people of a step."""
    way = "back" if step.by < 0.0 else "ahead"
    return (
        f"/{valve}: its time jumps {way} by {abs(step.by):.3f} s at {step.at:.1f} s (clock set or source "
        "started again): time continues from there"
    )


def _logged(reader: BagReader) -> tuple[int | None, float | None]:
    """Return first stamp (ns) and duration (s) by the times of reception, where no valve has a block."""
    first = last = None
    for _, record in reader.records():
        first = record.log_time if first is None else min(first, record.log_time)
        last = record.log_time if last is None else max(last, record.log_time)
    return first, None if first is None or last is None else (last - first) / 1e9


@dataclass(slots=True)
class _Pass:
    """Counts of one pass over a valve's blocks."""

    gate: BlockGate = field(default_factory=BlockGate)
    timeline: Timeline = field(default_factory=Timeline)
    samples: int = 0
    temperatures: int = 0
    speeds: int = 0
    rate: float | None = None

    def take(self, item: Block | Reading) -> None:
        """Take a block or a slow reading."""
        if not isinstance(item, Block):
            self.temperatures += isinstance(item, OilTemperature)
            self.speeds += isinstance(item, Speed)
            return
        self.timeline.take(item)
        if self.gate.judge(item) is not Verdict.REFUSED:
            self.samples += item.body.size
            self.rate = 1.0 / item.sample_period

    def summary(self, name: str, undecodable: int) -> ValveSummary:
        """Return what was counted."""
        spans = self.timeline.spans
        return ValveSummary(
            name,
            self.gate.accepted + self.gate.refused,
            self.samples,
            self.gate.lost,
            self.gate.refused,
            undecodable,
            len(spans),
            self.temperatures,
            {fault.value: count for fault, count in self.gate.faults.items()},
            self.rate,
            self.timeline.duration / 1e9,
            min((span.first for span in spans), default=None),
            max((span.end for span in spans), default=None),
            self.speeds,
        )


class _BlockPlace(NamedTuple):
    first: int
    end: int
    sequence: int


def _follows(last: _BlockPlace, place: _BlockPlace) -> bool:
    """Return whether ``place`` lies on the same clock as ``last``, blocks lost in between or not."""
    missing = max(place.sequence - last.sequence - 1, 0)
    ahead = min(2 * missing * (place.end - place.first), LONGEST_LOSS) + AHEAD
    return last.end - AHEAD <= place.first <= last.end + ahead
