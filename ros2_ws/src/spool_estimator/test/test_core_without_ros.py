from __future__ import annotations

import os
import subprocess
import sys

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
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

warm_up()
valve = find_valve("4weh10_soft")
estimator = Estimator(settings_for(valve))
estimates = []
for block in Simulator(valve, PRESETS["multisine"], coulomb_force=0.3).records(SECONDS):
    estimates += estimator.update(block)
for quantity in estimates[-1].parameters:
    print(quantity.value.hex())
"""
ROS = (
    "rclpy",
    "spool_msgs",
    "std_msgs",
    "rcl_interfaces",
    "builtin_interfaces",
    "diagnostic_msgs",
    "spool_core.node",
)


def run(code: str, *blocked: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", f"BLOCKED = {blocked!r}\n{BLOCKER}\n{code}"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": ":".join(path for path in sys.path if path)},
    )


def test_the_core_works_with_ros_blocked() -> None:
    code = f"SECONDS = 6.0\n{USE}"
    blocked, free = run(code, *ROS), run(code)
    assert blocked.returncode == 0, blocked.stderr
    assert len(blocked.stdout.split()) == 3
    assert blocked.stdout == free.stdout


def test_the_blocker_blocks() -> None:
    done = run("import spool_estimator.estimator_node", *ROS)
    assert done.returncode == 1
    assert "is blocked" in done.stderr


@pytest.mark.slow
def test_without_numba_it_gives_the_same_and_says_once_what_that_costs() -> None:
    code = f"SECONDS = 3.0\n{USE}"
    plain, compiled = run(code, "numba"), run(code)
    assert plain.returncode == 0, plain.stderr
    assert plain.stderr.count("numba is not installed") == 1
    assert compiled.stderr == ""
    for one, other in zip(plain.stdout.split(), compiled.stdout.split(), strict=True):
        assert abs(float.fromhex(one) / float.fromhex(other) - 1.0) < 1e-6
