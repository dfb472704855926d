"""Benchmark of bags: reading against rosbags, block for block, and replaying against real time."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from spool_bag.reader import BagReader
from spool_report.records.record_loading import DEFAULT_VALVE
from spool_report.records.simulation import simulate
from spool_report.requests import SimulationSettings
from spool_report.runs.record_replay import replay_valve
from spool_sim.valve import find_valve

from spool_evaluation.results.timing import Timing, best_of

#: s of the bag that is read, and of the one that is replayed: an hour, as a fleet's bags are.
SECONDS, HOUR = 120.0, 3600.0


def run() -> Iterator[Timing]:
    """Yield the rows: reading every block, and the whole replay."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        simulate(bag, SimulationSettings(DEFAULT_VALVE, "coulomb", "sweep", SECONDS, coulomb_force=0.2))
        yield _reading(bag)
        hour = Path(folder) / "hour"
        simulate(hour, SimulationSettings(DEFAULT_VALVE, "coulomb", "orders", HOUR, coulomb_force=0.2))
        valve = find_valve(DEFAULT_VALVE)
        ours = best_of(2, lambda: replay_valve(BagReader(hour), "valve_1", valve))
        yield Timing(f"replay {HOUR:g} s of one valve at 2 kHz", "real time", ours, HOUR)


def _reading(bag: Path) -> Timing:
    def ours() -> float:
        return sum(float(np.sum(block.spool)) for block in BagReader(bag).blocks("valve_1"))

    def peer() -> float:
        total = 0.0
        with AnyReader([bag]) as reader:
            chosen = [entry for entry in reader.connections if entry.topic == "/valve_1/acceleration"]
            for connection, _, data in reader.messages(chosen):
                message: Any = reader.deserialize(data, connection.msgtype)
                total += float(np.sum(message.spool))
        return total

    wanted = peer()
    difference = abs(ours() - wanted)
    work = f"read {SECONDS:g} s of one valve at 2 kHz, 50 blocks a second"
    return Timing(work, "rosbags AnyReader", best_of(3, ours), best_of(3, peer), difference, 0.0)
