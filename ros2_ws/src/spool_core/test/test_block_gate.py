from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Fault, Verdict, malformed
from spool_core.one_source import STALE

SIZE, PERIOD = 40, 5e-4
LENGTH = 20_000_000  # ns per block
START = 1_700_000_000_000_000_000
MINUTE = 60_000_000_000


#: Blocks of 20 ms after which the stamps have confirmed the rate.
RUN_IN = 100


def block(number: int, **changes: object) -> Block:
    """Return block ``number`` of a sound stream, with ``changes``."""
    samples = np.linspace(-1.0, 1.0, SIZE, dtype=np.float32)
    return replace(Block(START + number * LENGTH, number, PERIOD, samples, samples.copy()), **changes)


def running() -> BlockGate:
    """Return a gate of a stream whose rate is confirmed: block RUN_IN is due."""
    gate = BlockGate()
    for number in range(RUN_IN):
        gate.judge(block(number))
    assert gate.confirmed
    return gate


def after(number: int, **changes: object) -> Block:
    """Return the block that is ``number`` blocks behind the newest one, with ``changes``."""
    return block(RUN_IN - 1 + number, **changes)


def at(number: float) -> int:
    """Return the stamp that is due ``number`` blocks behind the newest one's, ns."""
    return START + round((RUN_IN - 1 + number) * LENGTH)


def with_value(value: float) -> np.ndarray:
    samples = np.zeros(SIZE, dtype=np.float32)
    samples[7] = value
    return samples


@dataclass(frozen=True)
class Case:
    """What the gate says to ``given`` after RUN_IN sound blocks."""

    given: Block
    verdict: Verdict
    fault: Fault | None
    lost: int = 0


EMPTY = np.zeros(0, dtype=np.float32)
CASES = {
    "next": Case(after(1), Verdict.CONTINUES, None),
    "lengths differ": Case(
        after(1, spool=np.zeros(39, dtype=np.float32)), Verdict.REFUSED, Fault.LENGTHS_DIFFER
    ),
    "empty": Case(after(1, body=EMPTY, spool=EMPTY), Verdict.REFUSED, Fault.LENGTHS_DIFFER),
    "period zero": Case(after(1, sample_period=0.0), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period negative": Case(after(1, sample_period=-PERIOD), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period NaN": Case(after(1, sample_period=float("nan")), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period infinite": Case(after(1, sample_period=float("inf")), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period of 1e300 s": Case(after(1, sample_period=1e300), Verdict.REFUSED, Fault.BAD_PERIOD),
    "period denormal": Case(after(1, sample_period=5e-324), Verdict.REFUSED, Fault.BAD_PERIOD),
    "broken word": Case(after(1, body=with_value(1e30)), Verdict.REFUSED, Fault.NOT_FINITE),
    "denormal samples": Case(after(1, body=with_value(1e-42)), Verdict.CONTINUES, None),
    "NaN in body": Case(after(1, body=with_value(np.nan)), Verdict.REFUSED, Fault.NOT_FINITE),
    "infinite in spool": Case(after(1, spool=with_value(-np.inf)), Verdict.REFUSED, Fault.NOT_FINITE),
    "stamp 0": Case(after(1, stamp=0), Verdict.REFUSED, Fault.NO_TIME),
    "stamp back": Case(after(1, stamp=at(-1)), Verdict.REFUSED, Fault.TIME_BACK),
    "duplicate": Case(after(0), Verdict.REFUSED, Fault.TIME_BACK),
    "late block": Case(after(-1), Verdict.REFUSED, Fault.TIME_BACK),
    "jump in sequence": Case(after(4), Verdict.RESTARTS, Fault.LOST, lost=3),
    "jump in sequence alone": Case(after(1, sequence=RUN_IN + 2), Verdict.REFUSED, Fault.SEQUENCE_AHEAD),
    "one false bit in sequence": Case(
        after(1, sequence=RUN_IN + 2**60), Verdict.REFUSED, Fault.SEQUENCE_AHEAD
    ),
    "sequence back": Case(block(0, stamp=at(1) + MINUTE), Verdict.REFUSED, Fault.SEQUENCE_BACK),
    "sequence stands still": Case(after(1, sequence=RUN_IN - 1), Verdict.REFUSED, Fault.SEQUENCE_BACK),
    "gap in time": Case(after(1, stamp=at(2)), Verdict.REFUSED, Fault.GAP),
    "far ahead": Case(after(1, stamp=at(1) + 5 * MINUTE), Verdict.REFUSED, Fault.GAP),
    "ahead by more than was lost": Case(after(4, stamp=at(1) + 5 * MINUTE), Verdict.REFUSED, Fault.GAP),
    "jitter of two samples": Case(after(1, stamp=at(1) + 1_000_000), Verdict.CONTINUES, None),
    "period changes": Case(after(1, sample_period=2 * PERIOD), Verdict.REFUSED, Fault.NEW_PERIOD),
    "far back": Case(after(1, stamp=at(1) - 5 * MINUTE), Verdict.REFUSED, Fault.TIME_BACK),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_verdict_and_counts_and_the_stream_goes_on_after_a_refused_block(case: Case) -> None:
    gate = running()
    before = gate.last
    assert gate.judge(case.given) is case.verdict
    refused = case.verdict is Verdict.REFUSED
    assert gate.refused == refused
    assert gate.accepted == RUN_IN + (not refused)
    assert gate.lost == case.lost
    assert gate.faults == ({} if case.fault is None else {case.fault: 1})
    assert gate.fault is case.fault
    assert (gate.recent.lost, gate.recent.refused) == (case.lost, refused)
    if refused:
        assert gate.last == before
        assert gate.judge(after(1)) is Verdict.CONTINUES
        assert gate.lost == 0
    else:
        given_block = case.given
        assert gate.last is not None
        assert gate.last[:4] == (
            given_block.stamp,
            given_block.end,
            given_block.sequence,
            given_block.sample_period,
        )


@pytest.mark.parametrize("minutes", [-5, 5])
def test_a_clock_that_was_set_costs_one_block(minutes: int) -> None:
    gate = running()
    verdicts = [gate.judge(after(n, stamp=at(n) + minutes * MINUTE)) for n in (1, 2, 3)]
    assert verdicts == [Verdict.REFUSED, Verdict.RESTARTS, Verdict.CONTINUES]
    assert gate.faults[Fault.NEW_TIME] == 1
    assert gate.lost == 0
    assert gate.confirmed


def test_another_sample_rate_costs_one_block_and_has_to_be_confirmed() -> None:
    gate = running()
    slower = [after(1 + n, stamp=at(1 + 2 * n), sample_period=2 * PERIOD) for n in range(50)]
    assert [gate.judge(each) for each in slower[:3]] == [Verdict.REFUSED, Verdict.RESTARTS, Verdict.CONTINUES]
    assert not gate.confirmed
    assert {gate.judge(each) for each in slower[3:]} == {Verdict.CONTINUES}
    assert gate.confirmed


#: First stamp of a source that begins to count again: where it was restarted, or a bag is played again.
AGAIN = {"source restarted": at(1) + MINUTE, "bag replayed again": START}


@pytest.mark.parametrize("first", AGAIN.values(), ids=AGAIN.keys())
def test_a_source_that_counts_anew_is_taken_once_the_first_one_is_stale(first: int) -> None:
    gate = running()
    verdicts = [gate.judge(block(number, stamp=first + number * LENGTH)) for number in range(100)]
    waits = round(STALE * 1e9 / LENGTH)
    assert set(verdicts[:waits]) == {Verdict.REFUSED}
    assert verdicts[waits : waits + 2] == [Verdict.RESTARTS, Verdict.CONTINUES]
    assert gate.faults[Fault.NEW_SOURCE] == 1
    assert gate.lost == 0


def certain(gate: BlockGate, blocks: list[Block]) -> list[Fault | None]:
    """Return the faults that are certain with each of the blocks, as far as one is."""
    found = []
    for each in blocks:
        gate.judge(each)
        found.append(gate.certain)
    return [fault for fault in found if fault is not None]


@pytest.mark.parametrize("first", AGAIN.values(), ids=AGAIN.keys())
def test_a_source_that_was_restarted_is_no_fault(first: int) -> None:
    faults = certain(running(), [block(number, stamp=first + number * LENGTH) for number in range(200)])
    assert {fault.cause for fault in faults} == {""}
    assert faults.count(Fault.NEW_SOURCE) == 1


@pytest.mark.parametrize("size", [1, 10, 50])
def test_a_second_source_is_a_fault_once_the_first_one_sends_again(size: int) -> None:
    pairs = [(after(n), after(n, stamp=at(n) + MINUTE, sequence=10**6 + n)) for n in range(1, 201)]
    parts = [pairs[at : at + size] for at in range(0, 200, size)]
    faults = certain(running(), [pair[which] for part in parts for which in (1, 0) for pair in part])
    assert {fault.cause for fault in faults} <= {"", "source"}
    assert Fault.SECOND_SOURCE in faults


@pytest.mark.parametrize("fault", [Fault.TIME_BACK, Fault.GAP, Fault.SEQUENCE_AHEAD])
def test_a_single_wrong_block_is_a_fault_once_no_other_of_its_kind_follows(fault: Fault) -> None:
    wrong = {
        Fault.TIME_BACK: after(3, stamp=at(-40)),
        Fault.GAP: after(3, stamp=at(300)),
        Fault.SEQUENCE_AHEAD: after(3, sequence=10**9),
    }[fault]
    gate = running()
    assert certain(gate, [after(1), after(2), wrong]) == []
    assert certain(gate, [after(4), after(5), after(6)]) == [Fault.LOST, fault]


def test_single_wrong_stamps_never_move_the_stream() -> None:
    gate = running()
    for number in range(30):
        if number % 5 == 3:
            gate.judge(after(100 + number, stamp=at(1) + (-1) ** number * 5 * MINUTE))
        assert gate.judge(after(1 + number)) is Verdict.CONTINUES
    assert gate.refused == 6
    assert gate.lost == 0


ORDERS = ("one by one", "bursts of a second", "at random", "other first")


@settings(max_examples=10)
@given(
    order=st.sampled_from(ORDERS),
    ahead=st.integers(-3_000, 5_000).filter(lambda blocks: abs(blocks) > 1),
    clock=st.sampled_from([0, 7_000_000, 3_600_000_000_000]),
)
def test_the_first_of_two_sources_keeps_its_place_for_a_minute(order: str, ahead: int, clock: int) -> None:
    gate = BlockGate()
    random = np.random.default_rng(1)
    ours = [block(5_000 + n) for n in range(3_000)]
    theirs = [block(5_000 + n, sequence=5_000 + n + ahead) for n in range(3_000)]
    theirs = [replace(each, stamp=each.stamp + clock) for each in theirs]
    size = {"bursts of a second": 50}.get(order, 1)
    taken: list[Block] = []
    for first in range(0, 3_000, size):
        pair = [ours[first : first + size], theirs[first : first + size]]
        turned = order == "other first" or (order == "at random" and random.random() < 0.5)
        for each in [one for part in (pair[::-1] if turned and first else pair) for one in part]:
            if gate.judge(each) is not Verdict.REFUSED:
                taken.append(each)
    assert [each.sequence for each in taken] == [each.sequence for each in ours]
    assert [each.stamp for each in taken] == [each.stamp for each in ours]
    assert gate.faults[Fault.SECOND_SOURCE] > 2_500
    assert gate.lost == 0


def test_a_second_source_that_once_carried_on_the_count_of_the_first_waits_as_long_as_any_other() -> None:
    """Its first block looks like the first one after a clock was set; then the first source sends again."""
    gate = running()
    theirs = [after(n, stamp=at(n) + MINUTE) for n in range(1, 101)]
    assert gate.judge(theirs[0]) is Verdict.REFUSED
    assert gate.judge(after(1)) is Verdict.CONTINUES
    verdicts = [gate.judge(each) for each in theirs[1:]]
    waits = round(STALE * 1e9 / LENGTH)
    assert set(verdicts[:waits]) == {Verdict.REFUSED}
    assert verdicts[waits] is Verdict.RESTARTS
    assert (gate.faults[Fault.NEW_SOURCE], Fault.NEW_TIME in gate.faults) == (1, False)


def test_a_source_that_takes_over_has_to_confirm_its_rate_though_a_third_one_sends() -> None:
    """Its samples take 1 % longer than it claims; what the first source showed says nothing of that."""
    gate, verdicts = running(), []
    for number in range(300):
        verdicts.append(gate.judge(block(number, stamp=at(1) + MINUTE + round(1.01 * number * LENGTH))))
        assert not (gate.confirmed and Fault.NEW_SOURCE in gate.faults)
        assert gate.judge(block(10**6 + number, stamp=at(number) + 2 * MINUTE)) is Verdict.REFUSED
    assert Verdict.RESTARTS in verdicts
    assert verdicts[-1] is Verdict.REFUSED
    assert gate.faults[Fault.RATE] > 0


@pytest.mark.parametrize("times", [1, 2])
def test_a_rate_that_is_wrong_after_the_clock_was_set_is_found_though_a_second_source_sends(
    times: int,
) -> None:
    """The first source goes on in an hour, with samples ``times`` as long that take 1 % longer still."""
    gate, verdicts = running(), []
    for number in range(1, 301):
        stamp = at(1) + 60 * MINUTE + round(1.01 * times * number * LENGTH)
        verdicts.append(gate.judge(after(number, stamp=stamp, sample_period=times * PERIOD)))
        assert gate.judge(block(10**6 + number, stamp=at(number) + 2 * MINUTE)) is Verdict.REFUSED
    assert verdicts[:3] == [Verdict.REFUSED, Verdict.RESTARTS, Verdict.CONTINUES]
    assert verdicts[-1] is Verdict.REFUSED
    assert gate.faults[Fault.RATE] > 0


def test_blocks_that_name_another_valve_are_never_used() -> None:
    gate = BlockGate()
    for number in range(200):
        assert gate.judge(block(number, source="valve_1")) is not Verdict.REFUSED
        assert gate.judge(block(number, source="valve_2")) is Verdict.REFUSED
    for number in range(200, 400):
        assert gate.judge(block(number, source="valve_2")) is Verdict.REFUSED
    assert gate.faults == {Fault.FOREIGN: 400}
    assert (gate.source, gate.other) == ("valve_1", "valve_2")
    assert gate.judge(block(400, source="")) is not Verdict.REFUSED  # a driver that names nothing


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
            assert gate.last is not None
            assert gate.last[:4] == (each.stamp, each.end, each.sequence, each.sample_period)
            assert np.isfinite(each.body).all()
            assert np.isfinite(each.spool).all()
            assert each.body.size == each.spool.size > 0
        if verdict is Verdict.CONTINUES:
            assert before is not None
            assert each.sequence == before[2] + 1
            assert each.stamp > before[0]
            assert each.source in ("", gate.source)
    assert gate.accepted + gate.refused == len(stream)
    assert sum(gate.faults.values()) >= gate.refused


#: What may befall a block of a stream, by itself; 0 to 4: nothing.
FAULTS: list[dict[str, object]] = [
    *({} for _ in range(5)),
    {"stamp": 0},
    {"sample_period": 2 * PERIOD},
    {"source": "another"},
    {"sequence": 10**9},
    {"body": np.full(SIZE, np.nan, np.float32)},
    {"body": np.zeros(3, np.float32)},
]


@settings(max_examples=100, deadline=None)
@given(
    changes=st.lists(st.sampled_from(FAULTS), max_size=30),
    lost=st.sets(st.integers(0, 29), max_size=2),
    pieces=st.lists(st.integers(1, 7), min_size=30, max_size=30),
    room=st.integers(0, 300),
    jitter=st.sampled_from([0, 10_000, 400_000, 4_000_000]),
)
def test_blocks_that_come_together_are_judged_as_one_by_one(
    changes: list[dict[str, object]], lost: set[int], pieces: list[int], room: int, jitter: int
) -> None:
    own, shared = BlockGate(), BlockGate()

    def at(number: int) -> dict[str, object]:
        return {"source": "valve", "stamp": START + number * LENGTH + (7919 * number % 5 - 2) * jitter}

    stream = [block(number, **at(number)) for number in range(RUN_IN)]
    stream += [
        block(RUN_IN + number, **(at(RUN_IN + number) | change))
        for number, change in enumerate(changes)
        if number not in lost
    ]
    used: list[Block] = []
    for one in stream:
        if own.judge(one) is not Verdict.REFUSED:
            used.append(one)
    taken: list[Block] = []
    for pieces_left in [RUN_IN, *pieces]:
        accepted = shared.accepted
        for one, verdict in shared.admitted(stream[:pieces_left], lambda: room):
            assert (verdict is not Verdict.REFUSED) == (shared.accepted > accepted)
            if verdict is not Verdict.REFUSED:
                taken.append(one)
            accepted = shared.accepted
        stream = stream[pieces_left:]
    counts = (shared.accepted, shared.refused, shared.lost, shared.faults, shared.last)
    assert counts == (own.accepted, own.refused, own.lost, own.faults, own.last)
    assert (shared.rate.state, shared.recent) == (own.rate.state, own.recent)
    for side in ("body", "spool"):
        whole, parts = ([getattr(one, side) for one in blocks] for blocks in (taken, used))
        assert np.array_equal(np.concatenate(whole), np.concatenate(parts))
    assert all(one.body.size < room + SIZE for one in taken if one.body.size > SIZE)


def test_the_gate_tells_what_came_before_the_newest_block() -> None:
    gate = BlockGate()
    assert gate.before is None
    gate.judge(block(0))
    first = gate.last
    assert gate.before is None
    gate.judge(block(1))
    assert gate.before == first


def test_recent_counts_forget_after_a_minute_and_lifetime_counts_do_not() -> None:
    gate = running()
    gate.judge(after(1, stamp=0))
    gate.judge(after(4))
    assert (gate.recent.lost, gate.recent.refused) == (3, 1)
    for number in range(5, 3_200):
        gate.judge(after(number))
    assert (gate.recent.lost, gate.recent.refused) == (0, 0)
    assert (gate.lost, gate.refused) == (3, 1)
