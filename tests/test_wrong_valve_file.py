"""An estimator that was given another valve's file says so while it runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from spool_msgs.msg import HealthEvent, ValveHealth

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


@pytest.mark.slow
def test_a_second_estimator_of_another_valve_is_an_alarm_and_the_first_one_is_used(system: System) -> None:
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    system.start("monitor", baseline_time=3.0)
    system.start("estimator", valve_file="4weh10_soft")
    system.start("simulator", valve_file="4weh10_soft", excitation="multisine")
    learned = ValveHealth.BASELINE_FROZEN
    system.until(lambda: health.first(lambda one: one.baseline == learned), "the baseline is learned")
    second = system.start("estimator", valve_file="4weh10_stiff")
    named = (702, "4weh10_stiff")
    system.until(
        lambda: events.first(lambda one: (one.code, one.subject) == named), "the second estimator is named"
    )
    heard = len(health.heard)
    system.until(lambda: len(health.heard) > heard + 3, "the monitor goes on")
    assert health.last.header.frame_id == "4weh10_soft"
    assert health.last.baseline == learned
    second.end()
