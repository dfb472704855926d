"""`./spool fit`: one model's parameters from records of one valve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError
from spool_report.outputs import ResultFiles

from spool_tools import command as cli
from spool_tools.command import Command


def fit(
    records: Annotated[
        list[Path] | None, typer.Argument(help="Bags or logger files of one valve.", metavar="RECORD...")
    ] = None,
    valve: cli.FittedValve = None,
    model: cli.ModelName = "coulomb",
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    save_model: cli.ModelFile = None,
    out: cli.OutFolder = None,
    _force: cli.Force = False,
    free: Annotated[
        list[str] | None,
        typer.Option(help="Parameter to fit although the valve file states it; =VALUE is its start value."),
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(help="Parameter to hold, at VALUE (PARAMETER=VALUE) or at the valve file's value."),
    ] = None,
    force_free: Annotated[
        bool,
        typer.Option(
            "--force-free",
            rich_help_panel=cli.EXPERT,
            help="Do not hold parameters that the records do not determine.",
        ),
    ] = False,
    sensor_gain: cli.SensorGain = False,
    sensor_delay: cli.SensorDelay = False,
    setups: Annotated[
        Path | None,
        typer.Option(help="YAML file of several set-ups of the valve, instead of RECORD.", metavar="FILE"),
    ] = None,
    holdout: cli.HoldoutOption = None,
    *,
    part: cli.Part,
) -> None:
    """Fit a model to records: parameters with standard deviations, objective, amplitude ratio.

    Several records are one set of data. The first lines report which parameters these records determine; the
    others keep the values of the valve file and the model. --setups fits records of several set-ups (springs,
    oil, added mass) together, with shared parameters. Exit 1 without a result.

    Example: ./spool fit bags/practice_03 --valve 4weh10_soft --model coulomb --report fit.html

    Example: ./spool fit record.csv --valve my_valve.yaml --model stribeck --fix coulomb_force=0.3

    Example: ./spool fit --setups setups.yaml --valve my_valve.yaml --model fluid
    """
    if setups is None and not records:
        raise InputError("fit: name a record, or a file of set-ups with --setups")
    if setups is not None and (records or holdout):
        raise InputError("--setups: its file names the records: leave RECORD and --holdout out")
    cli.refuse_missing(*(records or ()))
    files = ResultFiles(json, report, save_model, out)
    if setups is not None:
        from spool_report.runs.setups_run import SetUpsRequest, run_setups, setups_file  # noqa: PLC0415

        together = SetUpsRequest(
            setups_file(setups), str(setups), setups.parent, valve, model, part.selection(), free or (),
            fix or (), sensor_gain=sensor_gain, sensor_delay=sensor_delay, force_free=force_free,
        )  # fmt: skip
        raise typer.Exit(run_setups(together, files))
    from spool_report.runs.fit_run import FitRequest, run_fit  # noqa: PLC0415

    request = FitRequest(
        records or (), valve, model, part.selection(), holdout or (), free or (), fix or (),
        sensor_gain=sensor_gain, sensor_delay=sensor_delay, force_free=force_free,
    )  # fmt: skip
    raise typer.Exit(run_fit(request, files))


COMMAND = Command(fit, place=120, line="one model's parameters from records")
