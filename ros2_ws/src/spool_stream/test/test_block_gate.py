from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_stream.block import Block
from spool_stream.block_gate import BlockGate, Fault, SharedGate, Verdict, malformed

SIZE, PERIOD = 40, 5e-4
LENGTH = 20_000_000  # ns per block
START = 1_700_000_000_000_000_000
MINUTE = 60_000_000_000


def block(number: int, **changes: object) -> Block:
    """Return block ``number`` of a sound stream, with ``changes``."""
    samples = np.linspace(-1.0, 1.0, SIZE, dtype=np.float32)
    return replace(Block(START + number * LENGTH, number, PERIOD, samples, samples.copy()), **changes)


def with_value(value: float) -> np.ndarray:
    samples = np.zeros(SIZE, dtype=np.float32)
    samples[7] = value
    return samples


@dataclass(frozen=True)
class Case:
    """What the gate says to ``given`` after the sound blocks 0, 1 and 2."""

    given: Block
    verdict: Verdict
    fault: Fault | None
    lost: int = 0


EMPTY = np.zeros(0, dtype=np.float32)
CASES = {
    "next": Case(block(3), Verdict.CONTINUES, None),
    "lengths differ": Case(
        block(3, spool=np.zeros(39, dtype=np.float32)), Verdict.REFUSED, Fault.LENGTHS_DIFFER
    ),
    "empty": Case(block(3, body=EMPTY, spool=EMPTY), Verdict.REFUSED, Fault.LENGTHS_DIFFER),
    "period zero": Case(block(3, sample_period=0.0), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period negative": Case(block(3, sample_period=-PERIOD), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period NaN": Case(block(3, sample_period=float("nan")), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period infinite": Case(block(3, sample_period=float("inf")), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period of 1e300 s": Case(block(3, sample_period=1e300), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period denormal": Case(block(3, sample_period=5e-324), Verdict.REFUSED, Fault.BAD_PERIOD),
    "broken word": Case(block(3, body=with_value(1e30)), Verdict.REFUSED, Fault.NOT_FINITE),
    "denormal samples": Case(block(3, body=with_value(1e-42)), Verdict.CONTINUES, None),
    "NaN in body": Case(block(3, body=with_value(np.nan)), Verdict.REFUSED, Fault.NOT_FINITE),
    "infinite in spool": Case(block(3, spool=with_value(-np.inf)), Verdict.REFUSED, Fault.NOT_FINITE),
    "stamp 0": Case(block(3, stamp=0), Verdict.REFUSED, Fault.NO_TIME),
    "stamp back": Case(block(3, stamp=START + LENGTH), Verdict.REFUSED, Fault.TIME_BACK),
    "duplicate": Case(block(2), Verdict.REFUSED, Fault.TIME_BACK),
    "late block": Case(block(1), Verdict.REFUSED, Fault.TIME_BACK),
    "jump in sequence": Case(block(6), Verdict.RESTARTS, Fault.LOST, lost=3),
    "jump in sequence alone": Case(block(3, sequence=5), Verdict.RESTARTS, Fault.LOST, lost=2),
    "sequence back": Case(block(0, stamp=START + 3 * LENGTH + MINUTE), Verdict.REFUSED, Fault.SEQUENCE_BACK),
    "sequence stands still": Case(block(3, sequence=2), Verdict.REFUSED, Fault.SEQUENCE_BACK),
    "gap in time": Case(block(3, stamp=START + 4 * LENGTH), Verdict.REFUSED, Fault.GAP),
    "far ahead": Case(block(3, stamp=START + 5 * MINUTE), Verdict.REFUSED, Fault.GAP),
    "ahead by more than was lost": Case(block(6, stamp=START + 5 * MINUTE), Verdict.REFUSED, Fault.GAP),
    "jitter of two samples": Case(block(3, stamp=START + 3 * LENGTH + 1_000_000), Verdict.CONTINUES, None),
    "period changes": Case(block(3, sample_period=2 * PERIOD), Verdict.REFUSED, Fault.NEW_PERIOD),
    "far back": Case(block(3, stamp=START - 5 * MINUTE), Verdict.REFUSED, Fault.TIME_BACK),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_verdict_and_counts(case: Case) -> None:
    gate = BlockGate()
    verdicts = [gate.judge(block(number)) for number in range(3)]
    assert verdicts == [Verdict.RESTARTS, Verdict.CONTINUES, Verdict.CONTINUES]
    before = gate.last
    assert gate.judge(case.given) is case.verdict
    refused = case.verdict is Verdict.REFUSED
    assert gate.refused == refused
    assert gate.accepted == 3 + (not refused)
    assert gate.lost == case.lost
    assert gate.faults == ({} if case.fault is None else {case.fault: 1})
    if refused:
        assert gate.last == before
    else:
        given_block = case.given
        assert gate.last == (
            given_block.stamp,
            given_block.end,
            given_block.sequence,
            given_block.sample_period,
        )


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.verdict is Verdict.REFUSED])
def test_stream_goes_on_after_a_refused_block(name: str) -> None:
    gate = BlockGate()
    for number in range(3):
        gate.judge(block(number))
    gate.judge(CASES[name].given)
    assert gate.judge(block(3)) is Verdict.CONTINUES
    assert gate.lost == 0


MOVED = {
    "clock set back": [block(number, stamp=block(number).stamp - 5 * MINUTE) for number in (3, 4, 5)],
    "clock set ahead": [block(number, stamp=block(number).stamp + 5 * MINUTE) for number in (3, 4, 5)],
    "source restarted": [block(number, stamp=block(number).stamp + MINUTE) for number in (0, 1, 2)],
    "bag replayed again": [block(number) for number in (0, 1, 2)],
    "another sample rate": [
        block(3 + number, stamp=START + (3 + 2 * number) * LENGTH, sample_period=2 * PERIOD)
        for number in (0, 1, 2)
    ],
}


@pytest.mark.parametrize("moved", MOVED.values(), ids=MOVED.keys())
def test_a_stream_that_really_moved_costs_one_block(moved: list[Block]) -> None:
    gate = BlockGate()
    for number in range(3):
        gate.judge(block(number))
    verdicts = [gate.judge(each) for each in moved]
    assert verdicts == [Verdict.REFUSED, Verdict.RESTARTS, Verdict.CONTINUES]
    assert gate.faults[Fault.NEW_SOURCE] == 1
    assert gate.lost == 0


def test_single_wrong_stamps_never_move_the_stream() -> None:
    gate = BlockGate()
    for number in range(30):
        if number % 5 == 3:
            gate.judge(block(100 + number, stamp=START + (-1) ** number * 5 * MINUTE))
        expected = Verdict.CONTINUES if number else Verdict.RESTARTS
        assert gate.judge(block(number)) is expected
    assert gate.refused == 6
    assert gate.lost == 0


def test_end_of_a_block_is_where_the_next_is_due() -> None:
    assert block(0).end == START + LENGTH


MAYBE_BAD = st.sampled_from([0.0, 1.0, -3.5, 3e38, float("nan"), float("inf")])
ANY_BLOCK = st.builds(
    lambda stamp, sequence, period, body, spool: Block(
        stamp, sequence, period, np.array(body, dtype=np.float32), np.array(spool, dtype=np.float32)
    ),
    st.one_of(st.integers(-10, 10), st.integers(START, START + 20 * LENGTH)),
    st.integers(0, 30),
    st.sampled_from([PERIOD, PERIOD, PERIOD, 1e-3, 0.0, -1.0, float("nan"), 1e300, 5e-324]),
    st.lists(MAYBE_BAD, max_size=3),
    st.lists(MAYBE_BAD, max_size=3),
)


@settings(max_examples=200, deadline=None)
@given(stream=st.lists(st.one_of(ANY_BLOCK, st.integers(0, 20).map(block)), max_size=25))
def test_a_refused_block_never_changes_what_the_gate_knows(stream: list[Block]) -> None:
    gate = BlockGate()
    for each in stream:
        before, accepted, lost = gate.last, gate.accepted, gate.lost
        verdict = gate.judge(each)
        if malformed(each) is not None:
            assert verdict is Verdict.REFUSED
        if verdict is Verdict.REFUSED:
            assert (gate.last, gate.accepted, gate.lost) == (before, accepted, lost)
        else:
            assert gate.last == (each.stamp, each.end, each.sequence, each.sample_period)
            assert np.isfinite(each.body).all()
            assert np.isfinite(each.spool).all()
            assert each.body.size == each.spool.size > 0
        if verdict is Verdict.CONTINUES:
            assert before is not None
            assert each.sequence == before[2] + 1
            assert each.stamp > before[0]
    assert gate.accepted + gate.refused == len(stream)
    assert sum(gate.faults.values()) >= gate.refused


def test_a_shared_gate_says_to_all_what_a_gate_of_their_own_would() -> None:
    blocks = [block(n) for n in range(5)]
    stream = [*blocks[:2], replace(blocks[2], stamp=0), *blocks[3:], blocks[0], blocks[1]]
    own, shared = BlockGate(), SharedGate()
    for one in stream:
        verdict = own.judge(one)
        assert shared.admit(one) is verdict
        assert shared.judge(one) is verdict
        assert shared.judge(one) is verdict
        assert (shared.last, shared.before) == (own.last, own.before)
    assert (shared.accepted, shared.refused, shared.lost) == (own.accepted, own.refused, own.lost)
    assert shared.faults == own.faults


def test_the_gate_tells_what_came_before_the_newest_block() -> None:
    gate = BlockGate()
    assert gate.before is None
    gate.judge(block(0))
    first = gate.last
    assert gate.before is None
    gate.judge(block(1))
    assert gate.before == first
