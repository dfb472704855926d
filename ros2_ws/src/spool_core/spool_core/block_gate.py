"""Block gate, which blocks may be used: the same judgement for every consumer of a stream."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spool_core.block import RECENT, Block, BlockRun, RecentCounts, cut, joined, last_of
from spool_core.one_source import OneSource, Place, Standing
from spool_core.rate_check import RateCheck, RateState
from spool_core.record_limits import LIMITS

#: s, sample periods that a source can have; the lower one bounds what consumers set aside per second.
SHORTEST_PERIOD, LONGEST_PERIOD = 1.0e-6, 1.0 / LIMITS.rate

#: m/s^2, beyond what any accelerometer reads: a broken word, which integrals would carry on.
LARGEST_SAMPLE = 1.0e6
_SURELY_SMALL = 0.9 * LARGEST_SAMPLE**2


class Verdict(enum.Enum):
    """Verdict on a block: what a consumer does with it."""

    CONTINUES = "continues"  # use it: it follows the one before without a gap
    RESTARTS = "restarts"  # use it, but forget the samples before: first block, gap or new source
    REFUSED = "refused"  # never use it


class Fault(enum.Enum):
    """Fault of a block: why it was refused or a stream restarted; the value is the text people read."""

    LENGTHS_DIFFER = "body and spool differ in length or are empty"
    UNPAIRED = "the clock of one sensor was set: samples of body and spool cannot be paired"
    BAD_PERIOD = f"sample_period is not a number from {SHORTEST_PERIOD:g} s to {LONGEST_PERIOD:g} s"
    NOT_FINITE = "samples are NaN, infinite or beyond 1e6 m/s^2"
    TIME_BACK = "stamp goes back"
    NO_TIME = "stamp is 0"
    LOST = "blocks lost (jump in sequence)"
    DROPPED = "blocks dropped: this computer is too busy"
    GAP = "stamp jumps ahead by more than the lost blocks"
    SEQUENCE_BACK = "sequence goes back"
    SEQUENCE_AHEAD = "sequence is ahead of the time that the stamps show"
    ELSEWHERE = "another stream: the source was restarted, or a second one sends"
    NEW_SOURCE = "stream continues at another position (source restarted)"
    NEW_TIME = "stream continues at another time or rate (clock set)"
    NEW_PERIOD = "sample_period changed"
    RATE = "sample_period contradicts the stamps"
    SECOND_SOURCE = "a second source sends on the same topic"
    FOREIGN = "frame_id is another valve's"

    @property
    def cause(self) -> str:
        """The cause of a ``data_fault``: ``rate``, ``source``, ``lost``, ``overload`` and so on.

        It is empty where nothing is wrong: a source that was restarted, or a bag that is played again.
        """
        return _CAUSES.get(self, "malformed")

    @property
    def loss(self) -> bool:
        """Whether blocks of the same stream are missing, for whatever reason."""
        return self in (Fault.LOST, Fault.DROPPED)


_CAUSES = {
    Fault.RATE: "rate",
    Fault.NEW_SOURCE: "",
    Fault.ELSEWHERE: "",
    Fault.SECOND_SOURCE: "source",
    Fault.FOREIGN: "source",
    Fault.LOST: "lost",
    Fault.DROPPED: "overload",
    Fault.UNPAIRED: "clock_step",
}


@dataclass(slots=True)
class BlockGate:
    """Judges the blocks of one stream in the order of their arrival and count the faults.

    The first source keeps its place. A block that neither continues the stream nor explains itself as the
    first after a loss is refused. The stream moves to another place where its sequence goes on there (a clock
    that was set, another sample rate), or where another source sent for STALE s while the first one was
    silent (a source that restarted, a bag replayed again), see :class:`OneSource`. A single wrong stamp costs
    a block, never the stream. Blocks whose ``source`` is another valve's are never used, nor are those of a
    wrong sample rate.

    Attributes:
        accepted: blocks that may be used.
        refused: blocks that must not be used.
        lost: blocks that never arrived, from jumps in ``sequence``.
        faults: how often each fault was seen.
        fault: what was wrong with the newest block, ``None`` where nothing was.
        certain: the fault that is certain with the newest block. What a single block that departs from the
            stream is, wrong or the first one of a restarted source, the next ones tell.
        last: the last accepted block's stamp, end (ns), sequence and period (s), ``None`` before the first.
        before: what ``last`` was when the newest block came, or those that were joined with it.
        source: the valve's id, that of the first block that names one where none is given.
        rate: whether ``sample_period`` agrees with the stamps.
        recent: lost and refused blocks of the last minute of data.
        other: the id that a foreign block named last.

    """

    accepted: int = 0
    refused: int = 0
    lost: int = 0
    faults: dict[Fault, int] = field(default_factory=dict)
    fault: Fault | None = None
    certain: Fault | None = None
    last: Place | None = None
    before: Place | None = None
    source: str = ""
    rate: RateCheck = field(default_factory=RateCheck)
    recent: RecentCounts = field(default_factory=RecentCounts)
    other: str = ""
    _sources: OneSource[Fault] = field(default_factory=lambda: OneSource(departure))
    _held_back: Place | None = None
    _resumes: bool = False

    def resume(self) -> None:
        """Take the next good block as the first after a pause: what nobody asked for is not lost."""
        self._resumes = self.last is not None

    @property
    def confirmed(self) -> bool:
        """Whether the stamps confirm the sample rate: before, nothing is to be said of the valve."""
        return self.rate.state is RateState.CONFIRMED

    @property
    def judged_lately(self) -> tuple[int, int]:
        """How many blocks of the last minute of data were accepted, and how many the source sent in it."""
        missing = self.recent.lost + self.recent.refused
        length = math.inf if self.last is None else 1e-9 * (self.last.end - self.last.stamp)
        sent = min(self.accepted + self.refused + self.lost, max(missing, round(RECENT / length)))
        return sent - missing, sent

    def judge(self, block: Block) -> Verdict:
        """Return what to do with ``block``; never raises for what a message can hold."""
        self.before = self.last
        self.fault = self.certain = None
        if block.dropped < 0:
            self.resume()
        fault = malformed(block)
        if fault is not None:
            return self._refuse(fault)
        if self.source and block.source and block.source != self.source:
            self.other = block.source
            return self._refuse(Fault.FOREIGN)
        place = place_of(block)
        if self._resumes:
            self._resumes = False
            self._sources.begin()
            self.rate.go_on(place)
            return self._accept(block, place, Verdict.RESTARTS)
        follows = self.rate.take(place)
        if self.last is None:
            return self._accept(block, place, Verdict.RESTARTS)
        if follows and self.rate.state is RateState.WRONG:
            return self._hold_back(place)
        if self._held_back is not None:
            if departure(self._held_back, place) is None:
                return self._accept(block, place, Verdict.RESTARTS)
            if block.sequence == self._held_back.sequence + 1 and not self.confirmed:
                return self._hold_back(place)
        lost, verdict = self.lost, self._place(block, place, self.last)
        if self.lost > lost and not follows:
            self.rate.go_on(place)
        return verdict

    def _place(self, block: Block, place: Place, last: Place) -> Verdict:
        """Say which stream ``block`` belongs to, and what follows for it."""
        fault = departure(last, place)
        rival = self._sources.rival(last, place, fault)
        if rival is not None:
            # It is of another stream than the first one.
            standing = self._sources.follow(rival, place)
            if standing is Standing.MOVED:
                self._count(Fault.NEW_TIME)
                self.rate.go_on(place)
                return self._accept(block, place, Verdict.RESTARTS)
            if standing is Standing.RESTARTED:
                self._count(Fault.NEW_SOURCE)
                self.rate.begin(place)
                return self._accept(block, place, Verdict.RESTARTS)
            return self._refuse(Fault.SECOND_SOURCE if standing is Standing.SECOND else Fault.ELSEWHERE)
        if fault is None:
            return self._accept(block, place, Verdict.CONTINUES)
        if fault is Fault.LOST:
            missing = block.sequence - last.sequence - 1
            self.lost += missing
            self.recent.count(missing, 0)
            self._count(Fault.DROPPED if block.dropped else Fault.LOST)
            return self._accept(block, place, Verdict.RESTARTS)
        direct = block.sequence == last.sequence + 1
        if fault is Fault.GAP and direct and self.rate.state is RateState.UNKNOWN:
            return self._hold_back(place)
        self._sources.depart(last, place, fault, direct=direct)
        verdict = self._refuse(fault)
        self.certain = self._sources.take_settled()
        return verdict

    def _hold_back(self, place: Place) -> Verdict:
        self._held_back = place
        self._sources.still_there(place)
        return self._refuse(Fault.RATE)

    def _accept(self, block: Block, place: Place, verdict: Verdict) -> Verdict:
        self.accepted += 1
        self.last, self._held_back = place, None
        self.source = self.source or block.source
        if self._sources.rivals:
            second = self._sources.still_there(place)
            if second:  # its blocks until now were taken for those of a restarted source
                blocks = self.faults.get(Fault.SECOND_SOURCE, 0) + self.faults.pop(Fault.ELSEWHERE, 0)
                self.faults[Fault.SECOND_SOURCE] = blocks
            if self.certain is None:
                self.certain = Fault.SECOND_SOURCE if second else self._sources.take_settled()
            if verdict is Verdict.RESTARTS and not (self.fault and self.fault.loss):
                self._sources.begin()
        self.recent.advance(block.body.size * block.sample_period)
        return verdict

    def _refuse(self, fault: Fault) -> Verdict:
        self.refused += 1
        if self.last is not None:
            self.recent.advance(1e-9 * (self.last.end - self.last.stamp))
        self.recent.count(0, 1)
        self._count(fault)
        return Verdict.REFUSED

    def _count(self, fault: Fault) -> None:
        self.fault = self.certain = fault
        self.faults[fault] = self.faults.get(fault, 0) + 1

    def admitted(
        self, items: Iterable[Block | BlockRun], room: Callable[[], int]
    ) -> Iterator[tuple[Block, Verdict]]:
        """Yield the blocks of ``items`` in order with their verdicts; take one before the next is judged.

        Those that continue the stream are joined as long as ``room`` samples are not full: a consumer that
        has none takes each by itself. The last one's stamp is kept: what falls due does so at the end.
        """
        left = list(items)
        while left:
            ahead, behind = cut(left, self._going_on(left, room()))
            whole = _as_one(ahead) if ahead else None
            if whole is None or malformed(whole) is not None:
                (first,), left = cut(left, 1)
                block = last_of(first)
                yield block, self.judge(block)
                continue
            count = self._follow(ahead)
            if count < whole.blocks:
                ahead, behind = cut(left, count)
            left = behind
            if ahead:
                whole = whole if count == whole.blocks else _as_one(ahead)
                last, self.fault, self.certain, self.before = last_of(ahead[-1]), None, None, self.last
                verdict = self._accept(last, place_of(last), Verdict.CONTINUES)
                self.recent.advance((whole.body.size - last.body.size) * last.sample_period)
                self.accepted += whole.blocks - 1
                yield whole, verdict
            if self.rate.state is RateState.WRONG:
                self.before, self.fault, self.certain = self.last, None, None
                (first,), left = cut(left, 1)
                block = last_of(first)
                yield block, self._hold_back(place_of(block))

    def _going_on(self, items: Sequence[Block | BlockRun], room: int) -> int:
        """Return how many blocks go on with the stream as they should, up to ``room`` samples.

        Their samples are not looked at.
        """
        unsettled = self._sources.rivals or self._held_back is not None or self._resumes
        if self.last is None or not self.confirmed or unsettled:
            return 0
        last, size, found = self.last, items[0].size, 0
        most = -(-room // max(size, 1))
        for item in items:
            same = item.sample_period == last.period and item.source == self.source and item.size == size > 0
            if found >= most or not same:
                break
            first = next(_places(item))
            if departure(last, first) is not None:
                break
            count = min(len(item), most - found) if isinstance(item, BlockRun) else 1
            ahead = (count - 1) * (first.end - first.stamp)
            last = Place(first.stamp + ahead, first.end + ahead, first.sequence + count - 1, first.period)
            found += count
        return found

    def _follow(self, items: Sequence[Block | BlockRun]) -> int:
        """Take the stamps of blocks that go on; return how many there are until the rate is doubted."""
        count = 0
        for item in items:
            for place in _places(item):
                self.rate.take(place)
                count += self.rate.state is not RateState.WRONG
                if not self.confirmed:
                    return count
        return count


def place_of(block: Block) -> Place:
    """Return the place of a block that is not ``malformed``."""
    return Place(block.stamp, block.end, block.sequence, block.sample_period)


def _places(item: Block | BlockRun) -> Iterator[Place]:
    """Yield the places of blocks that go on."""
    length, stamp, sequence = round(item.size * item.sample_period * 1e9), item.stamp, item.sequence
    for number in range(len(item) if isinstance(item, BlockRun) else 1):
        at = stamp + number * length
        yield Place(at, at + length, sequence + number, item.sample_period)


def _as_one(items: Sequence[Block | BlockRun]) -> Block:
    """Return blocks that go on as one, with the last one's stamp, so that what falls due does so by that."""
    whole, last = joined(items), last_of(items[-1])
    if last is whole:
        return whole
    ahead = (whole.body.size - last.body.size) * whole.sample_period
    return replace(whole, stamp=last.stamp - round(ahead * 1e9))


def departure(last: Place, block: Place) -> Fault | None:
    """Return how ``block`` departs from what was due after ``last``, or ``None`` where it continues."""
    if block.stamp <= last.stamp:
        return Fault.TIME_BACK
    if block.sequence <= last.sequence:
        return Fault.SEQUENCE_BACK
    if abs(block.period / last.period - 1.0) > 1e-6:
        return Fault.NEW_PERIOD
    duration = block.end - block.stamp
    # Clocks of sources jitter: half a block is a gap, a few samples are not.
    jitter = max(2e9 * last.period, 0.5 * duration)
    ahead, missing = block.stamp - last.end, block.sequence - last.sequence - 1
    if missing > 0:
        # Blocks may differ in length and clocks drift: only a stamp far from the loss is not believed.
        if ahead < 0.5 * missing * min(duration, last.end - last.stamp) - jitter:
            return Fault.SEQUENCE_AHEAD
        return Fault.LOST if ahead <= 2.0 * missing * duration + 1e9 else Fault.GAP
    return Fault.GAP if abs(ahead) > jitter else None


def malformed(block: Block) -> Fault | None:
    """Return what is wrong with ``block`` by itself, or ``None``."""
    if block.body.size > 0 == block.spool.size:
        return Fault.UNPAIRED
    if block.body.size != block.spool.size or block.body.size == 0:
        return Fault.LENGTHS_DIFFER
    if not SHORTEST_PERIOD <= block.sample_period <= LONGEST_PERIOD:
        return Fault.BAD_PERIOD
    if block.stamp <= 0:
        return Fault.NO_TIME
    for samples in (block.body, block.spool):
        # No sample is larger than the root of the sum of squares, which costs a tenth; NaN compares false.
        if not (np.dot(samples, samples) < _SURELY_SMALL or (np.abs(samples) <= LARGEST_SAMPLE).all()):
            return Fault.NOT_FINITE
    return None
