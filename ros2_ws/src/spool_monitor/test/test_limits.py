"""Limits that are refused."""

from __future__ import annotations

import pytest
from spool_core.errors import InputError
from spool_monitor.detectors import MonitorSettings
from spool_monitor.monitor import Monitor


@pytest.mark.parametrize(("on", "off"), [(1.2, 1.9), (1.8, 1.8)])
def test_thresholds_in_the_wrong_order_are_refused(on: float, off: float) -> None:
    with pytest.raises(
        InputError, match=rf"amplification_off \({off}\) must lie below amplification_on \({on}\)"
    ):
        Monitor(MonitorSettings(amplification_on=on, amplification_off=off))


def test_a_limit_that_there_is_not_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match=r"no limit 'gain_chnge'; there are: .*gain_change"):
        Monitor(MonitorSettings(gain_chnge=0.2))
