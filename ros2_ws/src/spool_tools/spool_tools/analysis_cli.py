"""Parsing and help of the commands that look for models: fit, compare, gap, paper, study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spool_tools.console.cli_options import ColumnsOption, Force, JsonFile, ModelFile, ModelName, ReportFile
from spool_tools.console.completion import model_names, valve_names
from spool_tools.console.outputs import check_folder

RecordsArgument = Annotated[
    list[Path], typer.Argument(help="Bags or CSV files of one valve.", metavar="RECORD...")
]
OutFolder = Annotated[
    Path | None, typer.Option("--out", help="Folder for all of these files.", metavar="DIR")
]
FittedValve = Annotated[
    str | None,
    typer.Option(
        "--valve", help="YAML file of the valve, or a shipped one's name; default: the bag's own.",
        autocompletion=valve_names,
    ),
]  # fmt: skip
NameOption = Annotated[
    str | None, typer.Option("--name", help="Which valve of a bag that holds several, e.g. valve_2.")
]
StartOption = Annotated[float, typer.Option(help="Use the record from here on, s since its first sample.")]
StopOption = Annotated[float | None, typer.Option(help="Use the record up to here, s; default: its end.")]
HoldoutOption = Annotated[
    list[Path] | None,
    typer.Option(
        help="Record to judge the error by; default: a quarter of each record is held out.", metavar="RECORD"
    ),
]
SensorGain = Annotated[
    bool, typer.Option("--sensor-gain", help="Fit the gain error of the spool's sensor as well.")
]
SensorDelay = Annotated[
    bool, typer.Option("--sensor-delay", help="Fit the delay of the spool's sensor as well.")
]


def fit(
    records: RecordsArgument,
    valve: FittedValve = None,
    model: ModelName = "coulomb",
    json: JsonFile = None,
    report: ReportFile = None,
    save_model: ModelFile = None,
    out: OutFolder = None,
    _force: Force = False,
    free: Annotated[
        list[str] | None, typer.Option(help="Fit it though the valve file gives it; =VALUE to start from.")
    ] = None,
    fix: Annotated[
        list[str] | None, typer.Option(help="Hold it: PARAMETER=VALUE, or as the valve file has it.")
    ] = None,
    sensor_gain: SensorGain = False,
    sensor_delay: SensorDelay = False,
    holdout: HoldoutOption = None,
    name: NameOption = None,
    columns: ColumnsOption = None,
    start: StartOption = 0.0,
    stop: StopOption = None,
) -> None:
    """Fit a model to records: parameters with standard deviations, objective, amplitude ratio.

    Several records are one set of data. Exit 1 where there is no result.

    Example: ./spool fit bags/practice_03 --valve 4weh10_soft --model coulomb --report fit.html

    Example: ./spool fit record.csv --valve my_valve.yaml --model stribeck --fix coulomb_force=0.3
    """
    from spool_tools.commands.fit_command import Outputs, run_fit  # noqa: PLC0415 - scipy is needed here only
    from spool_tools.input.record_loading import selection  # noqa: PLC0415

    code = run_fit(
        records, valve, model, selection(name, columns, start, stop), Outputs(json, report, save_model, out),
        held_out=holdout or (), free=free or (), fixed=fix or (), sensor_gain=sensor_gain,
        sensor_delay=sensor_delay,
    )  # fmt: skip
    raise typer.Exit(code)


def compare(
    records: RecordsArgument,
    valve: Annotated[
        list[str] | None,
        typer.Option(
            "--valve", help="As of fit; once for all records, or once for each.", autocompletion=valve_names
        ),
    ] = None,
    models: Annotated[
        str | None,
        typer.Option(
            help="Names or YAML files with commas between; default: the paper's, coulomb, stribeck."
        ),
    ] = None,
    together: Annotated[
        bool, typer.Option("--together", help="All records are one set of data, not a series each.")
    ] = False,
    json: JsonFile = None,
    report: ReportFile = None,
    out: OutFolder = None,
    _force: Force = False,
    sensor_gain: SensorGain = False,
    sensor_delay: SensorDelay = False,
    holdout: HoldoutOption = None,
    name: NameOption = None,
    columns: ColumnsOption = None,
    start: StartOption = 0.0,
    stop: StopOption = None,
) -> None:
    """Fit several models to records and say which one the data prefer; exit 1 where none has a result.

    Each record is a series of its own, as in the paper; the ranking is over all of them.

    Example: ./spool compare bags/practice_03 --valve 4weh10_soft --report compare.html

    Example: ./spool compare soft.csv stiff.csv --valve soft.yaml --valve stiff.yaml --models fluid,coulomb
    """
    from spool_tools.commands.compare_command import run_compare  # noqa: PLC0415 - scipy is needed here only
    from spool_tools.commands.fit_command import Outputs  # noqa: PLC0415
    from spool_tools.input.record_loading import selection  # noqa: PLC0415

    code = run_compare(
        records, valve or (), models.split(",") if models else (), selection(name, columns, start, stop),
        Outputs(json, report, None, out), held_out=holdout or (), together=together,
        sensor_gain=sensor_gain, sensor_delay=sensor_delay,
    )  # fmt: skip
    raise typer.Exit(code)


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
        str,
        typer.Option(help="accelerations; driven: a force moves the mass; imposed: it is the reaction."),
    ] = "accelerations",
    json: JsonFile = None,
    report: ReportFile = None,
    save_model: ModelFile = None,
    _force: Force = False,
    gain_tolerance: Annotated[
        float, typer.Option(help="Relative gain error of the spool's sensor that its data sheet allows.")
    ] = 0.05,
    delay_tolerance: Annotated[
        float, typer.Option(help="Delay between the channels that is allowed, s.")
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
    from spool_tools.commands.gap_command import GapOutputs, run_gap  # noqa: PLC0415 - scipy is needed here only
    from spool_tools.input.record_loading import selection  # noqa: PLC0415

    code = run_gap(
        records, valve, base, kind, selection(name, columns, start, stop),
        GapOutputs(json, save_model, report), holdout=holdout or (),
        gain_tolerance=gain_tolerance, delay_tolerance=delay_tolerance,
    )  # fmt: skip
    raise typer.Exit(code)


def paper(
    out: Annotated[Path, typer.Option(help="Folder for page, pictures and tables.")] = Path("spool_paper"),
    _force: Force = False,
) -> None:
    """Run the paper's four series and four models; write figures and tables beside the printed numbers.

    The authors' measurements are not published: the data are made by a stated truth.

    Example: ./spool paper --out my_paper
    """
    from spool_evaluation.paper.command import run_paper  # noqa: PLC0415 - scipy and matplotlib are needed here only

    run_paper(check_folder(out))


def study(
    what: Annotated[
        str,
        typer.Argument(
            help="gap: effects named right? gap-limit: how small? estimation: do intervals hold? "
            "records: is the truth of bags/ found? steps: what does a time step cost? "
            "monitor: events found in time? monitor-hours: quiet over healthy hours?"
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for tables and pictures.")],
    cases: Annotated[int, typer.Option(help="How many.")] = 200,
    seed: Annotated[int, typer.Option(help="Of the first; below 1000 is for development.")] = 1000,
    workers: Annotated[int | None, typer.Option(help="Processes; default: as many as cores.")] = None,
) -> None:
    """Count over many blind records how often the suite is right.

    Example: ./spool study gap --cases 200 --seed 1000 --out study_gap
    """
    from spool_evaluation.study import run_study  # noqa: PLC0415

    run_study(what, cases, seed, out, workers)
