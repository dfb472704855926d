"""An estimator that was given another valve's file says so while it runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

if TYPE_CHECKING:
    from .conftest import System

TASK = "valve_1/estimator: estimate"
SAID = "says 15.2 Hz, the record shows 28.7 Hz"


@pytest.mark.slow
def test_diagnostics_and_log_name_both_frequencies(system: System) -> None:
    _ = system.diagnostics
    estimator = system.start("estimator", memory=1.0, valve_file="4weh10_soft")
    system.start("simulator", excitation="multisine", valve_file="4weh10_stiff")

    def told() -> bool:
        return any(SAID in status.message for _, status in system.statuses(TASK))

    system.until(told, "the valve file is doubted")
    assert system.statuses(TASK)[-1][1].level == DiagnosticStatus.WARN
    assert estimator.said.count(SAID) == 1
