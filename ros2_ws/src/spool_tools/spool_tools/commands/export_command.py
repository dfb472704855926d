"""`./spool export`: a bag's samples as a table, a valve as an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_core.discovery import from_add_on
from spool_core.errors import InputError
from spool_core.text import printable
from spool_report.outputs import making_room
from spool_report.requests import TimeSpan, model_names, option
from spool_report.terminal import progress, warn

from spool_tools import command as cli


def export(
    source: Annotated[
        str,
        typer.Argument(
            help="rosbag2 directory or .mcap file; with --fmu a valve or a model (YAML file).",
            metavar="BAG|VALVE|MODEL",
        ),
    ],
    out: Annotated[
        Path | None, option("Table of a bag: FILE.parquet, FILE.csv or FILE.csv.gz", metavar="FILE")
    ] = None,
    name: Annotated[
        list[str] | None, option("Namespace of a valve in the bag; default: all.", "--name", "--valve")
    ] = None,
    fmu: cli.FmuFile = None,
    model: Annotated[
        str | None,
        option(
            "Model of a valve's FMU: name or YAML file; default: coulomb.",
            "--model",
            autocompletion=model_names,
        ),
    ] = None,
    fmi: Annotated[int | None, option("Version of FMI, 2 or 3 (default).")] = None,
    _force: cli.Force = False,
    *,
    when: TimeSpan,
) -> None:
    """Write a bag's samples as a table, or a valve as an FMU for other simulators.

    Example: ./spool export record_bag --out record.parquet

    Example: ./spool export 4weh10_soft --model coulomb --fmu valve.fmu
    """
    if (out is None) == (fmu is None):
        raise InputError(
            "export: pass --out FILE for a bag's samples, or --fmu FILE.fmu for a valve or a model"
        )
    if fmu is not None:
        if name or when != TimeSpan():
            raise InputError(
                "--fmu: a valve or a model has no --name, --since, --until, --around: leave them out"
            )
        print(from_add_on("spool_design", "fmu")(source, fmu, model, 3 if fmi is None else fmi))
        return
    assert out is not None
    if model is not None or fmi is not None:
        raise InputError("--model, --fmi: these go with --fmu FILE.fmu: add it, or leave them out")
    bag = Path(source)
    cli.refuse_missing(bag)
    from spool_bag.export import export_bag  # noqa: PLC0415 - slow to load
    from spool_report.records.record_sources import span_of  # noqa: PLC0415

    with making_room(out), progress("exporting") as advance:
        span = span_of(bag, when)
        result = export_bag(bag, out, valves=name, span=span, progress=advance)
    for warning in result.warnings:
        warn(warning)
    print(f"{out}: {result.rows} rows of {printable(', '.join(result.valves))}")


COMMAND = cli.Command(export, place=135, line="a bag to Parquet or CSV, a valve to an FMU")
