"""`./spool import`: any logger's file, or a bag of other topics, as a bag of a valve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError
from spool_core.text import plural
from spool_report.outputs import making_room
from spool_report.requests import ImportRequest, option
from spool_report.terminal import warn

from spool_tools import command as cli


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Logger files or a foreign bag; two files if their clocks differ."
        ),
    ],
    *,
    out: Annotated[Path | None, option("Bag to be made.", "--out", metavar="BAG")] = None,
    look: Annotated[bool, option("Show channels and quality; write no bag.", "--look")] = False,
    request: ImportRequest,
    name: Annotated[str, option("Namespace of the valve in the bag.")] = "valve_1",
    start: Annotated[
        str | None,
        option("Time of the record's 0 s, ISO 8601, UTC; default: time in the file, else 2025-01-01."),
    ] = None,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    _force: cli.Force = False,
) -> None:
    """Convert a logger's file, or a bag of other topics, to a bag of this suite.

    Reads CSV of any dialect, oscilloscopes' CSV, LabVIEW LVM, Excel, Parquet, Feather, MATLAB, HDF5, NumPy,
    WAV, TDMS, MF4, UFF 58, and bags of ROS 1 and ROS 2. The columns used, each conversion and what the file
    states beside them are printed. Ambiguous input is refused with the option to type; options may be
    repeated. Use --json and --report with --look.

    Example: ./spool import logger.csv --look
    Example: ./spool import logger.csv --unit body=g,spool=g --out record_bag
    Example: ./spool import logger.csv --columns body=#3,spool=#5 --exclude '#4' --out record_bag
    Example: ./spool import body.wav spool.tdms --scale body=50g/FS --out record_bag
    """
    from spool_bag.importing.bag_import import import_record  # noqa: PLC0415 - slow to load, as below
    from spool_report.records.record_sources import iso_time  # noqa: PLC0415
    from spool_report.terminal import progress  # noqa: PLC0415

    how = request.choices()
    if len(files) > 2:
        raise InputError(f"{files[2]}: two files at most, body and spool; import each record separately")
    if look:
        from spool_report.runs.record_quality import look as looked  # noqa: PLC0415

        with progress("reading"):
            fine = looked(files, how, json, report)
        raise typer.Exit(0 if fine else 1)
    if out is None or out == Path():
        raise InputError("--out: name the bag to write, or pass --look to see the detected channels")
    if json is not None or report is not None:
        raise InputError("--json and --report contain the result of --look: add --look")
    moment = None
    if start is not None:
        try:
            moment = round(iso_time(start).timestamp()) * 1_000_000_000
        except (ValueError, OverflowError) as error:
            raise InputError(f"--start {start!r}: write it like 2025-01-31T12:00:00") from error
    with making_room(out), progress("importing"):
        result = import_record(files, out, valve=name, how=how, start=moment)
    for warning in result.warnings:
        warn(warning)
    for note in result.notes:
        print(note)
    lost = f", {plural(result.lost_blocks, 'block')} lost in gaps" if result.lost_blocks else ""
    print(
        f"{out}: {plural(result.samples, 'sample')} in {plural(result.blocks, 'block')} of /{name}, "
        f"{result.duration:.1f} s at {1.0 / result.period:.7g} Hz{lost}"
    )


COMMAND = cli.Command(import_, place=100, line="any logger's file, or a foreign bag, to a bag of a valve")
