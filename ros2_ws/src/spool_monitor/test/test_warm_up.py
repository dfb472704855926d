"""What the set-up compiles is all that a node runs: afterwards no process compiles a kernel."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from spool_core.kernels.compiled import COMPILED

#: Kernels with the types of the arguments that they are compiled for, before and after the warm-up and a use.
CODE = """
import array, importlib, pkgutil
import numpy as np
import spool_estimator, spool_monitor, spool_sim, spool_core
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.warm_up import warm_up
from spool_monitor.monitor import Monitor
from spool_monitor.trend_writer import TravelCounter
from spool_monitor.warm_up import warm_up_monitor
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_core.block import Block

def compiled():
    found = set()
    for package in (spool_sim, spool_core, spool_estimator, spool_monitor):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if module.name.endswith(("_node", "messages", "_services", "_service", "_tasks", "__main__")):
                continue
            for name, kernel in vars(importlib.import_module(module.name)).items():
                for signature in getattr(kernel, "signatures", ()):
                    found.add(f"{kernel.__module__}.{name}{signature}")
    return found

def use():
    valve = find_valve("4weh10_soft")
    for coulomb_force, seconds in ((0.0, 0.5), (0.3, 6.0)):
        estimator, monitor, travel = Estimator(settings_for(valve)), Monitor(), TravelCounter()
        hosted = Monitor()
        for block in Simulator(valve, PRESETS["sweep"], coulomb_force=coulomb_force).records(seconds):
            for estimate in estimator.update(block):
                monitor.update_estimate(estimate)
            monitor.update(block)
            body = np.frombuffer(block.body.tobytes(), dtype=np.float32)
            spool = np.frombuffer(block.spool.tobytes(), dtype=np.float32)
            hosted.update(Block(block.stamp, block.sequence, block.sample_period, body, spool))
            sent = array.array("f", block.body.tobytes())
            for sight in (sent, sent.tobytes()):
                samples = np.frombuffer(sight, dtype=np.float32)
                as_sent = Block(1, 1, 5e-4, samples, samples)
                travel.update(as_sent)
                Estimator(settings_for(valve)).update(as_sent)

before = compiled()
warm_up()
warm_up_monitor()
warm = compiled()
use()
print(len(warm - before), *sorted(compiled() - warm), sep="\\n")
"""


def test_after_the_warm_up_nothing_is_compiled() -> None:
    if not COMPILED:
        pytest.fail("numba is missing: install it, the kernels are 100 times slower without")
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": ":".join(path for path in sys.path if path)},
    )
    assert (done.returncode, done.stderr) == (0, "")
    warmed, *missed = done.stdout.split("\n")
    assert int(warmed) > 10  # else nothing below could fail
    assert [kernel for kernel in missed if kernel] == []
