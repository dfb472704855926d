"""A bag that is replayed in runs of blocks gives every number that it gives block by block."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from spool_bag.information import Timeline
from spool_bag.metadata import ACCELERATION_BLOCK, TEMPERATURE
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import OilTemperature, encode_block, encode_temperature
from spool_estimator.identification.record import PartKeeper
from spool_report.requests import ReplayRequest
from spool_report.runs.record_replay import ReplaySettings, replay_bag, replay_valve
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
FAULTS = ("lost", "gap", "not a number", "jitter", "rate step", "second source", "clock back", "shuffled")


@cache
def sound() -> tuple[Block, ...]:
    return tuple(Simulator(VALVE, PRESETS["multisine"], coulomb_force=0.3, seed=1).records(8.0))


@cache
def slow() -> tuple[Block, ...]:
    simulator = Simulator(
        VALVE, PRESETS["multisine"], coulomb_force=0.3, seed=2, sample_rate=1000.0, block_size=20
    )
    return tuple(simulator.records(4.0))


def recut(blocks: Sequence[Block], seed: int) -> list[Block]:
    """Return the samples of ``blocks`` in blocks of other lengths."""
    body, spool = (np.concatenate([getattr(one, name) for one in blocks]) for name in ("body", "spool"))
    random, at, found = np.random.default_rng(seed), 0, []
    while at < body.size:
        size = int(random.choice([40, 40, 40, 13, 250]))
        stamp = blocks[0].stamp + at * 500_000
        found.append(Block(stamp, len(found), 5e-4, body[at : at + size], spool[at : at + size]))
        at += size
    return found


def spoiled(fault: str, place: int) -> list[Block]:
    blocks = list(sound())
    ahead, behind = blocks[:place], blocks[place:]
    if fault == "lost":
        return ahead + behind[7:]
    if fault == "gap":
        return ahead + [replace(one, stamp=one.stamp + 700_000_000) for one in behind]
    if fault == "not a number":
        return [*ahead, replace(behind[0], body=np.full_like(behind[0].body, np.nan)), *behind[1:]]
    if fault == "jitter":
        return ahead + [replace(one, stamp=one.stamp + (one.sequence * 7919) % 90_000) for one in behind]
    if fault == "rate step":
        first = behind[0]
        later = [
            replace(
                one, stamp=one.stamp - slow()[0].stamp + first.stamp, sequence=first.sequence + one.sequence
            )
            for one in slow()
        ]
        return ahead + later
    if fault == "second source":
        other = [replace(one, stamp=one.stamp + 3_000_000, sequence=one.sequence + 70) for one in behind]
        return ahead + [one for both in zip(behind, other, strict=True) for one in both]
    if fault == "clock back":
        return ahead + [replace(one, stamp=one.stamp - 20_000_000_000) for one in behind]
    return [*ahead, *behind[3:6], *behind[:3], *behind[6:]]


def write(path: Path, blocks: Sequence[Block], warm: int) -> None:
    """Write a bag with a temperature, late by some blocks, ahead of every ``warm``-th block."""
    with BagWriter(path) as writer:
        samples = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        oil = writer.add_topic("/valve_1/oil_temperature", TEMPERATURE)
        for place, one in enumerate(blocks):
            if place % warm == warm - 1:
                item = OilTemperature(one.stamp - 33_000_000, 40.0 + 0.01 * place, 0.25)
                writer.write(oil, one.stamp, encode_temperature(item, VALVE.id))
            writer.write(samples, one.stamp, encode_block(one, VALVE.id), sequence=one.sequence)


def outcome(path: Path) -> list[str]:
    """Return every number of a replay: the JSON, estimates and events, the traces of the tests, the parts."""
    reader, timeline, parts = BagReader(path), Timeline(), PartKeeper(200_000)
    settings = ReplaySettings({"baseline_time": 3.0})
    one = replay_valve(reader, "valve_1", VALVE, settings, keep=True, timeline=timeline, parts=parts)
    records = [(part.start, part.body.tobytes(), part.spool.tobytes()) for part in parts.records("x")]
    told = [one.estimates, one.events, one.monitor.health, one.trace, timeline, records, one.samples]
    return [json.dumps(replay_bag(ReplayRequest(record=path, valve=[VALVE.id]))), *map(repr, told)]


@pytest.mark.parametrize(
    ("fault", "place", "warm"),
    [
        ("none", 0, 50),
        ("recut", 0, 13),
        *((fault, 20 + 360 * n // len(FAULTS), (13, 50, 1000)[n % 3]) for n, fault in enumerate(FAULTS)),
    ],
)
def test_runs_give_what_single_blocks_give(tmp_path: Path, fault: str, place: int, warm: int) -> None:
    path = tmp_path / "bag"
    whole = {"none": sound(), "recut": recut(sound(), 1)}
    write(path, whole[fault] if fault in whole else spoiled(fault, place), warm)
    in_runs = outcome(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BagReader, "runs", BagReader.stream)
        assert outcome(path) == in_runs
