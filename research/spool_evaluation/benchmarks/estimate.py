"""Benchmark of estimation: recursive least squares against peers, replay and live nodes against real time."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from spool_bag.reading.reader import BagReader
from spool_core.errors import InputError
from spool_core.node.network import isolate
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.refit import RefitSettings, WindowRefits, WindowTask, refit
from spool_sim.model import MODELS
from spool_sim.valve.description import find_valve
from spool_tools.demo.processes import Nodes
from spool_tools.input.record_loading import DEFAULT_VALVE
from spool_tools.operations.record_replay import RefitRequest, replay_valve
from spool_tools.operations.simulation import simulate

from spool_evaluation.results.timing import Timing, best_of

from . import recursion
from .load.live_source import BLOCK_RATE, LiveSource

SECONDS = 120.0
#: s of the record that is replayed with refits, and how often the refits come.
REFIT_SECONDS, REFIT_PERIOD = 40.0, 5.0
LIVE_SECONDS = 10.0


def run() -> Iterator[Timing]:
    """Yield the rows, from the smallest piece to the live nodes."""
    yield from recursion.timings()
    with tempfile.TemporaryDirectory() as folder:
        yield from offline(Path(folder))
    isolate()
    with tempfile.TemporaryDirectory() as folder:
        yield from latency(Path(folder), LIVE_SECONDS)


def offline(folder: Path) -> Iterator[Timing]:
    """Yield replay without and with refits against real time, and the refit of one window."""
    valve = find_valve(DEFAULT_VALVE)
    for seconds, name in ((SECONDS, "long"), (REFIT_SECONDS, "short")):
        simulate(
            folder / name, DEFAULT_VALVE, "coulomb", "sweep", seconds,
            sample_rate=2000.0, block_rate=50.0, coulomb_force=0.2, noise=0.05, seed=0, name="valve_1",
        )  # fmt: skip
    long, short = BagReader(folder / "long"), BagReader(folder / "short")
    replay_valve(long, "valve_1", valve)  # compiles
    taken = best_of(4, lambda: replay_valve(long, "valve_1", valve))
    yield Timing(f"replay {SECONDS:g} s of one valve at 2 kHz", "real time", taken, SECONDS)
    request = RefitRequest(period=REFIT_PERIOD)
    taken = best_of(2, lambda: replay_valve(short, "valve_1", valve, refits=request))
    work = f"replay {REFIT_SECONDS:g} s with a refit every {REFIT_PERIOD:g} s"
    yield Timing(work, "real time", taken, REFIT_SECONDS)
    task = _window(short)
    yield Timing("refit a window of 4 s at 2 kHz", "real time", best_of(3, lambda: refit(task)), 4.0)


def _window(reader: BagReader) -> WindowTask:
    valve = find_valve(DEFAULT_VALVE)
    estimator = Estimator(settings_for(valve))
    windows = WindowRefits(RefitSettings(valve, MODELS["coulomb"]))
    for block in reader.blocks("valve_1"):
        for task in windows.update(block, estimator.update(block)):
            return task
    raise InputError("bench: the record is too short for a window")


def latency(folder: Path, seconds: float) -> Iterator[Timing]:
    """Yield median and 99 % of the time from a block to its estimate, and the filter's own lag."""
    source = LiveSource(1, seconds)
    with Nodes(folder / "nodes.log") as nodes:
        recorder = ["--ros-args", "-p", f"output:={folder / 'bag'}", "-p", "valves:=[valve_1]"]
        nodes.start("recorder", "spool_bag", "recorder", recorder)
        own = ["--ros-args", "-r", "__ns:=/valve_1"]
        nodes.start("estimator", "spool_estimator", "estimator", [*own, "-p", "period:=0.1"])
        nodes.start("monitor", "spool_monitor", "monitor", own)
        source.run(listeners=3)
    if not source.latencies:
        raise InputError(f"bench: no estimate came: {(folder / 'nodes.log').read_text().strip()[-200:]}")
    p50, p99 = (float(np.quantile(source.latencies, share)) for share in (0.5, 0.99))
    _say(
        f"from a block to its estimate, 2 kHz, {BLOCK_RATE:g} blocks a second, four nodes, "
        f"{len(source.latencies)} estimates: p50 {1e3 * p50:.2f} ms, p99 {1e3 * p99:.2f} ms; "
        f"the filter's own lag {1e3 * source.delay:.1f} ms; {source.lost.get(1, 0)} blocks lost"
    )
    work = "block to estimate over DDS, four nodes"
    yield Timing(f"{work}: p50", "20 ms", p50, 0.02)
    yield Timing(f"{work}: p99", "20 ms", p99, 0.02)
    yield Timing("the filter's own lag", "one block", source.delay, 1.0 / BLOCK_RATE)


def _say(text: str) -> None:
    Console().print(text, markup=False, highlight=False, soft_wrap=True)
