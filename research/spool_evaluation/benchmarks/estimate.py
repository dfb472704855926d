"""Benchmark of estimation: replay and live nodes against real time.

Times are compared with those of a fixed work, recursive least squares: theta <- theta + P x e / (f + x' P x),
P <- (P - P x x' P / (f + x' P x)) / f (Ljung, System Identification, 1999, section 11.2).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import process_time

import numpy as np
from rich.console import Console
from spool_bag.reader import BagReader
from spool_core.errors import InputError
from spool_core.kernels.compiled import compiled
from spool_core.node.network import isolate
from spool_core.numbers import Array
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.refit import RefitSettings, WindowRefits, WindowTask, refit
from spool_report.records.record_loading import DEFAULT_VALVE
from spool_report.records.simulation import simulate
from spool_report.requests import SimulationSettings
from spool_report.runs.record_replay import replay_valve
from spool_sim.model import MODELS
from spool_sim.valve import find_valve
from spool_tools.operations.node_processes import Nodes

from spool_evaluation.benchmarks.load.valve_source import BLOCK_RATE, last_words, sending
from spool_evaluation.results.timing import Timing, best_of

SECONDS = 120.0
#: s of the record that is replayed with refits, and how often the refits come.
REFIT_SECONDS, REFIT_PERIOD = 40.0, 5.0
#: s of live blocks, s of them until a valve counts as run in, and nodes that hear them.
LIVE_SECONDS, RUN_IN, LISTENERS = 10.0, 4, 3
#: Of the fixed work: samples, parameters, samples a call, forgetting.
SAMPLES, SIZE, BLOCK, FACTOR = 20_000, 6, 200, 0.9995


def run() -> Iterator[Timing]:
    """Yield the rows, from the smallest piece to the live nodes."""
    with tempfile.TemporaryDirectory() as folder:
        yield from offline(Path(folder))
    isolate()
    with tempfile.TemporaryDirectory() as folder:
        yield from latency(Path(folder), LIVE_SECONDS)


def offline(folder: Path) -> Iterator[Timing]:
    """Yield replay without and with refits against real time, and the refit of one window."""
    valve = find_valve(DEFAULT_VALVE)
    for seconds, name in ((SECONDS, "long"), (REFIT_SECONDS, "short")):
        settings = SimulationSettings(DEFAULT_VALVE, "coulomb", "sweep", seconds, coulomb_force=0.2)
        simulate(folder / name, settings)
    long, short = BagReader(folder / "long"), BagReader(folder / "short")
    replay_valve(long, "valve_1", valve)  # compiles
    taken = best_of(4, lambda: replay_valve(long, "valve_1", valve))
    yield Timing(f"replay {SECONDS:g} s of one valve at 2 kHz", "real time", taken, SECONDS)
    refits = RefitSettings(valve, MODELS["coulomb"], REFIT_PERIOD)
    taken = best_of(2, lambda: replay_valve(short, "valve_1", valve, refits=refits))
    work = f"replay {REFIT_SECONDS:g} s with a refit every {REFIT_PERIOD:g} s"
    yield Timing(work, "real time", taken, REFIT_SECONDS)
    task = _window(short)
    yield Timing("refit a window of 4 s at 2 kHz", "real time", best_of(3, lambda: refit(task)), 4.0)


def latency(folder: Path, seconds: float) -> Iterator[Timing]:
    """Yield median and 99 % of the time from a block to its estimate, and the filter's own lag."""
    with Nodes(folder / "nodes.log") as nodes:
        recorder = ["--ros-args", "-p", f"output:={folder / 'bag'}", "-p", "valves:=[valve_1]"]
        nodes.start("recorder", "spool_bag", "recorder", recorder)
        own = ["--ros-args", "-r", "__ns:=/valve_1"]
        nodes.start("estimator", "spool_estimator", "estimator", [*own, "-p", "period:=0.1"])
        nodes.start("monitor", "spool_monitor", "monitor", own)
        with sending(folder, 1, seconds, run_in=RUN_IN, listeners=LISTENERS) as saw:
            seen = saw()
    if not seen["estimates"]:
        raise InputError(f"bench: no estimate came: {last_words(folder / 'nodes.log')}")
    p50, p99, delay = seen["p50_s"], seen["p99_s"], seen["delay_s"]
    text = (
        f"from a block to its estimate, 2 kHz, {BLOCK_RATE:g} blocks a second, four nodes, "
        f"{seen['estimates']} estimates: p50 {1e3 * p50:.2f} ms, p99 {1e3 * p99:.2f} ms; "
        f"the filter's own lag {1e3 * delay:.1f} ms; {seen['lost']} blocks lost"
    )
    Console().print(text, markup=False, highlight=False, soft_wrap=True)
    work = "block to estimate over DDS, four nodes"
    yield Timing(f"{work}: p50", "20 ms", p50, 0.02)
    yield Timing(f"{work}: p99", "20 ms", p99, 0.02)
    yield Timing("the filter's own lag", "one block", delay, 1.0 / BLOCK_RATE)


def reference() -> float:
    """Return s a sample of recursive least squares: a fixed work that no change of ours makes dearer."""
    generator = np.random.default_rng(0)
    rows = generator.standard_normal((SAMPLES, SIZE))
    target = rows @ np.arange(1.0, 1.0 + SIZE) + 0.1 * generator.standard_normal(SAMPLES)

    def work() -> None:
        parameters, covariance = np.zeros(SIZE), 10.0 * np.eye(SIZE)
        for first in range(0, SAMPLES, BLOCK):
            part = slice(first, first + BLOCK)
            _recursive_least_squares(rows[part], target[part], FACTOR, parameters, covariance)

    work()  # compiles
    return best_of(5, work, process_time) / SAMPLES


def _window(reader: BagReader) -> WindowTask:
    valve = find_valve(DEFAULT_VALVE)
    estimator, windows = Estimator(settings_for(valve)), WindowRefits(RefitSettings(valve, MODELS["coulomb"]))
    for block in reader.blocks("valve_1"):
        verdict = estimator.gate.judge(block)
        for task in windows.update(block, verdict, estimator.update(block, verdict)):
            return task
    raise InputError("bench: the record is too short for a window")


@compiled
def _recursive_least_squares(
    rows: Array, target: Array, factor: float, parameters: Array, covariance: Array
) -> None:
    """Take samples, rows of shape (n, p) and targets (n,), one after the other, forgetting by ``factor``."""
    size = parameters.size
    gain = np.zeros(size)
    for n in range(target.size):
        error = target[n]
        seen = factor
        for i in range(size):
            error -= rows[n, i] * parameters[i]
            total = 0.0
            for j in range(size):
                total += covariance[i, j] * rows[n, j]
            gain[i] = total
            seen += rows[n, i] * total
        for i in range(size):
            parameters[i] += gain[i] / seen * error
            for j in range(size):
                covariance[i, j] = (covariance[i, j] - gain[i] * gain[j] / seen) / factor
