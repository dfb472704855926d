"""Compile every kernel now, so that no node does it at its first sample (``-m spool_estimator.warm_up``)."""

from __future__ import annotations

import numpy as np
from spool_core.block import Block
from spool_core.kernels.samples import StandingWatch
from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.model import load_model
from spool_sim.valve import find_valve

from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.prediction import Prediction
from spool_estimator.sliding_window import ChunkWindow

#: Samples after which an estimator has started and stepped on, s between them (few are quick), and the
#: frequencies that shake the body, Hz.
SAMPLES, PERIOD, LINES = 2000, 2e-3, np.arange(10.0, 100.0, 5.0)


def warm_up() -> None:
    """Run every kernel of simulator and estimator once."""
    ComposedMotion(load_model("coulomb").terms).warm_up()
    warm_up_estimator()


def warm_up_estimator() -> None:
    """Run every kernel of the estimator once."""
    scale = np.ones(3)
    prediction = Prediction(1e-3, 0.18, scale)
    samples = np.ones(16, dtype=np.float32)
    # Blocks of messages are read-only views of their bytes: numba compiles those apart.
    for view in (samples, np.frombuffer(samples.tobytes(), dtype=np.float32)):
        prediction.take(view, view, np.array([1632.0, 4.0, 0.1]))
    window = ChunkWindow(scale)
    window.add_sums(np.eye(3), scale, 1.0, 1.0, scale)
    window.best()
    StandingWatch(1e-3).take(np.stack((samples, samples)))
    valve = find_valve("4weh10_soft")
    # A linear valve in steady motion: its spool's acceleration is that of the body times the response.
    turn = 2j * np.pi * LINES
    pushes = valve.spring_stiffness + turn * valve.viscous_coefficient
    response = pushes / (pushes + turn**2 * valve.moving_mass)
    waves = np.exp(np.outer(turn, PERIOD * np.arange(SAMPLES)) + 1j * LINES[:, np.newaxis] ** 2)
    rows = np.stack((waves.sum(axis=0), response @ waves)).imag.astype(np.float32)
    sent = np.frombuffer(rows.tobytes(), dtype=np.float32).reshape(rows.shape)
    for body, spool in (rows, sent):
        Estimator(settings_for(valve)).update(Block(10**9, 0, PERIOD, body, spool))


if __name__ == "__main__":
    warm_up()
