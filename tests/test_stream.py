"""From simulator to bag: nothing is lost, a replay is the run itself, bad blocks change nothing."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from spool_bag.reader import BagReader
from spool_core.block import Block
from spool_core.block_gate import Fault
from spool_core.node import qos
from spool_core.node.messages import from_block, nanoseconds
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import phase_of
from spool_estimator.messages import from_message
from spool_monitor.replay import Replay
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate
from spool_report.records.record_sources import recorded_valve
from spool_report.runs.record_replay import replay_valve
from spool_sim.excitation import load_excitation
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

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


def bad_blocks(good: Block) -> list[tuple[Fault, AccelerationBlock]]:
    """Return blocks that stand where ``good`` would, each with one thing wrong."""
    not_a_number = good.spool.copy()
    not_a_number[3] = math.nan
    infinite = good.body.copy()
    infinite[0] = math.inf
    changed = [
        (Fault.LENGTHS_DIFFER, replace(good, spool=good.spool[:-1])),
        (Fault.LENGTHS_DIFFER, replace(good, body=good.body[:0], spool=good.spool[:0])),
        (Fault.BAD_PERIOD, replace(good, sample_period=0.0)),
        (Fault.BAD_PERIOD, replace(good, sample_period=-good.sample_period)),
        (Fault.BAD_PERIOD, replace(good, sample_period=math.nan)),
        (Fault.NOT_FINITE, replace(good, spool=not_a_number)),
        (Fault.NOT_FINITE, replace(good, body=infinite)),
        (Fault.TIME_BACK, replace(good, stamp=good.stamp - 1_000_000_000)),
        (Fault.TIME_BACK, replace(good, stamp=good.stamp - 40_000_000, sequence=good.sequence - 2)),
        (Fault.TIME_BACK, replace(good, stamp=good.stamp - 10_000_000_000)),
        (Fault.GAP, replace(good, stamp=good.stamp + 3_000_000_000)),
        (Fault.GAP, replace(good, stamp=good.stamp + 100_000_000_000)),
        (Fault.SEQUENCE_BACK, replace(good, sequence=0)),
        (Fault.NO_TIME, replace(good, stamp=0)),
    ]
    return [(fault, from_block(block, "4weh10_soft")) for fault, block in changed]


def refused_blocks(status: DiagnosticStatus) -> int:
    return next(int(value.value) for value in status.values if value.key == "blocks_refused")


def prime(
    system: System, offered: dict[str, Any], tasks: dict[str, str], message: AccelerationBlock
) -> dict[str, int]:
    """Send blocks without a time until all estimators refuse them: who is found late misses the first blocks.

    Returns how many each refused.
    """
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    due = 0.0

    def heard() -> bool:
        nonlocal due
        if time.monotonic() >= due:
            for name, publisher in offered.items():
                if not refused(name):
                    publisher.publish(message)
            due = time.monotonic() + 1.5
        return all(refused(name) for name in offered)

    def refused(name: str) -> int:
        return int(system.numbers(tasks[name]).get("blocks_refused", "0"))

    system.until(heard, "both estimators hear their topic")
    return {name: refused(name) for name in offered}


def test_malformed_blocks_are_told_and_change_nothing(system: System) -> None:
    assert phase_of("tidy") == phase_of("dirty")  # else their estimates come at different moments
    estimates = {
        name: system.listen(ModelEstimate, f"/{name}/estimate", latched=True) for name in ("tidy", "dirty")
    }
    events = system.listen(HealthEvent, "/dirty/events", latched=True)
    _ = system.diagnostics
    for name in estimates:
        system.start("estimator", name)
    system.start("monitor", "dirty")
    offered = {
        name: system.node.create_publisher(
            AccelerationBlock, f"/{name}/acceleration", qos.samples_offered(1000)
        )
        for name in estimates
    }
    system.until(
        lambda: [publisher.get_subscription_count() for publisher in offered.values()] == [1, 2],
        "all three listen",
    )

    simulator = Simulator(find_valve("4weh10_soft"), load_excitation("multisine"), block_size=40)
    blocks = list(simulator.records(8.0))
    tasks = {name: f"{name}/estimator: estimate" for name in estimates}
    primed = prime(system, offered, tasks, from_block(blocks[0], "4weh10_soft"))
    sent: dict[Fault, int] = {}
    told: list[float] = []
    begin = time.monotonic()
    for number, block in enumerate(blocks):
        if 200 <= number < 203:  # the jump in sequence, of both
            continue
        # Twice as fast as real time, so that nobody's queue runs over.
        system.until(lambda due=begin + 0.01 * number: time.monotonic() >= due, "the next block is due")
        # Before the rate is confirmed a stamp that is ahead may as well be a wrong rate: learning waits.
        if number > 100 and number % 100 == 50:
            for fault, message in bad_blocks(block):
                sent[fault] = sent.get(fault, 0) + 1
                offered["dirty"].publish(message)
            told.append(time.monotonic())
        message = from_block(block, "4weh10_soft")
        for publisher in offered.values():
            publisher.publish(message)

    refused = sum(sent.values())
    used = str(len(blocks) - 3)
    system.until(
        lambda: all(system.numbers(task).get("blocks_used") == used for task in tasks.values()),
        "both estimators have had every good block",
    )
    for name, faults in (("tidy", {}), ("dirty", sent)):
        numbers = system.numbers(tasks[name])
        assert numbers["blocks_lost"] == "3"
        assert numbers["blocks_refused"] == str(primed[name] + (refused if faults else 0))
        counted = {**faults, Fault.LOST: 1, Fault.NO_TIME: faults.get(Fault.NO_TIME, 0) + primed[name]}
        expected = {f"fault_{fault.name.lower()}": str(counted.get(fault, 0)) for fault in Fault}
        assert {key: value for key, value in numbers.items() if key.startswith("fault")} == expected
    (estimator,) = [one for one in system.processes if one.name == "/dirty/estimator"]
    assert "refused: stamp is 0" in estimator.said
    assert any(
        status.level == DiagnosticStatus.WARN and refused_blocks(status) > primed["dirty"]
        for _, status in system.statuses(tasks["dirty"], after=told[0])
    )
    assert events.first(lambda event: event.kind == "data_fault" and event.header.frame_id == "4weh10_soft")

    tidy, dirty = (
        [from_message(message) for message in estimates[name].messages if message.state != State.STALE]
        for name in ("tidy", "dirty")
    )
    assert len(tidy) >= 7
    assert tidy[-1].state is State.TRACKING
    assert [bits(estimate) for estimate in dirty] == [bits(estimate) for estimate in tidy]
    assert tidy[-1].refused_blocks == primed["tidy"]
    assert dirty[-1].refused_blocks == primed["dirty"] + refused
