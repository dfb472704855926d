"""Limits that change while the monitor runs."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.errors import InputError
from spool_monitor.detectors import MonitorSettings
from spool_monitor.detectors.base import NATURAL_FREQUENCY
from spool_monitor.event import EventState
from spool_monitor.monitor import Monitor

RATE, SIZE = 1000, 100


def shaken(seconds: float, start: int = 0) -> Iterator[Block]:
    """Return blocks of a body that shakes at 15 Hz with 3 m/s^2 and a spool that amplifies it 2.5 times."""
    noise = np.random.default_rng(5)
    for number in range(start, start + round(seconds * RATE / SIZE)):
        time = (number * SIZE + np.arange(SIZE)) / RATE
        line = 3.0 * np.sin(2.0 * math.pi * 15.0 * time)
        body, spool = line, 2.5 * line
        yield Block(
            10**9 + number * SIZE * 10**6,
            number,
            1.0 / RATE,
            (body + noise.normal(0.0, 0.02, SIZE)).astype(np.float32),
            (spool + noise.normal(0.0, 0.02, SIZE)).astype(np.float32),
        )


def test_a_lowered_limit_finds_the_resonance_that_the_old_one_let_pass() -> None:
    settings = MonitorSettings(natural_frequency=15.0, amplification_on=4.0, amplification_off=3.0)
    monitor = Monitor(settings)
    before = [event for block in shaken(8.0) for event in monitor.update(block)]
    assert not [event for event in before if event.kind == "resonance"]
    monitor.set_limits(MonitorSettings(amplification_on=1.8, amplification_off=1.5))
    after = [event for block in shaken(4.0, 80) for event in monitor.update(block)]
    assert [(event.kind, event.state) for event in after if event.kind == "resonance"] == [
        ("resonance", EventState.RAISED)
    ]
    # What was known of the valve stays.
    assert monitor.settings[NATURAL_FREQUENCY] == 15.0


@pytest.mark.parametrize(("on", "off"), [(1.2, 1.9), (1.8, 1.8)])
def test_thresholds_in_the_wrong_order_are_refused(on: float, off: float) -> None:
    with pytest.raises(
        InputError, match=rf"amplification_off \({off}\) must lie below amplification_on \({on}\)"
    ):
        Monitor(MonitorSettings(amplification_on=on, amplification_off=off))


def test_a_limit_that_there_is_not_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match=r"no limit 'gain_chnge'; there are: .*gain_change"):
        Monitor(MonitorSettings(gain_chnge=0.2))
