"""`./spool gap`: what a model lacks, named, added and measured again."""

from __future__ import annotations

import typer
from spool_report.outputs import ResultFiles
from spool_report.requests import GapRequest, Part

from spool_tools import command as cli


def gap(
    request: GapRequest,
    part: Part,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    save_model: cli.ModelFile = None,
    _force: cli.Force = False,
) -> None:
    """Compare simulation and records, name the missing effects, add them, and measure the remaining gap.

    Several records form one data set. The command measures every error on held-out data.

    Example: ./spool gap bags/practice_03 --valve 4weh10_soft --report gap.html --save-model found.yaml

    Example: ./spool gap rig.csv --kind imposed --holdout other.csv

    Example: ./spool gap rig.csv --kind imposed --unit time=ms,displacement=mm,force=N
    """
    cli.refuse_missing(*request.records)
    from spool_report.runs.gap_run import run_gap  # noqa: PLC0415 - slow to load, as below

    raise typer.Exit(run_gap(request, part.selection(), ResultFiles(json, report, save_model)))


COMMAND = cli.Command(gap, place=130, line="missing effects of the model: named, added and measured again")
