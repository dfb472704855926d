"""What detectors doubt of others, for how long, and what they forget."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from spool_core.block import Block
from spool_estimator.identification.channel_faults import ChannelFault, PairLook
from spool_monitor.channels import Channel, ChannelLook, Signals, ValveResponse, due_power, look
from spool_monitor.detection import COLDER_MOST, Detection
from spool_monitor.detectors import Moment, MonitorSettings
from spool_monitor.detectors.channel_faults import Sensitivity
from spool_monitor.detectors.sensor_faults import SensorOffset
from spool_monitor.detectors.stuck_spool import StuckSpool
from spool_monitor.event import Severity
from spool_monitor.monitor import Monitor
from spool_monitor.parameter_drift import VISCOSITY_PER_KELVIN
from spool_monitor.state_file import Baseline
from spool_monitor.window import WindowTracker

SECOND = 1_000_000_000
REFERENCE = ValveResponse(15.0, 47.0, 1.0, 0.1, 0.1, 0.1)
BODY = Channel(0.0, 5.0, 0.0, False)


def moving(second: int, share: float) -> Moment:
    """Return a moment in which the spool moves relative to its body by ``share`` of what is due."""
    frequency, power = np.array([12.0]), np.array([32.0])
    due = math.sqrt(due_power(frequency, power, REFERENCE.square, REFERENCE.damping))
    cross = np.zeros(1, complex)
    signals = Signals(
        second * SECOND, BODY, BODY, frequency, power, power, 32.0, 32.0, cross, share * due, 0.1, 10.0
    )
    return Moment(second * SECOND, 15.0, REFERENCE, {}, {}, signals=signals)


def test_one_slow_second_of_a_spool_that_dry_friction_slows_down_is_doubted_for_that_second_only() -> None:
    detector, doubted = StuckSpool(MonitorSettings()), []
    for second, share in enumerate([0.3, 0.19, 0.3, 0.35, 0.39, 0.3]):
        detector.update(moving(second, share))
        doubted.append(bool(detector.suspicious))
    assert doubted == [False, True, False, False, False, False]


def test_while_an_alarm_of_a_stuck_spool_lasts_its_parameters_are_doubted() -> None:
    """It moves more than a stuck one, and less than one that is free, also after a gap in the data."""
    detection = Detection(MonitorSettings(natural_frequency=15.0))
    for second in range(30):
        if second == 12:
            detection.restart(1e-3)
        detection._stamp = second * SECOND
        moment = moving(second, 0.1 if second < 6 else 0.3)
        detection._show(moment.stamp, 15.0, signals=moment.signals, reference=REFERENCE)
        if second > 6:
            assert detection.conditions["stuck_spool"].active is Severity.ALARM
            assert detection.distrust


@pytest.mark.parametrize(
    ("first", "second"), [("stuck_spool", "sensor_scale"), ("sensor_scale", "stuck_spool")]
)
def test_of_two_faults_that_hide_each_other_the_one_that_stands_is_believed(first: str, second: str) -> None:
    detection = Detection(MonitorSettings(natural_frequency=15.0))
    one, other = (next(each for each in detection.detectors if each.name == name) for name in (first, second))
    detection._suspicions[first] = SECOND, one, "it stands"
    (condition,) = detection.conditions_of(one)
    condition.active = Severity.ALARM
    assert detection._distrust(2 * SECOND, other) == "it stands"
    assert detection._distrust(2 * SECOND, one) == ""


def offset(wanders: float, moved: float) -> bool:
    """Return whether a spool's mean that moves by ``moved`` after it had wandered is found, m/s^2."""
    detector = SensorOffset(MonitorSettings())
    starts = {name: Baseline(40.0) for name in SensorOffset.learns}
    found = False
    for second in range(100):
        mean = wanders * (-1.0) ** (second // 10) if second < 60 else moved
        signals = moving(second, 0.5).signals
        assert signals is not None
        signals = signals._replace(spool=BODY._replace(mean=mean))
        findings = detector.update(moving(second, 0.5)._replace(signals=signals, learned=starts))
        found = found or any(one.indicated is not None and one.part == "spool" for one in findings)
    return found


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_mean_that_always_wandered_must_move_further_to_be_an_offset(side: float) -> None:
    """Otherwise it must move by ``offset_change``, 0.5 m/s^2, to either side."""
    assert not offset(0.0, side * 0.45)
    assert offset(0.0, side * 0.55)
    assert not offset(0.5, side * 4.2)
    assert offset(0.5, side * 5.2)


def test_what_can_no_longer_be_judged_is_doubted_no_longer() -> None:
    fault = ChannelFault(
        "sensitivity", "both", "gain", 1.5, 1.3, "1", "spool reads 1.5 times as much", "check"
    )
    detector = Sensitivity(MonitorSettings())
    for second, pair in enumerate([PairLook(fault, math.nan), None]):
        look = ChannelLook(second * SECOND, (), pair, True)
        detector.update(moving(second, 0.5)._replace(channels=look, signals=None))
        assert bool(detector.suspicious) is (pair is not None)


def test_the_drag_of_cold_oil_is_bounded_and_a_thermometer_that_fails_brings_no_other() -> None:
    detection = Detection(MonitorSettings(natural_frequency=15.0))
    detection.parameters["viscous_coefficient"].temperature = 41.0
    detection._celsius = -50.0
    drag = detection.reference.damping
    assert detection._reference_now().damping == drag * math.exp(VISCOSITY_PER_KELVIN * COLDER_MOST)
    # Followed at 5 deg C; then the thermometer was silent, and is there again.
    detection.reference = replace(detection.reference, damping=6.0 * drag)
    detection._followed_at = math.nan
    detection._celsius = 6.0
    assert detection._reference_now().damping == 6.0 * drag


def test_after_a_repair_the_friction_and_the_gain_of_the_healthy_valve_are_learned_again() -> None:
    detection = Detection(MonitorSettings(natural_frequency=15.0))
    stuck, scale = (
        next(one for one in detection.detectors if one.name == name)
        for name in ("stuck_spool", "sensor_scale")
    )
    stuck._friction, scale._recent, scale._found = 40.0, 1.4, True
    detection.reference = replace(detection.reference, natural_frequency=29.0, misfit=0.1)
    detection.relearn()
    assert stuck._friction == 0.0
    assert math.isnan(scale._recent)
    assert not scale._found
    assert detection.reference.natural_frequency == 15.0


def test_one_sensor_wired_twice_at_rest_ends_no_monitor() -> None:
    monitor, generator = Monitor(MonitorSettings(natural_frequency=15.0)), np.random.default_rng(0)
    for number in range(40):
        row = (0.08 * np.round(generator.normal(0.0, 0.016, 500) / 0.08)).astype(np.float32)
        monitor.update(Block(10**18 + number * SECOND // 2, number, 1e-3, row, row.copy()))
    assert monitor.detection.judgements["not_judged"].name == "JUDGED"


def test_windows_of_the_slowest_rate_have_no_line_beyond_their_spectrum() -> None:
    tracker = WindowTracker()
    tracker.restart(0.2)
    row = (np.arange(64) % 3).astype(np.float32)
    (first, *_) = tracker.update(Block(1, 1, 0.2, row, row))
    assert look(first).frequency.size <= first.spectrum.shape[1]
    assert look(first).frequency[-1] <= 0.5 / 0.2
