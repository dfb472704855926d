from __future__ import annotations

import os
import subprocess
import sys

BLOCKER = """
import importlib.abc, os, sys, pkgutil

class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        blocked = {"rclpy", "spool_msgs", "spool_core.node", "std_msgs"} | set(BLOCKED)
        if name in blocked or name.split(".")[0] in blocked:
            raise ImportError(f"{name} is blocked")
        return None

sys.meta_path.insert(0, Blocker())
import importlib, spool_sim
for module in pkgutil.walk_packages(spool_sim.__path__, "spool_sim."):
    if not module.name.endswith(("_node", ".program")):  # what runs as a node
        importlib.import_module(module.name)
"""


def run(code: str, *blocked: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", f"BLOCKED = {blocked!r}\n{BLOCKER}\n{code}"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": ":".join(path for path in sys.path if path)},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_core_imports_no_ros() -> None:
    assert run("print('rclpy' in sys.modules, 'spool_sim.simulator' in sys.modules)").split() == [
        "False",
        "True",
    ]


def test_without_numba_the_kernel_gives_the_same_and_says_what_it_costs() -> None:
    code = """
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
    compiled = run(code).split()
    uncompiled = run(code, "numba").split()
    assert compiled[1] == "True" if compiled[0] == "True" else compiled[1] == "False"
    assert uncompiled[:2] == ["False", "False"]
    values = [[float.fromhex(x) for x in words[2:]] for words in (compiled, uncompiled)]
    assert len(values[0]) == 300
    assert max(abs(a - b) for a, b in zip(*values, strict=True)) < 1e-9
