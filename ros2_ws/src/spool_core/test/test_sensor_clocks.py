"""Clocks of two sensors: a step of one stops the blocks, bursts give the right rate or none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spool_core.aligner import CLOCK_STEP, Aligner, AlignerSettings, Channel
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Fault, Verdict
from spool_core.stamps import Rhythm

START = 1_700_000_000_000_000_000
RATE = 500.0
BODY, SPOOL = Channel
Times = np.ndarray


def wave(times: Times) -> Times:
    """Return what both sensors measure at true times (s), m/s^2; 1 ms is up to 0.7 m/s^2."""
    return 5.0 * np.sin(2.0 * math.pi * 15.0 * times) + 4.0 * np.sin(2.0 * math.pi * 6.1 * times + 1.0)


def same(times: Times) -> Times:
    return times


@dataclass
class Run:
    """Two sensors at work: what the aligner gave, and at which true time (s) it reported a fault first."""

    aligner: Aligner
    blocks: list[tuple[float, Block]]
    reported: float = math.nan

    def apart(self) -> float:
        """Return by how much (s) the spool is late against the body in the worst block."""
        worst, blocks = 0.0, [block for _, block in self.blocks]
        for before, block, after in zip([None, *blocks], blocks, [*blocks[1:], None], strict=False):
            # With the neighbours: a block of three samples has but one slope that is no one-sided difference.
            ahead = before.body[-1:] if before and before.sequence == block.sequence - 1 else block.body[:0]
            behind = after.body[:1] if after and after.sequence == block.sequence + 1 else block.body[:0]
            row = np.concatenate([ahead, block.body, behind]).astype(np.float64)
            slope = np.gradient(row, block.sample_period)[ahead.size :][: block.body.size]
            off = block.spool.astype(np.float64) - block.body
            if math.sqrt(np.mean(slope**2)) > 100.0:
                worst = max(worst, abs(float(slope @ off) / float(slope @ slope)))
        return worst


def run(
    seconds: float,
    body: Callable[[Times], Times] = same,
    spool: Callable[[Times], Times] = same,
    *,
    rate: float = RATE,
    phase: float = 0.0,
    delivered: Callable[[Times], Times] | tuple[Callable[[Times], Times], ...] = same,
    kept: tuple[set[int], set[int]] = (set(), set()),
) -> Run:
    """Return what comes of two sensors whose clocks show ``body`` and ``spool`` of the true times (s).

    ``delivered`` says when samples arrive, for both or for each; ``kept`` numbers those of body and spool
    that never do.
    """
    events = []
    delays = delivered if isinstance(delivered, tuple) else (delivered, delivered)
    for order, (channel, clock, lost) in enumerate(zip(Channel, (body, spool), kept, strict=True)):
        times = np.arange(round(seconds * rate)) / rate + order * phase
        stamps = START + np.rint(1e9 * clock(times)).astype(np.int64)
        arrivals, values = delays[order](times) + 1e-5 * order, wave(times)
        events += [
            (float(arrivals[n]), order, n, channel, int(stamps[n]), float(values[n]))
            for n in range(times.size)
            if n not in lost
        ]
    found = Run(Aligner(AlignerSettings()), [])
    for arrival, _, _, channel, stamp, value in sorted(events, key=lambda one: one[:3]):
        block = found.aligner.update(channel, stamp, value)
        if block is not None:
            found.blocks.append((arrival, block))
        if math.isnan(found.reported) and found.aligner.fault is not None:
            found.reported = arrival
    return found


def step(by: float, at: float = 3.0) -> Callable[[Times], Times]:
    return lambda times: times + np.where(times >= at, by, 0.0)


@pytest.mark.parametrize("by", [0.4e-3, -0.4e-3, 3e-3, 2e-3, -2e-3, 0.3, -0.3, 3.0, -5.0])
@pytest.mark.parametrize("channel", list(Channel))
def test_a_step_of_one_clock_stops_the_blocks_and_is_reported(channel: Channel, by: float) -> None:
    clocks = {channel.value: step(by)}
    found = run(5.0, **clocks)
    assert found.apart() < 0.02e-3
    assert max(arrival for arrival, _ in found.blocks) < 3.1
    assert len(found.blocks) >= 149
    assert found.reported < 3.1
    fault = found.aligner.fault
    assert fault is not None
    assert fault.cause == CLOCK_STEP
    assert f"the {channel.value}'s clock was set by {by:+.4g} s against the " in fault.text
    assert all(stream.lost == 0 for stream in found.aligner.streams.values())


@pytest.mark.parametrize("by", [0.4e-3, 3e-3, -3e-3, 0.3, -0.3, 3.0, -3.0])
def test_both_clocks_that_step_together_restart_the_stream(by: float) -> None:
    found = run(5.0, step(by), step(by))
    assert found.apart() < 1e-6
    assert found.aligner.fault is None
    assert len(found.blocks) >= 230
    gate = BlockGate()
    verdicts = [gate.judge(block) for _, block in found.blocks]
    assert verdicts[-1] is Verdict.CONTINUES


def test_a_step_that_is_taken_back_lets_the_blocks_go_on() -> None:
    found = run(9.0, lambda times: times + np.where((times >= 3.0) & (times < 6.0), 0.05, 0.0))
    assert found.apart() < 1e-6
    arrivals = np.array([arrival for arrival, _ in found.blocks])
    assert not ((arrivals > 3.1) & (arrivals < 6.0)).any()
    assert np.count_nonzero(arrivals > 6.0) >= 140
    assert found.aligner.fault is None


def test_a_loss_of_whole_periods_is_no_step() -> None:
    """Three samples that one sensor lost, and three of both at the same time."""
    found = run(6.0, kept=({1600, 1601, 1602, 2000, 2001, 2002}, {2000, 2001, 2002}))
    assert found.aligner.fault is None
    assert [stream.lost for stream in found.aligner.streams.values()] == [6, 3]
    assert [stream.steps for stream in found.aligner.streams.values()] == [0, 0]
    assert len(found.blocks) == 298


def test_clocks_that_are_slewed_together_are_followed_without_a_break() -> None:
    """500 ppm for 3 s, as adjtime does it."""

    def slewed(times: Times) -> Times:
        return times + 500e-6 * np.clip(times - 2.0, 0.0, 3.0)

    found = run(7.0, slewed, slewed)
    assert len(found.blocks) == 350
    assert found.apart() < 1e-6
    assert all(stream.restarts == 0 == stream.steps for stream in found.aligner.streams.values())


def test_clocks_that_run_apart_are_followed_then_reported_and_stopped_before_it_counts() -> None:
    """200 ppm: 1 ms after 5 s, 4 ms after 20 s. Nobody knows which of both is right."""
    found = run(35.0, lambda times: times * (1.0 + 200e-6), rate=200.0)
    assert max(abs(stream.steps) for stream in found.aligner.streams.values()) == 0
    assert 18.0 < found.reported < 32.0
    assert found.aligner.wandered == pytest.approx(6e-3, abs=2e-3)
    assert found.blocks[-1][0] < found.reported
    assert found.apart() < 8e-3
    fault = found.aligner.fault
    assert fault is not None
    assert "drifted apart" in fault.text


@pytest.mark.parametrize("lasts", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("calm", [0.0, 4.0])
def test_sensors_of_one_clock_are_used_though_the_delivery_of_one_is_restless(
    lasts: float, calm: float
) -> None:
    """From ``calm`` s on its messages are up to 80 ms late; by how much changes every ``lasts`` s."""
    late = np.random.default_rng(6).uniform(0.0, 0.08, 200)

    def restless(times: Times) -> Times:
        return np.maximum.accumulate(times + (times >= calm) * late[(times / lasts).astype(np.intp)])

    found = run(8.0, rate=100.0, delivered=(restless, same))
    assert calm or math.isnan(found.reported)
    assert found.aligner.fault is None
    assert found.aligner.wandered == 0.0
    assert len(found.blocks) > 390


def test_sensors_of_different_rates_are_no_clocks_that_run_apart() -> None:
    """Their stamps are those of one clock: what differs by 200 ppm is how often they are sampled."""
    events = []
    for order, (channel, rate) in enumerate(zip(Channel, (200.0, 200.0 * (1.0 - 200e-6)), strict=True)):
        times = np.arange(round(30.0 * rate)) / rate
        events += [(float(time), order, channel) for time in times]
    aligner = Aligner(AlignerSettings())
    for time, _, channel in sorted(events, key=lambda one: one[:2]):
        aligner.update(channel, START + round(1e9 * time), float(wave(np.array([time]))[0]))
    assert aligner.fault is None
    assert aligner.wandered == 0.0
    assert aligner.drift == pytest.approx(200e-6, rel=0.01)
    assert aligner.sent > 1450


def grouped(size: int, gap: float) -> Callable[[Times], Times]:
    """Return stamps of packets of ``size`` samples, ``gap`` s apart within a packet."""

    def stamps(times: Times) -> Times:
        number = np.arange(times.size)
        last = times[np.minimum((number // size + 1) * size, times.size) - 1]
        return last + gap * (number % size)

    return stamps


@settings(max_examples=10, deadline=None)
@given(
    st.sampled_from([200.0, 400.0, 500.0, 800.0, 833.0, 1000.0, 1600.0]),
    st.integers(2, 12),
    st.sampled_from([0.0, 2e-6, 12e-6, 50e-6]),
    st.sampled_from(["both", "spool"]),
)
@example(rate=200.0, size=10, gap=2e-6, who="spool")
def test_bursts_give_the_right_rate_or_none(rate: float, size: int, gap: float, who: str) -> None:
    packets = grouped(size, gap)
    found = run(4.0, packets if who == "both" else same, packets, rate=rate)
    for stream in found.aligner.streams.values():
        assert stream.lost <= stream.received
        if stream.clock is not None:
            assert stream.clock.rate == pytest.approx(rate, rel=2.5e-3)
    if who == "spool":
        assert not found.blocks
        fault = found.aligner.fault
        assert fault is not None or found.aligner.streams[SPOOL].doubt
    else:
        assert found.apart() < 0.2e-3
        assert found.blocks or found.aligner.streams[BODY].doubt


@settings(max_examples=10, deadline=None)
@given(st.floats(120.0, 1900.0), st.sampled_from([1e-6, 1e-5, 1e-4, 1e-3]), st.sampled_from(["both", "body"]))
def test_coarse_stamps_give_the_right_rate_or_none(rate: float, resolution: float, who: str) -> None:
    def coarse(times: Times) -> Times:
        return np.floor(times / resolution + 1e-6) * resolution

    found = run(3.5, coarse, coarse if who == "both" else same, rate=rate)
    for stream in found.aligner.streams.values():
        assert stream.lost == 0
        if stream.clock is not None:
            assert stream.clock.rate == pytest.approx(rate, rel=2.5e-3)
    both_coarse = who == "both" and resolution == 1e-3
    assert found.apart() < (0.2e-3 if both_coarse or resolution < 1e-3 else 0.6e-3)


def test_stamps_of_a_driver_that_repeats_every_fourth_one_lose_nothing() -> None:
    """The samples are new, only their stamps are those of the ones before."""

    def every_fourth(times: Times) -> Times:
        stamps = times.copy()
        stamps[3::4] = stamps[2::4]
        return stamps

    both = run(4.0, every_fourth, every_fourth)
    assert both.aligner.sample_rate == pytest.approx(RATE, rel=1e-5)
    assert both.apart() < 0.02e-3
    assert len(both.blocks) > 170
    one = run(4.0, every_fourth)
    assert not one.blocks
    fault = one.aligner.fault
    assert fault is not None
    assert "body" in fault.text
    assert all(stream.lost == 0 for stream in (*both.aligner.streams.values(), *one.aligner.streams.values()))


def test_stamps_without_a_clock_give_no_block_and_a_reason() -> None:
    rng = np.random.default_rng(3)

    def irregular(times: Times) -> Times:
        return np.cumsum(rng.exponential(1.0 / RATE, times.size))

    found = run(5.0, irregular)
    assert not found.blocks
    assert found.aligner.streams[BODY].doubt


@pytest.mark.parametrize(
    ("stamps", "reason"),
    [
        (lambda times: 0.0 * times - START * 1e-9, "stamp is 0, negative or no number"),
        (lambda times: 0.0 * times, "all stamps are equal"),
    ],
)
def test_stamps_without_a_time_give_a_reason(stamps: Callable[[Times], Times], reason: str) -> None:
    found = run(4.0, stamps)
    assert not found.blocks
    assert reason in found.aligner.streams[BODY].doubt


@pytest.mark.parametrize("seed", range(3))
def test_jitter_of_a_fifth_of_a_period_never_looks_like_lost_samples(seed: int) -> None:
    """Stamps off by up to 0.6 ms at 316 Hz, printed in ms: the sensors belong together in each block."""
    rng = np.random.default_rng(seed)

    def jittering(times: Times) -> Times:
        return np.floor((times + 0.6e-3 * rng.uniform(-1.0, 1.0, times.size)) * 1e3) / 1e3

    found = run(8.0, jittering, jittering, rate=316.0)
    assert [stream.lost for stream in found.aligner.streams.values()] == [0, 0]
    assert found.apart() < 0.3e-3
    assert len(found.blocks) > 250


@pytest.mark.parametrize(("rate", "by", "resolution"), [(1427.5, 0.51e-3, 0.0), (833.0, 0.84e-3, 1e-3)])
def test_a_step_of_most_of_a_period_is_no_lost_sample_where_lumps_hide_the_arrivals(
    rate: float, by: float, resolution: float
) -> None:
    """0.7 of a period, by stamps off by up to 0.2 ms, of messages that come every 20 ms."""
    rng = np.random.default_rng(4)

    def jittering(times: Times) -> Times:
        shown = times + 0.2e-3 * rng.uniform(-1.0, 1.0, times.size)
        return np.floor(shown / resolution) * resolution if resolution else shown

    found = run(
        8.0,
        lambda times: jittering(step(by, 4.0)(times)),
        jittering,
        rate=rate,
        delivered=lambda times: np.ceil(times / 0.02) * 0.02,
    )
    fault = found.aligner.fault
    assert fault is not None
    assert fault.cause == CLOCK_STEP
    assert found.blocks[-1][0] < 4.5
    assert [stream.lost for stream in found.aligner.streams.values()] == [0, 0]


@settings(max_examples=8, deadline=None)
@given(
    rate=st.sampled_from([250.0, 400.0, 500.0, 833.0, 1000.0]),
    by=st.one_of(
        st.floats(0.5e-3, 20e-3),
        st.floats(-20e-3, -0.5e-3),
        st.sampled_from([0.3, -0.3, 1.0, -1.0, 4.0, -4.0]),
    ),
    who=st.sampled_from(["body", "spool", "both", "none"]),
    jitter=st.sampled_from([0.0, 1e-6, 2e-5, 1e-4]),
    lumps=st.sampled_from([0.0, 0.004, 0.01, 0.02]),
    phase=st.floats(0.0, 0.9),
    seed=st.integers(0, 2**32 - 1),
)
def test_no_block_holds_samples_that_do_not_belong_together(
    rate: float, by: float, who: str, jitter: float, lumps: float, phase: float, seed: int
) -> None:
    """Whatever the jitter of stamps and delivery: right blocks, or none and a reason."""
    rng = np.random.default_rng(seed)

    def clock(name: str) -> Callable[[Times], Times]:
        def stamps(times: Times) -> Times:
            shown = times + jitter * rng.uniform(-1.0, 1.0, times.size)
            return step(by)(times) + shown - times if who in (name, "both") else shown

        return stamps

    def delivered(times: Times) -> Times:
        return np.ceil(times / lumps) * lumps if lumps else times

    found = run(5.5, clock("body"), clock("spool"), rate=rate, phase=phase / rate, delivered=delivered)
    assert found.apart() < 0.15e-3
    fault = found.aligner.fault
    if who in ("body", "spool"):
        assert fault is not None
        assert fault.cause == CLOCK_STEP
        assert found.reported < 4.5
    else:
        assert fault is None
        assert len(found.blocks) > 200


def test_the_notice_of_a_step_is_refused_by_everyone_and_names_the_step() -> None:
    found = run(6.0, step(3e-3))
    gate = BlockGate()
    for _, block in found.blocks:
        gate.judge(block)
    assert gate.judge(found.aligner.notice()) is Verdict.REFUSED
    assert gate.fault is Fault.UNPAIRED
    assert gate.fault.cause == CLOCK_STEP


def test_the_rhythm_of_each_sensor_is_known() -> None:
    found = run(3.0, grouped(8, 12e-6), grouped(8, 12e-6))
    assert [stream.found.rhythm for stream in found.aligner.streams.values() if stream.found] == [
        Rhythm.BURSTS
    ] * 2
