"""From simulator to bag: nothing is lost, and a replay is the run itself."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from spool_bag.reader import BagReader
from spool_core.node.messages import nanoseconds
from spool_estimator.estimate import Estimate, State
from spool_estimator.messages import from_message
from spool_monitor.replay import Replay
from spool_msgs.msg import AccelerationBlock, HealthEvent
from spool_report.records.record_sources import recorded_valve
from spool_report.runs.record_replay import replay_valve

if TYPE_CHECKING:
    from .conftest import System

SECONDS = 10
BLOCK_RATE = 50


@dataclass
class Run:
    """A run at 10 kHz that is over, and what its nodes said last."""

    reader: BagReader
    estimator: dict[str, str]
    monitor: dict[str, str]
    recorder: dict[str, str]
    live: Replay


@pytest.fixture(scope="module", name="run_10_khz")
def _run_10_khz(
    make_system: Callable[[Path], AbstractContextManager[System]], tmp_path_factory: pytest.TempPathFactory
) -> Run:
    """Ten seconds of a machine that passes its resonance, 10 kHz in blocks of 200, heard by three nodes.

    Blocks are sent best effort: a run in which a busy machine lost one before a node is repeated.
    """
    for _ in range(5):
        with make_system(tmp_path_factory.mktemp("run")) as system:
            run = recorded_run(system)
        sent = str(1 + max(block.sequence for block in run.reader.blocks("valve_1")))
        if run.estimator["blocks_used"] == run.monitor["blocks_used"] == sent:
            break
    return run


def recorded_run(system: System) -> Run:
    blocks = system.listen(AccelerationBlock, "/valve_1/acceleration")
    _ = system.diagnostics
    recorder = system.start("recorder", "", output=system.folder / "bag")
    system.start("estimator")
    system.start("monitor")
    # The recorder and the monitor: the first estimate follows a second after the first block.
    system.until(
        lambda: system.node.count_subscribers("/valve_1/estimate") >= 2, "the estimates are listened to"
    )
    # The fourth is the test itself.
    simulator = system.start(
        "simulator",
        sample_rate=10000.0,
        block_rate=float(BLOCK_RATE),
        excitation="orders",
        wait_for_subscribers=4,
    )
    system.until(lambda: blocks.heard and blocks.last.sequence >= SECONDS * BLOCK_RATE, "ten seconds of data")
    assert simulator.end(signal.SIGINT) == 0
    ended = time.monotonic()
    tasks = ("valve_1/estimator: estimate", "valve_1/monitor: data")

    def had_everything(task: str) -> bool:
        """Whether it has missed data since, and counted nothing more for a second."""
        told = [status for _, status in system.statuses(task, after=ended)]
        used = {value.value for one in told[-2:] for value in one.values if value.key == "blocks_used"}
        late = (DiagnosticStatus.STALE, DiagnosticStatus.WARN)
        return len(told) > 1 and told[-1].level in late and len(used) == 1

    system.until(lambda: all(map(had_everything, tasks)), "the nodes have had everything")
    told = [system.numbers(task) for task in (*tasks, "recorder: recording")]
    assert recorder.end(signal.SIGINT) == 0
    reader = BagReader(system.folder / "bag")
    valve = recorded_valve(reader, "valve_1")
    assert valve is not None
    return Run(reader, told[0], told[1], told[2], replay_valve(reader, "valve_1", valve, keep=True))


def test_10_khz_arrive_without_loss(run_10_khz: Run) -> None:
    blocks = list(run_10_khz.reader.blocks("valve_1"))
    print(f"{len(blocks)} blocks of 200 samples at 10 kHz")
    assert len(blocks) > SECONDS * BLOCK_RATE
    assert [block.sequence for block in blocks] == list(range(len(blocks)))
    assert {block.body.size for block in blocks} == {200}
    assert {block.sample_period for block in blocks} == {1e-4}
    assert run_10_khz.recorder["blocks_lost_valve_1"] == "0"
    for told in (run_10_khz.estimator, run_10_khz.monitor):
        assert told["blocks_lost"] == "0"
        assert told["blocks_refused"] == "0"
        assert told["blocks_used"] == str(len(blocks))


def test_replay_is_the_run_bit_for_bit(run_10_khz: Run) -> None:
    recorded = [from_message(decoded) for decoded in run_10_khz.reader.messages("/valve_1/estimate")]
    live = [estimate for estimate in recorded if estimate.state is not State.STALE]
    assert len(live) >= SECONDS
    assert any(estimate.state is State.TRACKING for estimate in live)
    assert [bits(estimate) for estimate in live] == [bits(estimate) for estimate in run_10_khz.live.estimates]


def test_replay_finds_the_events_of_the_run(run_10_khz: Run) -> None:
    live = [
        (event.kind, event.state, nanoseconds_of(event))
        for event in run_10_khz.reader.messages("/valve_1/events")
        if event.kind != "stale"
    ]
    replayed = [(event.kind, int(event.state), event.stamp) for event in run_10_khz.live.events]
    assert live == replayed
    assert ("resonance", HealthEvent.STATE_RAISED) in [event[:2] for event in live]


def nanoseconds_of(message: Any) -> int:
    return nanoseconds(message.header.stamp)


def bits(estimate: Estimate) -> tuple[object, ...]:
    """Return everything an estimate says, numbers as their bits: NaN equals NaN, and -0 is not 0."""
    quantities = [
        *estimate.parameters,
        estimate.natural_frequency,
        estimate.damping_ratio,
        estimate.residual,
        estimate.excitation,
        estimate.relative_displacement,
    ]
    numbers = [quantity.value for quantity in quantities]
    numbers += [quantity.standard_deviation for quantity in quantities]
    return (
        estimate.stamp,
        estimate.state,
        estimate.samples,
        estimate.last_sequence,
        [quantity.validity for quantity in quantities],
        np.array([*numbers, estimate.delay, estimate.memory]).tobytes(),
    )
