"""Warm-up: compile every kernel now, so that no node does it at its first sample.

Run as ``python -m spool_monitor.warm_up``; the kernels of simulator and estimator come with it.
"""

from __future__ import annotations

import math

import numpy as np
from spool_core.block import Block
from spool_estimator.identification.channel_faults import count_repeats

from spool_monitor.channels import KEPT, due_power
from spool_monitor.detectors import MonitorSettings
from spool_monitor.monitor import Monitor
from spool_monitor.trend_writer import TravelCounter

#: s of data after which every kernel has run, those that look at the pair of channels last.
SECONDS = math.ceil(KEPT) + 1


def warm_up_monitor() -> None:
    """Run every kernel of the monitor once, over a body that shakes and a spool that follows."""
    shaking = np.random.default_rng(0).normal(0.0, 5.0, (2, 500)).astype(np.float32)
    shaking[1] *= 0.5
    # Blocks of messages are read-only views of their bytes: numba compiles those apart.
    sent = np.frombuffer(shaking.tobytes(), dtype=np.float32).reshape(shaking.shape)
    for body, spool in (shaking, sent):
        monitor = Monitor(MonitorSettings(natural_frequency=15.0))
        for second in range(SECONDS):
            monitor.update(Block((1 + second) * 10**9, second, 2e-3, body, spool))
        TravelCounter().update(Block(10**9, 1, 2e-3, body, spool))
    # A spool that follows without a lag is no valve's: the detector behind that is not asked.
    due_power(np.ones(1), np.ones(1), 1.0, 1.0)
    # Nor do these samples repeat.
    count_repeats(np.ones(2), 1.0, 0.0, 1.0)


if __name__ == "__main__":
    from spool_estimator.warm_up import warm_up

    warm_up()
    warm_up_monitor()
