"""A dead monitor is noticed by the recorder."""

from __future__ import annotations

from spool_bag.recorder import Monitored, MonitoringWatch


def test_a_monitor_that_died_is_missed_within_seconds() -> None:
    watch = MonitoringWatch()
    for tenth in range(100):
        watch.saw_data("valve_1", 0.1 * tenth)
        if tenth % 10 == 0:
            watch.saw_health("valve_1", 0.1 * tenth)
    assert watch.states(10.0) == {"valve_1": Monitored.YES}
    for tenth in range(100, 160):
        watch.saw_data("valve_1", 0.1 * tenth)
    assert watch.states(16.0) == {"valve_1": Monitored.NO}
    watch.saw_health("valve_1", 16.1)
    assert watch.states(16.2) == {"valve_1": Monitored.YES}


def test_a_dead_monitor_of_a_silent_machine_is_missed_as_well() -> None:
    """Both may hang on one computer that failed: nobody else would tell of the silence."""
    watch = MonitoringWatch()
    watch.saw_data("valve_1", 0.0)
    assert watch.states(300.0) == {"valve_1": Monitored.IDLE}  # a machine that never had a monitor
    watch.saw_health("valve_1", 300.0)
    assert watch.states(320.0) == {"valve_1": Monitored.NO}


def test_a_monitor_may_take_its_time_to_start_but_not_for_ever() -> None:
    watch = MonitoringWatch()
    states = []
    for second in range(200):
        watch.saw_data("valve_1", float(second))
        states.append(watch.states(float(second))["valve_1"])
    assert states[0] is Monitored.IDLE
    assert states[10] is Monitored.NOT_YET
    assert states[170] is Monitored.NOT_YET
    assert states[-1] is Monitored.NO
