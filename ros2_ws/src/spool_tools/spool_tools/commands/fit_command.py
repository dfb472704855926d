"""`./spool fit`: one model's parameters from records of one valve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_core.discovery import from_add_on
from spool_core.errors import InputError
from spool_report.outputs import ResultFiles
from spool_report.requests import FitRequest, Part

from spool_tools import command as cli


def fit(
    request: FitRequest,
    part: Part,
    setups: Annotated[
        Path | None,
        typer.Option(help="YAML file of several set-ups of the valve, instead of RECORD.", metavar="FILE"),
    ] = None,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    save_model: cli.ModelFile = None,
    out: cli.OutFolder = None,
    _force: cli.Force = False,
) -> None:
    """Fit a model to records: parameters with standard deviations, objective, amplitude ratio.

    Several records are one set of data. The first lines report which parameters these records determine; the
    others keep the values of the valve file and the model. --setups fits records of several set-ups (springs,
    oil, added mass) together, with shared parameters. Exit 1 without a result.

    Example: ./spool fit bags/practice_03 --valve 4weh10_soft --model coulomb --report fit.html

    Example: ./spool fit record.csv --valve my_valve.yaml --model stribeck --fix coulomb_force=0.3

    Example: ./spool fit --setups setups.yaml --valve my_valve.yaml --model fluid
    """
    if setups is None and not request.records:
        raise InputError("fit: name a record, or a file of set-ups with --setups")
    if setups is not None and (request.records or request.holdout):
        raise InputError("--setups: its file names the records: leave RECORD and --holdout out")
    cli.refuse_missing(*request.records)
    files = ResultFiles(json, report, save_model, out)
    if setups is not None:
        run_setups = from_add_on("spool_design", "setups")
        raise typer.Exit(run_setups(setups, request, part.selection(), files))
    from spool_report.runs.fit_run import run_fit  # noqa: PLC0415

    raise typer.Exit(run_fit(request, part.selection(), files))


COMMAND = cli.Command(fit, place=120, line="one model's parameters from records")
