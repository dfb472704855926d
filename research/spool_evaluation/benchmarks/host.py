"""Benchmark of hosting: estimators and monitors of many valves in a host, beside the same as processes.

Blocks of 40 samples at 2 kHz come from a separate process, from before the nodes start until the end. A host
is starved by signals that stop and continue it, so that it gets STARVED of what it needs.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console
from spool_core.errors import InputError
from spool_core.node.network import isolate
from spool_tools.operations.node_processes import Nodes

from spool_evaluation.benchmarks.load.valve_source import (
    RUN_IN,
    family,
    last_words,
    memory,
    processor_time,
    sending,
)

VALVES = (1, 10, 32, 100)
SEPARATE, SHARED = "separate processes", "host, one message for all valves"
#: s that blocks are sent, and how long after the start processor time is taken from.
SECONDS, SETTLED = 60.0, 30.0
#: Valves for one process of the host, at most: a process of Python uses one core, shared with its middleware.
VALVES_A_PROCESS = 50
#: Valves that are tried as processes, two each, and B of private memory of each process.
MOST_AS_PROCESSES, OWN_MEMORY = 32, 160e6
#: Share of its need that a starved host gets, s of a period in which it gets that, and valves that it has.
STARVED, PERIOD, STARVED_VALVES = 0.6, 0.2, 20
#: s in which its need is measured, and for which it is starved longer than blocks are sent.
LEAD = 5.0


@dataclass(frozen=True, slots=True)
class HostCost:
    """Cost of so many ``valves``, run in ``processes``; times in s, memory in B.

    ``cores`` is the processor time of all processes over the wall time; ``memory`` counts shared pages once,
    ``resident`` each time.
    """

    valves: int
    way: str
    processes: int
    cores: float
    memory: int
    resident: int
    seen: dict[str, float | None]

    def cells(self) -> dict[str, str]:
        """Return the row of the table."""
        seen = self.seen

        def milliseconds(name: str, *, hosts_only: bool = False) -> str:
            value = None if hosts_only and self.way == SEPARATE else seen[name]
            return "" if value is None else f"{1e3 * value:.1f}"

        tracking = seen["all_tracking_s"]
        return {
            "valves": str(self.valves),
            "in": self.way,
            "processes": str(self.processes),
            "cores": f"{self.cores:.2f}",
            "cores a valve": f"{self.cores / self.valves:.4f}",
            "PSS, MB": f"{self.memory / 1e6:.0f}",
            "RSS, MB": f"{self.resident / 1e6:.0f}",
            "source, cores": f"{seen['source_cores']:.2f}",
            "blocks lost": f"{seen['lost']:.0f}",
            "false alarms 801": f"{seen['silences']:.0f}",
            "source late, s": f"{seen['longest_late_s']:.1f}",
            "block to estimate p50, ms": milliseconds("p50_s"),
            "p99, ms": milliseconds("p99_s"),
            "longest wait of a block, start, ms": milliseconds("wait_at_start_s", hosts_only=True),
            "later, ms": milliseconds("wait_later_s", hosts_only=True),
            "all tracking after, s": f"{tracking:.1f}"
            if tracking is not None and seen["tracking"] == self.valves
            else f"{seen['tracking']:.0f} of {self.valves}",
        }


def run(seconds: float = SECONDS, valves: Sequence[int] = VALVES) -> Iterator[HostCost]:
    """Yield a row for each number of valves in a host, and as processes where they fit."""
    isolate()
    for count in valves:
        yield _measured(count, seconds, "host")
        if count > 1:
            yield _measured(count, seconds, SHARED)
        if count <= MOST_AS_PROCESSES and 2 * count * OWN_MEMORY < _available():
            yield _measured(count, seconds, SEPARATE)
    yield _measured(STARVED_VALVES, seconds, f"host, {100 * STARVED:.0f} % of its need")


def _measured(count: int, seconds: float, way: str) -> HostCost:
    Console(stderr=True).print(f"{count} valves, {way}: {seconds:g} s ...", highlight=False)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        settled = min(SETTLED, 0.5 * seconds)
        starved = way not in ("host", SEPARATE, SHARED)
        # Its source ends while it is still starved, and only what comes from then on counts.
        sent, run_in = (seconds - LEAD, round(settled)) if starved else (seconds, RUN_IN)
        source = sending(folder, count, sent, run_in=run_in, shared=way == SHARED)
        with source as saw, Nodes(folder / "nodes.log") as nodes:
            begin = time.monotonic()
            _start(nodes, folder, count, way)
            time.sleep(max(0.0, settled - LEAD * starved - (time.monotonic() - begin)))
            processes = [one for process in nodes.running.values() for one in family(process.pid)]
            before, from_then = sum(map(processor_time, processes)), time.monotonic()
            if starved:
                time.sleep(LEAD)
                need = (sum(map(processor_time, processes)) - before) / LEAD
                _starve(processes, STARVED * need, begin + seconds + LEAD)
            else:
                time.sleep(max(1.0, begin + seconds - 3.0 - from_then))
            cores = (sum(map(processor_time, processes)) - before) / (time.monotonic() - from_then)
            shared, resident = (sum(one) for one in zip(*map(memory, processes), strict=True))
            if nodes.dead():
                raise InputError(f"bench host: {nodes.dead()[0]} ended: {last_words(folder / 'nodes.log')}")
            seen = saw()
    return HostCost(count, way, len(processes), cores, int(shared), int(resident), seen)


def _starve(processes: Sequence[int], cores: float, until: float) -> None:
    """Stop and continue ``processes`` so that they get so many ``cores``, ``until`` then (s, steady)."""
    while time.monotonic() < until:
        for asked, seconds in ((signal.SIGSTOP, 1.0 - cores), (signal.SIGCONT, cores)):
            for process in processes:
                os.kill(process, asked)
            time.sleep(PERIOD * max(0.0, seconds))


def _start(nodes: Nodes, folder: Path, count: int, way: str) -> None:
    names = [f"valve_{number + 1}" for number in range(count)]
    kept = ["-p", f"state_folder:={folder / 'state'}"]
    if way != SEPARATE:
        valves = folder / "valves.yaml"
        valves.write_text(yaml.safe_dump([{"namespace": name} for name in names]), encoding="utf-8")
        processes = -(-count // VALVES_A_PROCESS)
        words = ["--processes", str(processes), "--ros-args", "-p", f"valves_file:={valves}", *kept]
        nodes.start("host", "spool_bringup", "host", words)
        return
    for name in names:
        words = ["--ros-args", "-r", f"__ns:=/{name}"]
        nodes.start(f"{name} estimator", "spool_estimator", "estimator", words)
        nodes.start(f"{name} monitor", "spool_monitor", "monitor", [*words, *kept])


def _available() -> int:
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
