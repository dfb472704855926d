"""`./spool compare`: models side by side on records."""

from __future__ import annotations

from typing import Annotated

import typer
from spool_report.outputs import ResultFiles

from spool_tools import command as cli
from spool_tools.command import Command, valve_names


def compare(
    records: cli.RecordsArgument,
    valve: Annotated[
        list[str] | None,
        typer.Option(
            "--valve",
            help="Valve file, as for fit; one for all records, or one per record.",
            autocompletion=valve_names,
        ),
    ] = None,
    models: Annotated[
        str | None,
        typer.Option(
            help="Names or YAML files, separated by commas; default: the paper's models, coulomb, stribeck."
        ),
    ] = None,
    together: Annotated[
        bool, typer.Option("--together", help="Treat all records as one set of data.")
    ] = False,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    out: cli.OutFolder = None,
    _force: cli.Force = False,
    sensor_gain: cli.SensorGain = False,
    sensor_delay: cli.SensorDelay = False,
    holdout: cli.HoldoutOption = None,
    *,
    part: cli.Part,
) -> None:
    """Fit several models to records and report which one the data prefer; exit 1 without a result.

    Each record is a separate series, as in the paper; the ranking covers all of them.

    Example: ./spool compare bags/practice_03 --valve 4weh10_soft --report compare.html

    Example: ./spool compare soft.csv stiff.csv --valve soft.yaml --valve stiff.yaml --models fluid,coulomb
    """
    cli.refuse_missing(*records)
    from spool_report.runs.fit_run import CompareRequest, run_compare  # noqa: PLC0415 - slow to load, as below

    chosen = models.split(",") if models else ()
    request = CompareRequest(
        records, valve or (), chosen, part.selection(), holdout or (),
        together=together, sensor_gain=sensor_gain, sensor_delay=sensor_delay,
    )  # fmt: skip
    raise typer.Exit(run_compare(request, ResultFiles(json, report, None, out)))


COMMAND = Command(compare, place=125, line="models side by side on records")
