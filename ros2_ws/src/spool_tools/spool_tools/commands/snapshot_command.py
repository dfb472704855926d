"""`./spool snapshot`: the surroundings of this moment of a running valve, kept as a separate bag."""

from __future__ import annotations

from spool_tools.command import Command, CommentOption, RunningValve, WhoOption


def snapshot(valve: RunningValve, who: WhoOption = "", comment: CommentOption = "") -> None:
    """Keep the data around this moment in the running recorder, as it does on an alarm.

    Example: ./spool snapshot valve_1 --who Eva
    """
    from spool_tools.operations.service_client import take_snapshot  # noqa: PLC0415 - slow to load

    take_snapshot(valve, who=who, comment=comment)


COMMAND = Command(
    snapshot,
    place=230,
    line="the minutes around this moment of a running valve, as a separate bag",
    live=True,
)
