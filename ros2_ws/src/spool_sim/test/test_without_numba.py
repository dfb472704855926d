from __future__ import annotations

import io
import os
import subprocess
import sys
from contextlib import redirect_stdout

CODE = """
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


def test_without_numba_the_kernel_gives_the_same_and_says_what_it_costs() -> None:
    uncompiled = subprocess.run(
        [sys.executable, "-c", f"import sys\nsys.modules['numba'] = None\n{CODE}"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": ":".join(path for path in sys.path if path)},
    )
    with redirect_stdout(io.StringIO()) as compiled:
        exec(CODE, {})
    words = [said.split() for said in (compiled.getvalue(), uncompiled.stdout)]
    assert words[0][0] == words[0][1]  # where there is numba nothing needs a notice
    assert words[1][:2] == ["False", "False"]
    values = [[float.fromhex(x) for x in row[2:]] for row in words]
    assert len(values[0]) == 300
    assert max(abs(a - b) for a, b in zip(*values, strict=True)) < 1e-9
