"""Workload of a host: what operators read of a process that does not keep up."""

from __future__ import annotations

import pytest
from spool_bringup.host.host_process import Workload
from spool_core.node.block_hub import TopicTimes
from spool_core.node.diagnostics import Level


@pytest.mark.parametrize(
    ("wait", "level"), [(0.4, Level.OK), (0.5, Level.WARNING), (1.9, Level.WARNING), (2.0, Level.ERROR)]
)
def test_half_a_second_of_waiting_is_a_warning_and_two_are_an_error(wait: float, level: Level) -> None:
    workload, times = Workload(), {"/valve_1/acceleration": TopicTimes(longest_wait=wait)}
    workload.take(0.0, times, 0.0)
    assert workload.level is level
    times["/valve_1/acceleration"].longest_wait = 0.0
    workload.take(1.0, times, wait)
    assert workload.level is level


def test_dropped_blocks_are_said_once_and_for_ten_seconds() -> None:
    times = {name: TopicTimes() for name in ("/valve_1/acceleration", "/valve_2/acceleration")}
    workload, log = Workload(), []
    for second in range(30):
        times["/valve_1/acceleration"].messages += 50
        times["/valve_2/acceleration"].messages += 20 if second == 10 else 50
        if second == 10:
            times["/valve_2/acceleration"].dropped += 30
            times["/valve_2/acceleration"].seconds_dropped += 0.6
        log.append((workload.take(float(second), times, 0.0), workload.level))
    assert [text for text, _ in log if text] == [
        "the controller is too busy: 970 of 1000 blocks judged in the last 10 s, "
        "1 of 2 valves behind by up to 0.6 s: use more processes or fewer valves"
    ]
    assert [place for place, (_, level) in enumerate(log) if level is Level.WARNING] == list(range(10, 20))


def test_a_process_without_a_moment_of_rest_is_too_busy_before_blocks_wait_for_long() -> None:
    times, workload = {"/valve_1/acceleration": TopicTimes(messages=1)}, Workload()
    busy = {1.0: 0.9, 1.25: 1.15, 1.5: 0.1}
    levels = {}
    for look in range(50):
        now = 0.25 * look
        workload.take(now, times, 0.1, busy.get(now, 0.0))
        levels[now] = workload.level
    warned = [now for now, level in levels.items() if level is Level.WARNING]
    assert (warned[0], warned[-1]) == (1.25, 11.0)
