"""Which blocks may be used: the same judgement for every consumer of a stream."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from .block import Block

#: s, sample periods that a source can have; the lower one bounds what consumers set aside per second.
SHORTEST_PERIOD, LONGEST_PERIOD = 1.0e-6, 10.0

#: m/s^2, beyond what any accelerometer reads: a broken word, which integrals would carry on.
LARGEST_SAMPLE = 1.0e6
_SURELY_SMALL = 0.9 * LARGEST_SAMPLE**2


class Verdict(enum.Enum):
    """What a consumer does with a block."""

    CONTINUES = "continues"  # use it: it follows the one before without a gap
    RESTARTS = "restarts"  # use it, but forget the samples before: first block, gap or new source
    REFUSED = "refused"  # never use it


class Fault(enum.Enum):
    """Why a block was refused or a stream restarted; the value is the text people read."""

    LENGTHS_DIFFER = "body and spool differ in length or are empty"
    BAD_PERIOD = "sample_period is not a number from 1e-6 s to 10 s"
    NOT_FINITE = "samples are NaN, infinite or beyond 1e6 m/s^2"
    TIME_BACK = "stamp goes back"
    NO_TIME = "stamp is 0"
    LOST = "blocks lost (jump in sequence)"
    GAP = "stamp is ahead by more than was lost"
    SEQUENCE_BACK = "sequence goes back"
    NEW_SOURCE = "stream goes on from another place (source restarted, clock set)"
    NEW_PERIOD = "sample_period changed"


@dataclass(slots=True)
class BlockGate:
    """Judge the blocks of one stream in the order of their arrival and count the faults.

    A block that neither continues the stream nor explains itself as the first after a loss is refused; only
    if the next one continues it, the stream has really moved (a source that restarted, a clock set back, a
    bag replayed again) and goes on from there. A single wrong stamp costs a block, never the stream.

    Attributes:
        accepted: blocks that may be used.
        refused: blocks that must not be used.
        lost: blocks that never arrived, from jumps in ``sequence``.
        faults: how often each fault was seen.
        last: the last accepted block's stamp, end (ns), sequence and period (s), ``None`` before the first.
        before: what ``last`` was when the newest block came.
    """

    accepted: int = 0
    refused: int = 0
    lost: int = 0
    faults: dict[Fault, int] = field(default_factory=dict)
    last: tuple[int, int, int, float] | None = None
    before: tuple[int, int, int, float] | None = None
    _unconfirmed: tuple[int, int, int, float] | None = None

    def judge(self, block: Block) -> Verdict:
        """Return what to do with ``block``; never raises for what a message can hold."""
        self.before = self.last
        fault = malformed(block)
        if fault is not None:
            return self._refuse(fault)
        if self.last is None:
            return self._accept(block, Verdict.RESTARTS)
        fault = _departure(self.last, block)
        if fault is None:
            return self._accept(block, Verdict.CONTINUES)
        if fault is Fault.LOST:
            self.lost += block.sequence - self.last[2] - 1
            self._count(Fault.LOST)
            return self._accept(block, Verdict.RESTARTS)
        if self._unconfirmed is not None and _departure(self._unconfirmed, block) is None:
            self._count(Fault.NEW_SOURCE)
            return self._accept(block, Verdict.RESTARTS)
        self._unconfirmed = _place(block)
        return self._refuse(fault)

    def _accept(self, block: Block, verdict: Verdict) -> Verdict:
        self.accepted += 1
        self.last = _place(block)
        self._unconfirmed = None
        return verdict

    def _refuse(self, fault: Fault) -> Verdict:
        self.refused += 1
        self._count(fault)
        return Verdict.REFUSED

    def _count(self, fault: Fault) -> None:
        self.faults[fault] = self.faults.get(fault, 0) + 1


@dataclass(slots=True)
class SharedGate(BlockGate):
    """One judgement for several consumers of the same stream: ``admit`` judges, ``judge`` says it again."""

    _admitted: Block | None = None
    _verdict: Verdict = Verdict.REFUSED

    def admit(self, block: Block) -> Verdict:
        """Judge ``block``, which every consumer then takes once."""
        self._verdict = BlockGate.judge(self, block)
        self._admitted = block
        return self._verdict

    def judge(self, block: Block) -> Verdict:
        """Return what ``admit`` said of ``block``; judge it where it was not admitted."""
        return self._verdict if block is self._admitted else BlockGate.judge(self, block)


def _place(block: Block) -> tuple[int, int, int, float]:
    return block.stamp, block.end, block.sequence, block.sample_period


def _departure(last: tuple[int, int, int, float], block: Block) -> Fault | None:
    """Return how ``block`` departs from what was due after ``last``, or ``None`` where it continues."""
    stamp, end, sequence, period = last
    if block.stamp <= stamp:
        return Fault.TIME_BACK
    if block.sequence <= sequence:
        return Fault.SEQUENCE_BACK
    if abs(block.sample_period / period - 1.0) > 1e-6:
        return Fault.NEW_PERIOD
    duration = block.body.size * period * 1e9
    missing = block.sequence - sequence - 1
    if missing > 0:
        # Blocks may differ in length and clocks drift: only a stamp far ahead of the loss is not believed.
        return Fault.LOST if block.stamp - end <= 2.0 * missing * duration + 1e9 else Fault.GAP
    # Clocks of sources jitter: half a block is a gap, a few samples are not.
    if abs(block.stamp - end) > max(2.0 * period * 1e9, 0.5 * duration):
        return Fault.GAP
    return None


def malformed(block: Block) -> Fault | None:
    """Return what is wrong with ``block`` by itself, or ``None``."""
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
