"""What the live path costs, counted as work and not as time: the budget of docs/architecture.md.

A node takes block after block, so calls of Python count; a check that looks at samples again counts as often
as a compiled function passes over them.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from types import FrameType
from typing import Any

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.kernels.compiled import compiled
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.monitor import Monitor
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
#: Calls of Python functions a block, and passes over each sample by the estimation and by all checks.
CALLS, PASSES_ESTIMATION, PASSES_CHECKS = 120, 3.0, 40.0
#: Kernels of the estimation: a sample costs tens of times what it costs a check.
ESTIMATION = ("run_chunks", "follow")
#: Blocks a second.
BLOCKS = 50


@pytest.fixture(scope="module")
def blocks() -> list[Block]:
    noisy = Sensor(noise=0.03)
    simulator = Simulator(
        VALVE, PRESETS["multisine"], coulomb_force=0.3, seed=3, body_sensor=noisy, spool_sensor=noisy
    )
    found = list(simulator.records(100.0))
    run_in(found, 100)  # loads every kernel
    return found


def live() -> Callable[[Block], None]:
    """Return what takes blocks as the two nodes of a valve do."""
    estimator, monitor = Estimator(settings_for(VALVE)), Monitor(MonitorSettings(natural_frequency=15.2))

    def take(block: Block) -> None:
        monitor.update(block)
        for estimate in estimator.update(block):
            monitor.update_estimate(estimate)

    return take


def run_in(blocks: list[Block], seconds: int) -> Callable[[Block], None]:
    take = live()
    for block in blocks[: seconds * BLOCKS]:
        take(block)
    return take


@pytest.mark.parametrize(("since", "until"), [(0, 20), (60, 100)])
def test_a_block_costs_a_bounded_number_of_calls(blocks: list[Block], since: int, until: int) -> None:
    calls = 0

    def count(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    take = run_in(blocks, since)
    part = blocks[since * BLOCKS : until * BLOCKS]
    sys.setprofile(count)
    try:
        for block in part:
            take(block)
    finally:
        sys.setprofile(None)
    assert calls / len(part) < CALLS


def test_kernels_pass_over_each_sample_a_bounded_number_of_times(
    blocks: list[Block], monkeypatch: pytest.MonkeyPatch
) -> None:
    passes: Counter[str] = Counter()

    def counting(kernel: Any) -> Callable[..., Any]:
        def counted(*given: Any) -> Any:
            passes[kernel.__name__] += max(
                (one.size for one in given if isinstance(one, np.ndarray)), default=0
            )
            return kernel(*given)

        return counted

    kind = type(compiled(lambda value: value))
    for module in [module for name, module in sys.modules.items() if name.startswith("spool_")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, kind):
                monkeypatch.setattr(module, name, counting(value))
    take = run_in(blocks, 60)
    passes.clear()
    for block in blocks[60 * BLOCKS :]:
        take(block)
    samples = sum(block.body.size for block in blocks[60 * BLOCKS :])
    estimation = sum(passes.pop(name) for name in ESTIMATION)
    assert estimation / samples < PASSES_ESTIMATION
    assert passes.total() / samples < PASSES_CHECKS
