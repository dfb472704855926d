from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Fault, Verdict
from spool_core.rate_check import RateState

PERIOD = 5e-4
START = 1_700_000_000_000_000_000
SAMPLES = np.linspace(-1.0, 1.0, 10_000, dtype=np.float32)


def stream(
    seconds: float, *, claimed: float = PERIOD, size: int = 40, jitter: float = 0.0, seed: int = 1
) -> list[Block]:
    """Return blocks of ``size`` samples that come every PERIOD s and claim to be ``claimed`` s apart.

    ``jitter``: each stamp lies anywhere within so many s about where it should.
    """
    random = np.random.default_rng(seed)
    count = round(seconds / (size * PERIOD))
    off = random.uniform(-jitter, jitter, count)
    stamps = [START + round((n * size * PERIOD + off[n]) * 1e9) for n in range(count)]
    part = SAMPLES[:size]
    return [Block(stamp, n, claimed, part, part) for n, stamp in enumerate(stamps)]


OFF = (0.005, 0.01, 0.05, 0.1, 0.3, 0.9)


@settings(max_examples=25)
@given(
    size=st.sampled_from([8, 40, 200, 1000]), off=st.sampled_from([*(-one for one in OFF), *OFF, 1.0, 4.0])
)
def test_a_period_that_contradicts_the_stamps_is_refused_within_3_s_and_never_confirmed(
    off: float, size: int
) -> None:
    gate = BlockGate()
    refused_at = None
    for block in stream(6.0, claimed=PERIOD * (1.0 + off), size=size):
        verdict = gate.judge(block)
        assert not gate.confirmed
        if gate.fault is Fault.RATE:
            refused_at = refused_at or 1e-9 * (block.stamp - START)
            last = verdict
    assert refused_at is not None
    assert refused_at <= 3.0
    assert last is Verdict.REFUSED
    assert set(gate.faults) == {Fault.RATE}
    assert gate.rate.departure == pytest.approx(off, rel=0.03, abs=1e-4) or abs(off) >= 0.3
    assert gate.rate.state is RateState.WRONG


@pytest.mark.parametrize("off", [-0.9, -0.3, -0.005, 0.005, 0.3, 0.9])
def test_a_period_that_becomes_wrong_later_is_refused_within_3_s(off: float) -> None:
    gate = BlockGate()
    blocks = stream(20.0)
    for block in blocks[:500]:
        gate.judge(block)
    assert gate.confirmed
    late = [gate.judge(replace(block, sample_period=PERIOD * (1.0 + off))) for block in blocks[500:650]]
    assert gate.rate.state is RateState.WRONG
    assert late[-1] is Verdict.REFUSED
    back = [gate.judge(block) for block in blocks[650:]]
    assert gate.confirmed
    assert back[-1] is Verdict.CONTINUES


@pytest.mark.parametrize("off", [-0.1, -0.005, 0.005, 0.1])
def test_a_converter_that_changes_its_speed_is_doubted_and_refused_within_3_s(off: float) -> None:
    gate, states = BlockGate(), []
    for n in range(1_150):
        late = max(0, n - 1_000)
        block = stream(0.02)[0]
        gate.judge(replace(block, sequence=n, stamp=START + round((n + off * late) * 20e6)))
        states.append(gate.rate.state)
    assert RateState.DOUBTFUL in states
    assert gate.rate.state is RateState.WRONG


@settings(max_examples=12)
@given(size=st.integers(40, 400), share=st.floats(0.0, 0.24), seed=st.integers(0, 99))
def test_a_right_rate_is_never_refused_however_its_stamps_jitter(size: int, share: float, seed: int) -> None:
    """Each stamp lies anywhere within ``share`` of its block's length."""
    gate = BlockGate()
    states = set()
    for block in stream(60.0, size=size, jitter=share * size * PERIOD, seed=seed):
        gate.judge(block)
        states.add(gate.rate.state)
    assert RateState.WRONG not in states
    assert gate.faults == {}
    assert gate.confirmed


@pytest.mark.parametrize("off", [-0.01, 0.01])
def test_a_wrong_rate_is_found_behind_jitter_as_well(off: float) -> None:
    gate = BlockGate()
    for block in stream(10.0, claimed=PERIOD * (1.0 + off), jitter=2e-3):
        gate.judge(block)
    assert gate.rate.state is RateState.WRONG


def test_lost_blocks_and_clocks_that_drift_or_step_a_little_are_no_wrong_rate() -> None:
    gate = BlockGate()
    random = np.random.default_rng(2)
    step = 0
    for n, block in enumerate(stream(120.0)):
        step += 8_000_000 if n % 500 == 250 else 0  # a clock that is set by 8 ms every 10 s
        drift = round(2e-4 * (block.stamp - START))
        if random.random() > 0.1:
            gate.judge(replace(block, stamp=block.stamp + drift + step))
        assert gate.rate.state is not RateState.WRONG
    assert gate.confirmed
    assert set(gate.faults) == {Fault.LOST}


@pytest.mark.parametrize("size", [1000, 2000])
def test_a_right_rate_of_long_blocks_is_never_refused_however_their_stamps_jitter(size: int) -> None:
    """Blocks of 0.5 and 1 s: a straight line through three of them does not show its own error."""
    gate = BlockGate()
    for block in stream(120.0, size=size, jitter=0.2 * size * PERIOD):
        assert gate.judge(block) is not Verdict.REFUSED
        assert gate.rate.state is not RateState.WRONG


@pytest.mark.parametrize("period", [0.7, 1.0, 1.8])
def test_a_right_rate_is_never_refused_where_the_delay_of_its_stamps_swells_and_ebbs(period: float) -> None:
    """By 4 ms in ``period`` s: for a while the stamps run ahead by more than 1 %, then they fall back."""
    gate = BlockGate()
    for block in stream(15.0):
        seconds = 1e-9 * (block.stamp - START)
        late = 2e-3 * (1.0 - math.cos(2.0 * math.pi * seconds / period))
        assert gate.judge(replace(block, stamp=block.stamp + round(1e9 * late))) is not Verdict.REFUSED
        assert gate.rate.state is not RateState.WRONG
    assert gate.faults == {}
