"""What holds for the estimator, whatever its method."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.one_source import STALE
from spool_core.uncertainty import Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, EstimatorSettings
from spool_sim.excitation import PRESETS, MachineOrders
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

SETTINGS = EstimatorSettings(0.18, spring_stiffness=1632.0, viscous_coefficient=8.2)


@lru_cache(maxsize=4)
def record(seconds: float = 12.0, rate: float = 2000.0) -> tuple[Block, ...]:
    noisy = Sensor(noise=0.03)
    source = Simulator(
        find_valve("4weh10_soft"),
        PRESETS["multisine"],
        coulomb_force=0.2,
        sample_rate=rate,
        block_size=round(rate / 50),
        seed=1,
        body_sensor=noisy,
        spool_sensor=noisy,
    )
    return tuple(source.records(seconds))


def estimates_of(estimator: Estimator, blocks: Iterable[Block]) -> list[Estimate]:
    return [estimate for block in blocks for estimate in estimator.update(block)]


def bits(estimates: Iterable[Estimate], **same: int) -> list[str]:
    """Return text in which every bit of every number shows, ``same`` made equal."""
    return [repr(replace(estimate, **same)) for estimate in estimates]


@pytest.mark.parametrize(
    "lost", [slice(0, 53), slice(300, 313)], ids=["joins a running machine", "0.26 s lost"]
)
def test_what_the_signals_show_is_right_or_unknown_after_a_gap(lost: slice) -> None:
    blocks = record()
    whole = estimates_of(Estimator(replace(SETTINGS, period=0.1)), blocks)
    broken = Estimator(replace(SETTINGS, period=0.1))
    rest = estimates_of(broken, blocks[: lost.start]) + estimates_of(broken, blocks[lost.stop :])
    again = blocks[lost.stop].stamp
    after = [one for one in rest if one.stamp > again]
    for name in ("excitation", "relative_displacement"):
        expected = np.array(
            [[one.stamp, getattr(one, name).value] for one in whole if getattr(one, name).known]
        )
        shown = [(one.stamp, getattr(one, name)) for one in after]
        assert not shown[0][1].known
        first = next(stamp for stamp, quantity in shown if quantity.known)
        assert first - again < 1.6e9
        for stamp, quantity in shown:
            if quantity.known:
                near = np.abs(expected[:, 0] - stamp) < 1.1e9
                low, high = expected[near, 1].min(), expected[near, 1].max()
                assert 0.7 * low < quantity.value < 1.3 * high


def test_a_gap_restarts_the_filters_and_keeps_what_is_known() -> None:
    blocks = record()
    estimator = Estimator(SETTINGS)
    before = estimates_of(estimator, blocks[:400])[-1]
    after = estimates_of(estimator, blocks[450:])
    assert estimator.gate.lost == 50
    assert after[0].lost_blocks == 50
    for estimate in after:
        value = estimate.parameter("spring_stiffness").value
        assert value == pytest.approx(before.parameter("spring_stiffness").value, rel=0.01)
    assert after[-1].state is State.TRACKING
    for found, whole in zip(
        after[-1].parameters, estimates_of(Estimator(SETTINGS), blocks)[-1].parameters, strict=True
    ):
        assert abs(found.value - whole.value) < 3.0 * whole.standard_deviation


def test_all_that_was_known_is_restored_whatever_was_learned_since() -> None:
    estimator, blocks = Estimator(SETTINGS), record(20.0)
    estimates_of(estimator, blocks[:450])
    twin = pickle.loads(pickle.dumps(estimator))
    assert estimator.tracker is not None
    assert twin.tracker is not None
    twin.tracker.restore(twin._began.knowledge())
    expected, known = pickle.dumps(twin._began.knowledge()), estimator._began.knowledge()
    for wrong in (blocks[450:600], blocks[600:750]):  # the second time behind a restored state
        estimates_of(
            estimator, [replace(one, body=one.spool + np.float32(3.0), spool=one.body) for one in wrong]
        )
        assert pickle.dumps(estimator._began.knowledge()) != expected
        estimator.tracker.restore(known)
        assert pickle.dumps(estimator._began.knowledge()) == expected


def test_time_that_goes_back_begins_anew_once_it_is_confirmed() -> None:
    blocks = record()
    estimator = Estimator(SETTINGS)
    estimates_of(estimator, blocks)
    again = estimates_of(estimator, blocks)
    assert estimator.gate.refused == round(STALE / 0.02)  # the first source keeps its place until it is stale
    assert again[-1].stamp <= blocks[-1].end
    assert again[-1].state is State.TRACKING


@pytest.mark.parametrize("cut", [1, 137, 400])
def test_a_pickle_goes_on_as_if_nothing_had_happened(cut: int) -> None:
    whole, first = Estimator(SETTINGS), Estimator(SETTINGS)
    blocks = record()
    head = estimates_of(first, blocks[:cut])
    second = pickle.loads(pickle.dumps(first))
    assert bits([*head, *estimates_of(second, blocks[cut:])]) == bits(estimates_of(whole, blocks))


@settings(max_examples=8, deadline=None)
@given(sizes=st.lists(st.integers(1, 1000), min_size=1, max_size=20))  # 0.5 s: stamps confirm the rate
def test_how_the_stream_is_split_changes_no_bit(sizes: list[int]) -> None:
    blocks = record(6.0)
    body = np.concatenate([block.body for block in blocks])
    spool = np.concatenate([block.spool for block in blocks])
    period = blocks[0].sample_period
    split = []
    taken = 0
    while taken < body.size:
        size = min(sizes[len(split) % len(sizes)], body.size - taken)
        stamp = blocks[0].stamp + round(taken * period * 1e9)
        part = slice(taken, taken + size)
        split.append(Block(stamp, len(split), period, body[part], spool[part]))
        taken += size
    expected = bits(estimates_of(Estimator(SETTINGS), blocks), last_sequence=0)
    assert bits(estimates_of(Estimator(SETTINGS), split), last_sequence=0) == expected


def test_memory_does_not_grow_over_ten_minutes() -> None:
    rate = 250.0
    slow = replace(SETTINGS, high_cut=100.0)
    excitation = MachineOrders(speed_profile=((0.0, 800.0), (900.0, 1100.0)), orders=((1.0, 6.0), (2.0, 3.0)))
    source = Simulator(
        find_valve("4weh10_soft"), excitation, coulomb_force=0.2, sample_rate=rate, block_size=125, seed=2
    )
    estimator = Estimator(slow)
    sizes = []
    for number, block in enumerate(source.records(600.0)):
        estimator.update(block)
        estimator.update_temperature(block.stamp, 40.0)
        if number % 60 == 59:
            sizes.append(len(pickle.dumps(estimator)))
    assert len(sizes) == 20
    assert max(sizes[2:]) <= 1.05 * sizes[1]
    latest = estimator.latest
    assert latest is not None
    assert all(math.isfinite(quantity.value) for quantity in latest.parameters if quantity.known)


def test_a_phase_moves_when_estimates_come_and_nothing_else() -> None:
    plain = Estimator(replace(SETTINGS, period=0.1))
    every = {estimate.stamp: estimate for estimate in estimates_of(plain, record())}
    early = Estimator(replace(SETTINGS, phase=3))
    lacking = early.lacking
    found = estimates_of(early, record())
    stamps = np.array([estimate.stamp for estimate in found])
    assert (stamps[0] - record()[0].stamp) * 1e-9 == pytest.approx(0.7, abs=1e-3)
    assert np.all(np.diff(stamps) == 1_000_000_000)
    assert lacking in (0, 1400)
    for estimate in found[5:]:
        assert repr(estimate.parameters) == repr(every[estimate.stamp].parameters)


#: What a frozen acquisition sends: the last sample again and again, or one constant on both channels.
FROZEN = [None, 0.0, 1.0, 2.5, 9.81, 1e-40]


def frozen_from(
    first: int, value: float | None, channels: tuple[str, ...] = ("body", "spool")
) -> list[Block]:
    """Return the record with ``channels`` standing from sample ``first`` on."""
    blocks = record(20.0)
    rows = {}
    for name in ("body", "spool"):
        row = np.concatenate([getattr(block, name) for block in blocks])
        if name in channels:
            row[first:] = row[first - 1] if value is None else value
        rows[name] = np.split(row, len(blocks))
    return [
        replace(block, body=body, spool=spool)
        for block, body, spool in zip(blocks, rows["body"], rows["spool"], strict=True)
    ]


def knows(estimate: Estimate) -> bool:
    return any(
        one.known for one in (*estimate.parameters, estimate.natural_frequency, estimate.damping_ratio)
    )


def numbers(estimate: Estimate) -> list[tuple[float, float]]:
    return [
        (one.value, one.standard_deviation)
        for one in (*estimate.parameters, estimate.natural_frequency, estimate.damping_ratio)
    ]


@lru_cache(maxsize=2)
def followed(count: int) -> tuple[list[Estimate], bytes]:
    """Return the estimates of the first ``count`` blocks, and the estimator behind them as a pickle."""
    estimator = Estimator(SETTINGS)
    return estimates_of(estimator, record(20.0)[:count]), pickle.dumps(estimator)


@pytest.mark.parametrize("channels", [("body", "spool"), ("body",), ("spool",)], ids="+".join)
@pytest.mark.parametrize("value", FROZEN)
def test_while_channels_stand_still_the_last_good_estimate_is_held(
    value: float | None, channels: tuple[str, ...]
) -> None:
    before, estimator = followed(550)  # 22,000 samples
    for first in (22_000, 23_333, 24_001, 25_990):
        rest = frozen_from(first, value, channels)[550:]
        estimates = [*before, *estimates_of(pickle.loads(estimator), rest)]
        instant = estimates[0].stamp - 999_500_000 + first * 500_000
        good = [one for one in estimates if one.stamp < instant][-1]
        assert good.state is State.TRACKING
        held = [one for one in estimates if one.stamp > instant + 250_000_000]
        assert len(held) >= 6
        for one in held:
            assert one.state is State.NOT_EXCITED
            assert numbers(one) == numbers(good)
            assert {each.validity for each in one.parameters} == {Validity.HELD}
            assert not one.excitation.known


def test_blocks_that_are_taken_together_go_back_as_far_where_the_rate_is_wrong() -> None:
    seen = record(20.0)
    blocks = [
        replace(block, stamp=block.stamp + max(0, number - 630) * 1_000_000)  # 5 % slower from 12.6 s on
        for number, block in enumerate(seen)
    ]
    together = Estimator(SETTINGS)
    found = [
        estimate
        for first in range(0, len(blocks), 5)
        for block, verdict in together.gate.admitted(blocks[first : first + 5], lambda: together.lacking)
        for estimate in together.update(block, verdict)
    ]
    one_by_one = Estimator(SETTINGS)
    assert bits(found, last_sequence=0) == bits(estimates_of(one_by_one, blocks), last_sequence=0)
    assert one_by_one.gate.refused
    assert bits([together.stale()], last_sequence=0) == bits([one_by_one.stale()], last_sequence=0)


@pytest.mark.parametrize("value", [*FROZEN, -1e-45])
def test_channels_that_stand_still_from_the_start_teach_nothing(value: float | None) -> None:
    for first in (1, 1_800, 2_900):
        after = estimates_of(Estimator(SETTINGS), frozen_from(first, value))
        assert not any(knows(one) for one in after)


def test_after_a_standstill_of_the_acquisition_the_machine_is_followed_again() -> None:
    blocks = [*record(20.0)]
    stood = frozen_from(24_000, None)
    estimates = estimates_of(Estimator(SETTINGS), [*stood[:800], *blocks[800:]])
    assert estimates[-1].state is State.TRACKING
    assert estimates[-1].parameter("spring_stiffness").value == pytest.approx(1632.0, rel=0.01)


OFF = [-0.9, -0.3, -0.1, -0.05, -0.01, -0.005, 0.005, 0.01, 0.05, 0.1, 0.3, 0.9]


@pytest.mark.parametrize("off", OFF)
def test_nothing_is_estimated_at_a_sample_rate_that_the_stamps_contradict(off: float) -> None:
    period = record()[0].sample_period * (1.0 + off)
    estimates = estimates_of(Estimator(SETTINGS), [replace(one, sample_period=period) for one in record()])
    assert not any(knows(one) for one in estimates)


@pytest.mark.parametrize("off", OFF)
def test_an_estimate_from_before_is_held_where_the_sample_rate_becomes_wrong(off: float) -> None:
    estimates, state = followed(400)
    before, estimator = estimates[-1], pickle.loads(state)
    assert before.state is State.TRACKING
    period = record()[0].sample_period * (1.0 + off)
    during = estimates_of(estimator, [replace(one, sample_period=period) for one in record(20.0)[400:600]])
    stale = estimator.stale()
    assert stale is not None
    for one in (*during, stale):
        assert numbers(one) == numbers(before)
        assert {each.validity for each in one.parameters} == {Validity.HELD}
