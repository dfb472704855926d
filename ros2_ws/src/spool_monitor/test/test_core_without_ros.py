"""Simulator, estimator and monitor work without ROS, simulator and estimator without numba."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from contextlib import redirect_stdout

import pytest

BLOCKER = """
import importlib.abc, sys

class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in BLOCKED or name.split(".")[0] in BLOCKED:
            raise ImportError(f"{name} is blocked")
        return None

sys.meta_path.insert(0, Blocker())
"""
USE = """
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.warm_up import warm_up
from spool_monitor import detection, monitor, replay
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

warm_up()
valve = find_valve("4weh10_soft")
both = replay.Replay(Estimator(settings_for(valve)), monitor.Monitor())
both.run(Simulator(valve, PRESETS["sweep"], coulomb_force=0.1).records(SECONDS))
for quantity in both.estimator.latest.parameters:
    print(quantity.value.hex())
"""
EVENTS = """
print(both.monitor.health)
for one in both.events:
    print(one)
"""
#: With ROS blocked: each module of the simulator that is no node, and one that is.
IMPORT = """
import importlib, pkgutil, spool_sim
for module in pkgutil.walk_packages(spool_sim.__path__, "spool_sim."):
    if not module.name.endswith(("_node", ".program")):
        importlib.import_module(module.name)
for node in ("spool_estimator.estimator_node", "spool_monitor.monitor_node"):
    try:
        importlib.import_module(node)
    except ImportError as error:
        print(error, file=sys.stderr)
"""
MOTION = """
import numpy as np
from spool_core.kernels.compiled import COMPILED, notice
from spool_sim.excitation import SteadySine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import load_model
t = half_step_times(0, 300, 2000.0, 2)
body = SteadySine(frequency=20.0, amplitude=12.0, soft_start=0.0).acceleration(t)
motion = ComposedMotion(load_model("coulomb").terms)
values = dict(mass=0.18, viscous_coefficient=2.65, spring_stiffness=1632.0, coulomb_force=0.5)
z, end = motion.advance(MotionState(), body, motion.table(values, 300), sample_period=5e-4, substeps=2)
print(COMPILED, notice() is None, *[float(x).hex() for x in z.acceleration])
"""
ROS = (
    "rclpy", "spool_msgs", "std_msgs", "rcl_interfaces", "builtin_interfaces", "diagnostic_msgs",
    "spool_core.node",
)  # fmt: skip


def run(code: str, *blocked: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", f"BLOCKED = {blocked!r}\n{BLOCKER}\n{code}"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": ":".join(path for path in sys.path if path)},
    )


def test_the_cores_work_with_ros_blocked() -> None:
    code = f"SECONDS = 6.0\n{USE}{EVENTS}"
    blocked = run(f"{code}{IMPORT}", *ROS)
    assert blocked.returncode == 0, blocked.stderr
    assert "resonance" in blocked.stdout
    with redirect_stdout(io.StringIO()) as free:
        exec(code, {})
    assert blocked.stdout == free.getvalue()
    assert blocked.stderr.count("is blocked\n") == 2


def test_without_numba_the_kernel_gives_the_same_and_says_what_it_costs() -> None:
    plain = run(MOTION, "numba").stdout.split()
    with redirect_stdout(io.StringIO()) as said:
        exec(MOTION, {})
    compiled = said.getvalue().split()
    assert compiled[0] == compiled[1]  # where there is numba nothing needs a notice
    assert plain[:2] == ["False", "False"]
    values = [[float.fromhex(x) for x in words[2:]] for words in (compiled, plain)]
    assert len(values[0]) == 300
    assert max(abs(a - b) for a, b in zip(*values, strict=True)) < 1e-9


@pytest.mark.slow
def test_without_numba_the_estimator_gives_the_same_and_says_once_what_that_costs() -> None:
    code = f"SECONDS = 3.0\n{USE}"
    plain, compiled = run(code, "numba"), run(code)
    assert plain.returncode == 0, plain.stderr
    assert plain.stderr.count("numba is not installed") == 1
    assert compiled.stderr == ""
    for one, other in zip(plain.stdout.split(), compiled.stdout.split(), strict=True):
        assert abs(float.fromhex(one) / float.fromhex(other) - 1.0) < 1e-6
