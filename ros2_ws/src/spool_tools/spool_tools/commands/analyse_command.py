"""`./spool analyse`: what the model of a running valve lacks in its last samples."""

from __future__ import annotations

from spool_tools import command as cli


def analyse(valve: cli.RunningValve, json: cli.JsonFile = None, _force: cli.Force = False) -> None:
    """Run the gap analysis of a running valve's last minute in its estimator, and show the result.

    Example: ./spool analyse valve_1 --json gap.json
    """
    from spool_tools.operations.service_client import analyse_live  # noqa: PLC0415 - slow to load

    analyse_live(valve, json)


COMMAND = cli.Command(analyse, place=225, line="gap analysis of a running valve's last minute", live=True)
