"""Refits of the last seconds, live: next to the stream, recorded, and the same in a replay."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.serialization import serialize_message
from spool_bag.reader import BagReader
from spool_core.node.messages import nanoseconds
from spool_estimator.messages import to_refit_message
from spool_estimator.refit import RefitSettings
from spool_msgs.msg import ModelEstimate, WindowRefit
from spool_report.runs.record_replay import replay_valve
from spool_sim.model import load_model
from spool_sim.valve import find_valve

if TYPE_CHECKING:
    from .conftest import System

PERIOD, WINDOW = 2.0, 3.0


def test_refits_come_next_to_the_stream_and_are_those_of_the_replay(system: System, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    refits = system.listen(WindowRefit, "/valve_1/refit", latched=True)
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    recorder = system.start("recorder", namespace="", output=bag, valves="[valve_1]")
    estimator = system.start("estimator", refit_period=PERIOD, refit_window=WINDOW)
    simulator = system.start("simulator", excitation="multisine", coulomb_force=0.2, wait_for_subscribers=2)
    system.until(lambda: len(refits.heard) >= 3, "three windows are fitted")
    found = [message for message in refits.messages if message.state == WindowRefit.STATE_CONVERGED]
    assert found
    assert estimates.last.lost_blocks == 0

    # What the worker is fitting, and what has been counted, outlives a pause.
    before = refits.last.refits
    system.change(estimator.name, "deactivate", "activate")
    late = system.listen(WindowRefit, "/valve_1/refit", latched=True)
    system.until(lambda: late.heard, "the last refit is latched or a new one comes")
    system.until(lambda: refits.last.refits > before, "refits go on")
    for process in (simulator, estimator, recorder):
        assert process.end() == 0

    reader = BagReader(bag)
    assert reader.topics["/valve_1/refit"].messages >= 4
    valve = find_valve("4weh10_soft")
    settings = RefitSettings(valve, load_model("coulomb"), PERIOD, WINDOW)
    replayed = replay_valve(reader, "valve_1", valve, refits=settings).refitted
    by_stamp = {refit.stamp: refit for refit in replayed}
    for message in found[:3]:
        again = by_stamp[nanoseconds(message.header.stamp)]
        same = to_refit_message(again, valve.id, refits=message.refits, skipped=message.skipped)
        # Bytes: NaN differs from itself.
        assert serialize_message(same) == serialize_message(message)
