"""`./spool replay`: estimator and monitor over a record."""

from __future__ import annotations

from rich.console import Console
from spool_report.outputs import write_json
from spool_report.requests import ReplayRequest
from spool_report.terminal import warn

from spool_tools import command as cli


def replay(
    request: ReplayRequest,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    _force: cli.Force = False,
) -> None:
    """Run estimator and monitor over a record, as fast as the machine can.

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --json result.json

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --report replay.html

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --state baselines

    Example: ./spool replay recordings/press_4 --around resonance

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --params-file limits.yaml
    """
    cli.refuse_missing(request.record)
    from spool_report.runs.record_replay import print_replay, replay_bag  # noqa: PLC0415 - slow to load

    result = replay_bag(request, report)
    if json is not None:
        write_json(json, result)
    for warning in (
        *result["warnings"],
        *(text for one in result["valves"].values() for text in one["warnings"]),
    ):
        warn(warning)
    print_replay(result, Console())
    if report is not None:
        print(f"{report}: pictures and tables")


COMMAND = cli.Command(replay, place=115, line="estimator and monitor over a recorded bag")
