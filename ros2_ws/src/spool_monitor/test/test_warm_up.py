"""What the set-up compiles is all that a node runs: afterwards no process compiles a kernel."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from spool_stream.kernels.compiled import COMPILED

USE = """
import array
import numpy as np
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.monitor import Monitor
from spool_monitor.signals.travel import TravelCounter
from spool_sim.presets import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_stream.block import Block

valve = find_valve("4weh10_soft")
for coulomb_force, seconds in ((0.0, 0.5), (0.3, 6.0)):
    estimator, monitor, travel = Estimator(settings_for(valve)), Monitor(), TravelCounter()
    for block in Simulator(valve, PRESETS["sweep"], coulomb_force=coulomb_force).records(seconds):
        for estimate in estimator.update(block):
            monitor.update_estimate(estimate)
        monitor.update(block)
        sent = array.array("f", block.body.tobytes())
        for sight in (sent, sent.tobytes()):
            samples = np.frombuffer(sight, dtype=np.float32)
            as_sent = Block(1, 1, 5e-4, samples, samples)
            travel.update(as_sent)
            Estimator(settings_for(valve)).update(as_sent)
"""

#: Least that compiles anything: for a process without what the set-up left.
USE_LITTLE = """
import numpy as np
from spool_monitor.signals.travel import TravelCounter
from spool_stream.block import Block

samples = np.ones(16, dtype=np.float32)
TravelCounter().update(Block(1, 1, 5e-4, samples, samples))
"""

REPORT = """
import importlib, pkgutil
import spool_estimator, spool_monitor, spool_sim, spool_stream

hits = misses = 0
for package in (spool_sim, spool_stream, spool_estimator, spool_monitor):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if module.name.endswith(("_node", "messages", "_services", "_tasks", "__main__")):
            continue
        for kernel in vars(importlib.import_module(module.name)).values():
            if hasattr(kernel, "py_func"):
                hits += sum(kernel.stats.cache_hits.values())
                misses += sum(kernel.stats.cache_misses.values())
print(hits, misses)
"""


def run(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={
            **os.environ,
            "PYTHONPATH": ":".join(path for path in sys.path if path),
            "NUMBA_CACHE_DIR": str(folder),
        },
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def test_after_the_warm_up_a_new_process_compiles_nothing(tmp_path: Path) -> None:
    assert run(tmp_path, "-m", "spool_monitor.warm_up") == ""
    hits, misses = (int(word) for word in run(tmp_path, "-c", USE + REPORT).split())
    assert misses == 0
    assert (hits > 0) == COMPILED


def test_a_process_before_it_does_compile(tmp_path: Path) -> None:
    """Else the test above could not fail."""
    if not COMPILED:
        pytest.fail("numba is missing: install it, the kernels are 100 times slower without")
    _, misses = (int(word) for word in run(tmp_path, "-c", USE_LITTLE + REPORT).split())
    assert misses > 0
