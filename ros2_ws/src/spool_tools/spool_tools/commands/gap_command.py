"""`./spool gap`: what a model lacks, named, added and measured again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from spool_tools.console.cli_options import (
    ColumnsOption,
    FittedValve,
    Force,
    JsonFile,
    ModelFile,
    NameOption,
    RecordsArgument,
    ReportFile,
    StartOption,
    StopOption,
    in_range,
)
from spool_tools.console.command import Command
from spool_tools.console.completion import model_names
from spool_tools.console.result_files import ResultFiles


def gap(
    records: RecordsArgument,
    valve: FittedValve = None,
    base: Annotated[
        str,
        typer.Option(
            help="Model that something may be missing from: name or YAML file.", autocompletion=model_names
        ),
    ] = "fluid",
    holdout: Annotated[
        list[Path] | None,
        typer.Option(help="Record to judge by; default: every other stretch is held out.", metavar="RECORD"),
    ] = None,
    kind: Annotated[
        Literal["accelerations", "driven", "imposed"],
        typer.Option(help="accelerations; driven: a force moves the mass; imposed: it is the reaction."),
    ] = "accelerations",
    json: JsonFile = None,
    report: ReportFile = None,
    save_model: ModelFile = None,
    _force: Force = False,
    gain_tolerance: Annotated[
        float,
        typer.Option(
            help="Relative gain error of the spool's sensor that its data sheet allows.",
            callback=in_range(0.0, 0.4),
        ),
    ] = 0.05,
    delay_tolerance: Annotated[
        float,
        typer.Option(help="Delay between the channels that is allowed, s.", callback=in_range(0.0, 4e-3)),
    ] = 0.5e-3,
    name: NameOption = None,
    columns: ColumnsOption = None,
    start: StartOption = 0.0,
    stop: StopOption = None,
) -> None:
    """Find where simulation and records disagree, name what is missing, add it, show the gap shrink.

    Several records are one set of data. Every error is measured on data that no fit has seen.

    Example: ./spool gap bags/practice_03 --valve 4weh10_soft --report gap.html --save-model found.yaml

    Example: ./spool gap rig.csv --kind imposed --holdout other.csv
    """
    from spool_tools.input.record_loading import selection  # noqa: PLC0415
    from spool_tools.operations.gap_run import run_gap  # noqa: PLC0415 - slow to load, as below

    code = run_gap(
        records, valve, base, kind, selection(name, columns, start, stop),
        ResultFiles(json, report, save_model), holdout=holdout or (),
        gain_tolerance=gain_tolerance, delay_tolerance=delay_tolerance,
    )  # fmt: skip
    raise typer.Exit(code)


COMMAND = Command(gap, place=110, line="what the model lacks: named, added and measured again")
