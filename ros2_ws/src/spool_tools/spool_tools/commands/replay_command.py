"""`./spool replay`: estimator and monitor over a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from spool_report.outputs import write_json
from spool_report.requests import model_names
from spool_report.terminal import warn

from spool_tools import command as cli
from spool_tools.command import Command


def replay(
    record: cli.RecordArgument,
    valve: cli.ValveFiles = None,
    columns: cli.ColumnsOption = None,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    _force: cli.Force = False,
    state: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder that keeps each valve's baseline: learned from the first record."
        ),
    ] = None,
    since: cli.SinceOption = None,
    until: cli.UntilOption = None,
    around: cli.AroundOption = None,
    params_file: cli.ParamsFile = None,
    language: cli.LanguageOption = "",
    refits: Annotated[
        bool, typer.Option("--refits", help="Refit the last 4 s at regular intervals.")
    ] = False,
    refit_model: Annotated[
        str, typer.Option(help="Model of the refits: name or YAML file.", autocompletion=model_names)
    ] = "coulomb",
    refit_period: Annotated[
        float, typer.Option(help="Data time between refits, s.", callback=cli.in_range(0.1, 3600.0))
    ] = 5.0,
) -> None:
    """Run estimator and monitor over a record, as fast as the machine can.

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --json result.json

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --report replay.html

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --state baselines

    Example: ./spool replay recordings/press_4 --around resonance

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --params-file limits.yaml
    """
    cli.refuse_missing(record)
    # slow to load
    from spool_report.runs import record_replay as replaying  # noqa: PLC0415

    options = replaying.ReplayOptions(
        refits=replaying.RefitRequest(refit_model, refit_period) if refits else None,
        params_file=params_file,
        columns=columns,
        report=report,
        state=state,
        when=(since, until, around),
        language=language,
    )
    result = replaying.replay_bag(record, valve or [], options)
    if json is not None:
        write_json(json, result)
    for warning in (
        *result["warnings"],
        *(text for one in result["valves"].values() for text in one["warnings"]),
    ):
        warn(warning)
    replaying.print_replay(result, Console())
    if report is not None:
        print(f"{report}: pictures and tables")


COMMAND = Command(replay, place=115, line="estimator and monitor over a recorded bag")
