"""Compile every kernel now, so that no node does it at its first sample.

Run as ``python -m spool_estimator.warm_up``.
"""

from __future__ import annotations

import numpy as np
from spool_sim import motion
from spool_sim.motion import MotionState, advance

from .conditioning import COLUMNS, Conditioning


def warm_up() -> None:
    """Run every kernel of simulator and estimator once, with and without dry friction."""
    motion.warm_up()
    advance(
        MotionState(),
        np.asarray(np.arange(9.0), dtype=np.float64),
        sample_period=1e-3,
        substeps=1,
        mass=0.18,
        viscous_coefficient=4.0,
        spring_stiffness=1632.0,
        coulomb_force=0.1,
    )
    warm_up_estimator()


def warm_up_estimator() -> None:
    """Run every kernel of the estimator once."""
    samples = np.ones(4, dtype=np.float32)
    Conditioning(1e-3).take(samples, samples, np.empty((4, COLUMNS)))
    # Blocks of messages are read-only views of their bytes: numba compiles those apart.
    view = np.frombuffer(samples.tobytes(), dtype=np.float32)
    Conditioning(1e-3).take(view, view, np.empty((4, COLUMNS)))


if __name__ == "__main__":
    warm_up()
