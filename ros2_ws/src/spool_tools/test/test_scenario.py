"""What the demonstration promises is found by the cores, whatever instant its drift begins at."""

from __future__ import annotations

import pytest
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.excitation.kinds import from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve.description import find_valve
from spool_tools.demo.scenario import DRIFT, VALVES

SECONDS = 40.0
NOISY = Sensor(noise=0.05)


@pytest.mark.parametrize(
    ("number", "seed", "begin", "missed"), [(0, 29, 26.42, 35), (0, 0, 25.2, 0), (1, 1, 25.2, 7)]
)
def test_resonance_and_drift_are_raised_before_the_end(
    number: int, seed: int, begin: float, missed: int
) -> None:
    """The first drift is one that leaves so much unexplained for a second that a sensor is suspected."""
    one = VALVES[number]
    valve = find_valve(one.valve_file)
    simulator = Simulator(
        valve,
        from_mapping(one.excitation(SECONDS)),
        coulomb_force=one.coulomb_force,
        seed=seed,
        body_sensor=NOISY,
        spool_sensor=NOISY,
    )
    settings = MonitorSettings(natural_frequency=valve.natural_frequency, baseline_time=0.25 * SECONDS)
    both = Replay(Estimator(settings_for(valve)), Monitor(settings))
    drifts = False
    for count, block in enumerate(simulator.records(begin + 14.2)):
        if not drifts and count * 0.02 >= begin:
            drifts = True
            simulator.set_drift(one.drift, one.drift_target, DRIFT[1] * SECONDS)
        if count >= missed:
            both.update(block)
    assert {"resonance", "friction_drift"} == {event.kind for event in both.events}
