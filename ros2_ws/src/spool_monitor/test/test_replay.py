"""A replay says what the live nodes said, whatever the stream holds and however blocks are taken together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import settings_for
from spool_estimator.estimators import ESTIMATORS, make_estimator
from spool_monitor.event import Event
from spool_monitor.monitor import Monitor, MonitorSettings
from spool_monitor.replay import Replay
from spool_sim.excitation import from_mapping
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_stream.block import Block

VALVE = find_valve("4weh10_soft")
SETTINGS = MonitorSettings(natural_frequency=VALVE.natural_frequency, baseline_time=2.0)
SHAFT = from_mapping(
    {"kind": "machine_orders", "speed_profile": [[0.0, 600.0], [8.0, 1100.0]], "orders": [[1.0, 8.0]]}
)


SOUND = list(Simulator(VALVE, SHAFT, coulomb_force=0.1, seed=3).records(8.0))


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
        elif fault == "repeated":
            found[place] = blocks[max(0, place - 1)]
    return [found[place] for place in sorted(found)]


def live(method: str, blocks: list[Block]) -> tuple[list[Estimate], list[Event], Monitor]:
    """Return what the nodes make of ``blocks``, each node judging each block by itself."""
    estimator, monitor = make_estimator(method, settings_for(VALVE)), Monitor(SETTINGS)
    estimates, events = [], []
    for place, block in enumerate(blocks):
        if place % 100 == 50:
            estimator.update_temperature(block.stamp, 40.0 + 0.01 * place)
        found = estimator.update(block)
        events += monitor.update(block)
        for estimate in found:
            events += monitor.update_estimate(estimate)
        estimates += found
    return estimates, events, monitor


@pytest.mark.parametrize("method", ESTIMATORS)
@settings(max_examples=8, deadline=None)
@given(
    faults=st.lists(
        st.tuples(
            st.integers(1, 398),
            st.sampled_from(["lost", "not a number", "unequal", "empty", "late by 3 us", "repeated"]),
        ),
        max_size=6,
    )
)
def test_a_replay_equals_the_live_nodes(method: str, faults: list[tuple[int, str]]) -> None:
    blocks = spoiled(SOUND, faults)
    estimates, events, monitor = live(method, blocks)
    replay = Replay(make_estimator(method, settings_for(VALVE)), Monitor(SETTINGS), keep=True)
    for place, block in enumerate(blocks):
        if place % 100 == 50:
            replay.update_temperature(block.stamp, 40.0 + 0.01 * place)
        replay.update(block)
    replay.flush()
    assert len(estimates) > 3
    assert repr(replay.estimates) == repr(estimates)
    assert repr(replay.events) == repr(events)
    assert repr(replay.monitor.health) == repr(monitor.health)
    assert replay.monitor.gate.faults == monitor.gate.faults
    assert replay.monitor.gate.accepted == monitor.gate.accepted
    assert replay.samples == 40 * monitor.gate.accepted
