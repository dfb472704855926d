"""Timing of each hosted valve as diagnostic tasks: age, wait and loss of its blocks, and its cost."""

from __future__ import annotations

from collections.abc import Mapping

from spool_core.node.block_hub import TopicTimes
from spool_core.node.diagnostics import Level, Status


def valve_timings(times: Mapping[str, TopicTimes], elapsed: float, resident: int) -> list[Status]:
    """Return a task for each valve, and begin its next interval.

    Args:
        times: of each topic of blocks.
        elapsed: s, since the last call.
        resident: B, of the process; a valve is given its share.
    """
    return [
        _timing(topic.strip("/").rpartition("/")[0], one, elapsed, resident // len(times))
        for topic, one in times.items()
    ]


def _timing(valve: str, times: TopicTimes, elapsed: float, resident: int) -> Status:
    new = times.since()
    values: dict[str, object] = {
        "blocks": times.messages,
        "blocks_late": times.late,
        "blocks_lost": times.blocks_lost,
        "blocks_waiting": times.waiting,
        "block_age_s": times.age,
        "longest_wait_s": times.longest_wait,
        "cpu_share": new.work / elapsed,
        "resident_B": resident,
    }
    times.longest_wait = 0.0
    told = [
        f"{count} blocks {what}" for count, what in ((new.late, "late"), (new.blocks_lost, "lost")) if count
    ]
    if not new.messages:
        told = ["no blocks"]
    return Status(valve, Level.WARNING if told else Level.OK, ", ".join(told) or "in time", values)
