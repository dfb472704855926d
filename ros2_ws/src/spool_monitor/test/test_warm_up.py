from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

REPORT = """
import array, importlib, pkgutil
import numpy as np
import spool_monitor
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.monitor import Monitor
from spool_monitor.travel import TravelCounter
from spool_sim.presets import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_stream.block import Block

valve = find_valve("4weh10_soft")
estimator, monitor, travel = Estimator(settings_for(valve)), Monitor(), TravelCounter()
for block in Simulator(valve, PRESETS["sweep"], coulomb_force=0.3).records(6.0):
    for estimate in estimator.update(block):
        monitor.update_estimate(estimate)
    monitor.update(block)
    sent = array.array("f", block.body.tobytes())
    for samples in (np.frombuffer(sent, dtype=np.float32), np.frombuffer(sent.tobytes(), dtype=np.float32)):
        travel.update(Block(1, 1, 5e-4, samples, samples))
hits = misses = 0
for module in pkgutil.walk_packages(spool_monitor.__path__, "spool_monitor."):
    if module.name.endswith(("_node", "messages", "_desk")):
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


def test_a_process_after_the_warm_up_compiles_nothing_and_one_before_it_does(tmp_path: Path) -> None:
    cold, warm = tmp_path / "cold", tmp_path / "warm"
    assert run(warm, "-m", "spool_monitor.warm_up") == ""
    hits, misses = (int(word) for word in run(warm, "-c", REPORT).split())
    assert (hits > 0, misses) == (True, 0)
    hits, misses = (int(word) for word in run(cold, "-c", REPORT).split())
    assert misses > 0
