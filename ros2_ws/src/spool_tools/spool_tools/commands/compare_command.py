"""`./spool compare`: models side by side on records."""

from __future__ import annotations

import typer
from spool_report.outputs import ResultFiles
from spool_report.requests import CompareRequest, Part

from spool_tools import command as cli


def compare(
    request: CompareRequest,
    part: Part,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    out: cli.OutFolder = None,
    _force: cli.Force = False,
) -> None:
    """Fit several models to records and report which one the data prefer; exit 1 without a result.

    Each record is a separate series, as in the paper; the ranking covers all of them.

    Example: ./spool compare bags/practice_03 --valve 4weh10_soft --report compare.html

    Example: ./spool compare soft.csv stiff.csv --valve soft.yaml --valve stiff.yaml --models fluid,coulomb
    """
    cli.refuse_missing(*request.records)
    from spool_report.runs.fit_run import run_compare  # noqa: PLC0415 - slow to load, as below

    raise typer.Exit(run_compare(request, part.selection(), ResultFiles(json, report, None, out)))


COMMAND = cli.Command(compare, place=125, line="models side by side on records")
