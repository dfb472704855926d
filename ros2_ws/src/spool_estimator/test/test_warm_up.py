from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from spool_stream.compiled import COMPILED

REPORT = """
import array, importlib, pkgutil
import numpy as np
import spool_estimator, spool_sim
from spool_estimator.estimator import Estimator, settings_for
from spool_sim.presets import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_stream.block import Block

valve = find_valve("4weh10_soft")
for coulomb_force in (0.0, 0.3):
    estimator = Estimator(settings_for(valve))
    for block in Simulator(valve, PRESETS["sweep"], coulomb_force=coulomb_force).records(0.5):
        estimator.update(block)
        sent = array.array("f", block.body.tobytes())
        view = np.frombuffer(sent, dtype=np.float32)
        frozen = np.frombuffer(sent.tobytes(), dtype=np.float32)
        for samples in (view, frozen):
            Estimator(settings_for(valve)).update(Block(1, 1, 5e-4, samples, samples))
hits = misses = 0
for package in (spool_sim, spool_estimator):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if module.name.endswith(("_node", "messages")):
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


def test_after_warm_up_a_new_process_compiles_nothing(tmp_path: Path) -> None:
    assert run(tmp_path, "-m", "spool_estimator.warm_up") == ""
    hits, misses = (int(word) for word in run(tmp_path, "-c", REPORT).split())
    assert misses == 0
    assert (hits > 0) == COMPILED


def test_a_first_process_does_compile(tmp_path: Path) -> None:
    """Else the test above could not fail."""
    if not COMPILED:
        pytest.fail("numba is missing: install it, the kernels are 100 times slower without")
    _, misses = (int(word) for word in run(tmp_path, "-c", REPORT).split())
    assert misses > 0
