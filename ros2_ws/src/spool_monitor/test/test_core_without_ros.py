from __future__ import annotations

import os
import subprocess
import sys

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
from spool_monitor import detection, monitor, replay
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

valve = find_valve("4weh10_soft")
both = replay.Replay(Estimator(settings_for(valve)), monitor.Monitor())
both.run(Simulator(valve, PRESETS["sweep"], coulomb_force=0.1).records(6.0))
print(both.monitor.health)
for one in both.events:
    print(one)
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
    blocked, free = run(USE, *ROS), run(USE)
    assert blocked.returncode == 0, blocked.stderr
    assert "resonance" in blocked.stdout
    assert blocked.stdout == free.stdout


def test_the_blocker_blocks() -> None:
    done = run("import spool_monitor.monitor_node", *ROS)
    assert done.returncode == 1
    assert "is blocked" in done.stderr
