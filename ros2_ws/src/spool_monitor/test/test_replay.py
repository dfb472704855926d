"""A replay says what the live nodes said, whatever the stream holds and however blocks are taken together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.block import Block, BlockRun
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.gap_watch import GapWatch
from spool_monitor.detectors import MonitorSettings
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.excitation import from_mapping, load_excitation
from spool_sim.model import model_from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
SETTINGS = MonitorSettings(natural_frequency=VALVE.natural_frequency, baseline_time=2.0)
SHAFT = from_mapping(
    {"kind": "machine_orders", "speed_profile": [[0.0, 600.0], [8.0, 1100.0]], "orders": [[1.0, 8.0]]}
)


#: Where what is wrong with which blocks.
FAULTS = st.lists(
    st.tuples(
        st.integers(1, 398),
        st.sampled_from(
            ["lost", "not a number", "unequal", "empty", "late by 3 us", "repeated", "foreign", "slower"]
        ),
    ),
    max_size=6,
)


@pytest.fixture(scope="module", name="sound")
def _sound() -> list[Block]:
    return list(Simulator(VALVE, SHAFT, coulomb_force=0.1, seed=3).records(8.0))


def spoiled(blocks: list[Block], faults: list[tuple[int, str]]) -> list[Block]:
    found: dict[int, Block] = dict(enumerate(blocks))
    for place, fault in faults:
        one = blocks[place]
        if fault == "lost":
            found.pop(place, None)
        elif fault == "not a number":
            found[place] = replace(one, spool=np.full_like(one.spool, np.nan))
        elif fault == "unequal":
            found[place] = replace(one, body=np.concatenate([one.body, one.body[:3]]), spool=one.spool[3:])
        elif fault == "empty":
            found[place] = replace(one, body=one.body[:0], spool=one.spool[:0])
        elif fault == "late by 3 us":
            found[place] = replace(one, stamp=one.stamp + 3_000)
        elif fault == "foreign":
            found[place] = replace(one, source="another")
        elif fault == "slower":
            found[place] = replace(one, sample_period=2.0 * one.sample_period)
        elif fault == "repeated":
            found[place] = blocks[max(0, place - 1)]
    return [found[place] for place in sorted(found)]


def runs_of(blocks: list[Block], edges: set[int]) -> list[Block | BlockRun]:
    """Return ``blocks``, those that follow each other to the nanosecond as runs, cut at ``edges`` as well."""
    found: list[list[Block]] = []
    for place, block in enumerate(blocks):
        last = found[-1][-1] if found else block
        follows = (block.stamp, block.sequence) == (last.end, last.sequence + 1)
        alike = block.body.size == last.body.size == block.spool.size and block.source == last.source
        if found and follows and alike and block.sample_period == last.sample_period and place not in edges:
            found[-1].append(block)
        else:
            found.append([block])
    return [
        BlockRun(
            one[0].stamp, one[0].sequence, one[0].sample_period,
            np.concatenate([block.body for block in one]), np.concatenate([block.spool for block in one]),
            one[0].source, one[0].body.size,
        )
        if BlockRun.of(one[0]) else one[0]
        for one in found
    ]  # fmt: skip


def live(blocks: list[Block]) -> tuple[list[Estimate], list[Event], Monitor]:
    """Return what the nodes make of ``blocks``, each node judging each block by itself."""
    estimator, monitor, gap = Estimator(settings_for(VALVE)), Monitor(SETTINGS), GapWatch()
    estimates, events = [], []
    for place, block in enumerate(blocks):
        if place % 100 == 50:
            estimator.update_temperature(block.stamp, 40.0 + 0.01 * place)
        accepted = estimator.gate.accepted
        found = estimator.update(block)
        if estimator.gate.accepted > accepted:
            gap.take(block)
        changes = [gap.update(estimate) for estimate in found]
        events += monitor.update(block)
        for estimate, change in zip(found, changes, strict=True):
            events += [] if change is None else [change]
            events += monitor.update_estimate(estimate)
        estimates += found
    return estimates, events, monitor


def judged(replay: Replay) -> tuple[object, ...]:
    """Return all that a replay says once it has been fed."""
    replay.flush()
    gate = replay.monitor.gate
    return (
        repr(replay.estimates), repr(replay.events), repr(replay.monitor.health), gate.faults, gate.accepted,
        replay.samples,
    )  # fmt: skip


@settings(max_examples=8, deadline=None)
@given(faults=FAULTS, edges=st.sets(st.integers(0, 399)))
def test_a_replay_equals_the_live_nodes_and_runs_of_blocks_equal_their_blocks(
    sound: list[Block], faults: list[tuple[int, str]], edges: set[int]
) -> None:
    blocks = spoiled(sound, faults)
    estimates, events, monitor = live(blocks)
    assert len(estimates) > 3
    gate = monitor.gate
    expected = (
        repr(estimates), repr(events), repr(monitor.health), gate.faults, gate.accepted, 40 * gate.accepted
    )  # fmt: skip

    alone, together = (Replay(Estimator(settings_for(VALVE)), Monitor(SETTINGS), keep=True) for _ in range(2))
    warmer = set(range(50, len(blocks), 100))
    for place, block in enumerate(blocks):
        if place in warmer:
            alone.update_temperature(block.stamp, 40.0 + 0.01 * place)
        alone.update(block)
    assert judged(alone) == expected
    place = 0
    for item in runs_of(blocks, edges | warmer):
        first = item.block(0) if isinstance(item, BlockRun) else item
        if place in warmer:
            together.update_temperature(first.stamp, 40.0 + 0.01 * place)
        together.update(item)
        place += len(item) if isinstance(item, BlockRun) else 1
    assert place == len(blocks)
    assert judged(together) == expected


@pytest.mark.slow
def test_a_gap_that_opens_is_among_the_events_of_a_replay_in_order() -> None:
    """A spring that hardens: what the model leaves over grows and stays up."""
    quick = settings_for(VALVE, period=0.2, memory=2.0)
    hardening = model_from_mapping(
        {
            "name": "hardening",
            "terms": ["inertia", "spring", "viscous_friction", "cubic_stiffness"],
            "parameters": {"cubic_coefficient": 3.0e8},
        }
    )
    excitation = load_excitation("multisine")
    noise = {"body_sensor": Sensor(noise=0.05), "spool_sensor": Sensor(noise=0.05)}
    blocks = list(Simulator(VALVE, excitation, model="fluid", seed=3, **noise).records(10.0))
    after = Simulator(VALVE, excitation, model=hardening, seed=4, start_stamp=blocks[-1].end, **noise)
    later = after.records(12.0)
    blocks += [replace(block, sequence=len(blocks) + number) for number, block in enumerate(later)]
    one = Replay(Estimator(quick), Monitor(SETTINGS))
    one.run(blocks)
    gaps = [event for event in one.events if event.kind == "model_gap"]
    assert [event.state for event in gaps] == [EventState.RAISED]
    assert 15.0 < (gaps[0].stamp - blocks[0].stamp) * 1e-9 < 20.0
    assert [event.stamp for event in one.events] == sorted(event.stamp for event in one.events)
    apart, watch = Estimator(quick), GapWatch()
    found = []
    for block in blocks:
        estimates = apart.update(block)
        watch.take(block)
        found += [event for event in map(watch.update, estimates) if event is not None]
    assert repr(found) == repr(gaps)
