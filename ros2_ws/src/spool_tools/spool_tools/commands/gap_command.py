"""`./spool gap`: what a model lacks, named, added and measured again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from spool_core.errors import InputError
from spool_report.outputs import ResultFiles

from spool_tools import command as cli
from spool_tools.command import Command, model_names


def gap(
    records: cli.RecordsArgument,
    valve: cli.FittedValve = None,
    base: Annotated[
        str,
        typer.Option(
            help="Base model that the command extends: name or YAML file.", autocompletion=model_names
        ),
    ] = "fluid",
    holdout: Annotated[
        list[Path] | None,
        typer.Option(
            help="Held-out record for validation; default: every other section is held out.", metavar="RECORD"
        ),
    ] = None,
    kind: Annotated[
        Literal["accelerations", "driven", "imposed"],
        typer.Option(
            help="accelerations, driven (a force moves the mass) or imposed (the force is the reaction)."
        ),
    ] = "accelerations",
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    save_model: cli.ModelFile = None,
    _force: cli.Force = False,
    gain_tolerance: Annotated[
        float,
        typer.Option(
            rich_help_panel=cli.EXPERT,
            help="Relative gain tolerance of the spool's sensor, from its data sheet.",
            callback=cli.in_range(0.0, 0.4),
        ),
    ] = 0.05,
    delay_tolerance: Annotated[
        float,
        typer.Option(
            rich_help_panel=cli.EXPERT,
            help="Permitted delay between the channels, s.",
            callback=cli.in_range(0.0, 4e-3),
        ),
    ] = 0.5e-3,
    mass: Annotated[
        float | None,
        typer.Option(help="Moving mass of a driven record, kg; default: mass of the valve, else fitted."),
    ] = None,
    least_share: Annotated[
        float,
        typer.Option(
            rich_help_panel=cli.EXPERT,
            help="Smallest effect to name, as a share of the spool's rms acceleration.",
            callback=cli.in_range(0.0, 0.5),
        ),
    ] = 0.0025,
    thorough: Annotated[
        bool,
        typer.Option(
            rich_help_panel=cli.EXPERT, help="Complete the search; default: stop after about a minute."
        ),
    ] = False,
    profiles: Annotated[
        bool,
        typer.Option(
            "--profiles",
            rich_help_panel=cli.EXPERT,
            help="Report for each named parameter whether the record determines it.",
        ),
    ] = False,
    *,
    part: cli.Part,
) -> None:
    """Compare simulation and records, name the missing effects, add them, and measure the remaining gap.

    Several records form one data set. The command measures every error on held-out data.

    Example: ./spool gap bags/practice_03 --valve 4weh10_soft --report gap.html --save-model found.yaml

    Example: ./spool gap rig.csv --kind imposed --holdout other.csv

    Example: ./spool gap rig.csv --kind imposed --unit time=ms,displacement=mm,force=N
    """
    cli.refuse_missing(*records)
    if mass is not None and (kind != "driven" or not mass > 0.0):
        raise InputError(f"--mass {mass:g}: a mass > 0 kg, with --kind driven")
    from spool_gap.result import GapSettings  # noqa: PLC0415 - slow to load, as below
    from spool_report.runs.gap_run import GapRequest, run_gap  # noqa: PLC0415

    settings = GapSettings(
        gain_tolerance, delay_tolerance, least_share=least_share, thorough=thorough, profiles=profiles
    )
    request = GapRequest(records, valve, base, kind, part.selection(), settings, holdout or (), mass)
    raise typer.Exit(run_gap(request, ResultFiles(json, report, save_model)))


COMMAND = Command(gap, place=130, line="missing effects of the model: named, added and measured again")
