"""Benchmark of the live nodes: processor time at 10 kHz in blocks of 200, simulator to monitor, recorded."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from spool_bag.information import describe
from spool_core.errors import InputError
from spool_core.node.network import isolate
from spool_tools.operations.demo import Nodes

from spool_evaluation.results.timing import Timing

from .load.process_cost import processor_time

#: s before and during which processor time is taken.
WARM_UP, MEASURED = 6.0, 10.0

NODES = (
    ("simulator", "spool_sim", ("sample_rate:=10000.0", "block_rate:=50.0", "wait_for_subscribers:=3")),
    ("estimator", "spool_estimator", ()),
    ("monitor", "spool_monitor", ()),
)


def run() -> Iterator[Timing]:
    """Yield one row a node: processor time against the wall time of the same run.

    Raises:
        InputError: blocks were lost on the way, so that the figures would mean nothing.

    """
    isolate()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with Nodes(Path(folder) / "nodes.log") as nodes:
            recorder = ["--ros-args", "-p", f"output:={bag}", "-p", "valves:=[valve_1]"]
            nodes.start("recorder", "spool_bag", "recorder", recorder)
            for name, package, parameters in NODES:
                settings = [word for parameter in parameters for word in ("-p", parameter)]
                nodes.start(name, package, name, ["--ros-args", "-r", "__ns:=/valve_1", *settings])
            time.sleep(WARM_UP)
            before = {name: processor_time(process.pid) for name, process in nodes.running.items()}
            begin = time.monotonic()
            time.sleep(MEASURED)
            wall = time.monotonic() - begin
            used = {
                name: processor_time(process.pid) - before[name] for name, process in nodes.running.items()
            }
            nodes.stop("simulator")
            nodes.stop("monitor", "estimator")
            nodes.stop("recorder", patience=20.0)
        lost = sum(valve.lost_blocks for valve in describe(bag).valves)
        if lost:
            raise InputError(
                f"bench nodes: {lost} blocks were lost; is this machine busy with something else?"
            )
    for name, seconds in used.items():
        yield Timing(f"{name} node at 10 kHz in blocks of 200", "one core", max(seconds, 1e-3), wall)
