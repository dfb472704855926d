"""Scenario of the demonstration: what it promises is found, whatever instant its drift begins at."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.listener import HeardValve
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_msgs.msg import ModelEstimate, ValveHealth
from spool_sim.excitation import from_mapping, load_excitation
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_tools.operations.demo import DRIFT, PASSAGE, VALVES
from spool_tools.operations.valve_rows import lines_of

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


def test_what_is_not_known_yet_is_shown_as_words() -> None:
    health = ValveHealth(summary="waiting for estimates")
    health.dominant_frequency.value = math.nan
    valves = {"a": HeardValve("a", health, estimate=ModelEstimate()), "b": HeardValve("b")}
    known, silent = lines_of(valves)
    assert "nan" not in known
    assert "waiting for estimates" in known
    assert silent.count("not known") == 4


@pytest.mark.parametrize("seconds", [30.0, 60.0, 3600.0])
def test_each_valve_of_the_demonstration_passes_its_resonance_and_then_drifts(
    seconds: float, tmp_path: Path
) -> None:
    assert 0.0 < PASSAGE[0] < PASSAGE[1] < PASSAGE[2] < DRIFT[0] < sum(DRIFT) < 1.0
    for one in VALVES:
        valve = find_valve(one.valve_file)
        excitation = load_excitation(str(one.write_excitation(tmp_path, seconds)))
        natural = valve.natural_frequency
        assert abs(one.resonant_speed / 60.0 / natural - 1.0) < 0.05
        assert abs(one.steady_speed / 60.0 / natural - 1.0) > 0.3
        simulator = Simulator(valve, excitation, coulomb_force=one.coulomb_force)
        before = getattr(simulator.truth, one.drift)
        simulator.set_drift(one.drift, one.drift_target)
        simulator.next_block()
        assert getattr(simulator.truth, one.drift) == one.drift_target != before
