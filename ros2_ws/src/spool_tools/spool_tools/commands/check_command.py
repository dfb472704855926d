"""`./spool check`: the quality of a record."""

from __future__ import annotations

import typer
from spool_report.requests import Part, RecordArgument

from spool_tools import command as cli


def check(
    record: RecordArgument,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    _force: cli.Force = False,
    *,
    part: Part,
) -> None:
    """Report the quality of a record: rate, gaps, clipping, noise, coherence, resonance, doubts.

    Exit 1 if the record is not fit for an estimate.

    Example: ./spool check bags/practice_01 --report quality.html
    """
    cli.refuse_missing(record)
    from spool_report.runs.record_quality import check as checked  # noqa: PLC0415
    from spool_report.terminal import progress  # noqa: PLC0415 - slow to load, as below

    with progress("reading"):
        fine = checked(record, part.selection(), json, report)
    raise typer.Exit(0 if fine else 1)


COMMAND = cli.Command(
    check,
    place=105,
    line="the quality of a record: rate, gaps, clipping, noise, coherence, and how they affect an estimate",
)
