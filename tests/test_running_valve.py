"""One valve that runs: what it tells `/diagnostics`, and a drift switched on while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from spool_msgs.msg import ModelEstimate

if TYPE_CHECKING:
    from .conftest import System, Topic

SIMULATOR = "/valve_1/simulator"
TASKS = {
    "valve_1/simulator: simulation",
    "valve_1/estimator: estimate",
    "valve_1/monitor: data",
    "valve_1/monitor: condition",
    "valve_1/monitor: alarms",
}


@dataclass
class Valve:
    """Simulator, estimator and monitor at work."""

    system: System
    estimates: Topic

    def parameter(self, name: str) -> float:
        quantities = self.estimates.last.parameters
        return float(next(quantity.value for quantity in quantities if quantity.name == name))


@pytest.fixture(scope="module", name="valve")
def _valve(
    make_system: Callable[[Path], AbstractContextManager[System]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Valve]:
    with make_system(tmp_path_factory.mktemp("valve")) as system:
        estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
        _ = system.diagnostics
        system.start("estimator", memory=1.0)
        system.start("monitor")
        system.start("simulator", excitation="multisine")
        system.until(
            lambda: estimates.heard and estimates.last.state == ModelEstimate.STATE_TRACKING, "the valve runs"
        )
        yield Valve(system, estimates)


def valve_id(status: DiagnosticStatus) -> str:
    return next(one.value for one in status.values if one.key == "valve_id")


def test_diagnostics_follow_the_rules(valve: Valve) -> None:
    system = valve.system
    system.until(
        lambda: all(
            system.statuses(task) and valve_id(system.statuses(task)[-1][1]) == "4weh10_soft"
            for task in TASKS
        ),
        "each task says which valve it is of",
    )
    begin = time.monotonic()
    system.until(
        lambda: all(len(system.statuses(task, after=begin)) >= 3 for task in TASKS),
        "each task is reported again and again",
    )
    arrays = [one.message for one in system.diagnostics.heard if one.arrival >= begin]
    statuses = [status for array in arrays for status in array.status]
    assert {status.name for status in statuses} == TASKS
    assert {valve_id(status) for status in statuses} == {"4weh10_soft"}
    assert all(f"{status.hardware_id}: ".lstrip("/") in status.name for status in statuses)
    for array in arrays:
        assert isinstance(array, DiagnosticArray)
        assert array.header.stamp.sec > 0
    values = {value.key: value.value for status in statuses for value in status.values}
    assert all(isinstance(value, str) and value for value in values.values())
    assert {"spring_stiffness_N_per_m", "viscous_coefficient_N_s_per_m", "coulomb_force_N"} <= set(values)
    assert {"dominant_frequency_Hz", "amplification", "natural_frequency_Hz"} <= set(values)
    assert float(values["spring_stiffness_N_per_m"]) == pytest.approx(1632.0, rel=0.05)
    assert all(status.message for status in statuses)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("drift_quantity", "colour", "'colour' is not one of none, viscous_coefficient"),
        ("drift_target", -100.0, "drift_target"),
        ("drift_duration", 1e9, "drift_duration"),
        ("drift_quantity", 3, "expected 'Type.STRING'"),
        ("sample_rate", 4000.0, "sample_rate changes only while the node is unconfigured"),
    ],
)
def test_a_wrong_drift_is_refused_with_the_reason(
    valve: Valve, name: str, value: object, reason: str
) -> None:
    (result,) = valve.system.set_parameters(SIMULATOR, **{name: value})
    assert not result.successful
    assert reason in result.reason


def test_the_estimate_follows_a_drift(valve: Valve) -> None:
    before = valve.parameter("viscous_coefficient")
    target = 2.0 * before
    results = valve.system.set_parameters(
        SIMULATOR, drift_target=target, drift_duration=2.0, drift_quantity="viscous_coefficient"
    )
    assert all(result.successful for result in results), [result.reason for result in results]
    valve.system.until(
        lambda: abs(valve.parameter("viscous_coefficient") / target - 1.0) < 0.1, "the estimate follows"
    )

    def told() -> float:
        numbers = valve.system.numbers("valve_1/simulator: simulation")
        return float(numbers["viscous_coefficient_N_s_per_m"])

    valve.system.until(lambda: told() == pytest.approx(target, rel=1e-4), "the simulator tells of its end")
    assert valve.parameter("spring_stiffness") == pytest.approx(1632.0, rel=0.05)
