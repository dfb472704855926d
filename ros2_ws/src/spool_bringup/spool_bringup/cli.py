"""The command line: parsing and one line of help for each command; the work is done elsewhere."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from spool_stream.errors import InputError
from typer.exceptions import TyperException

from . import commands
from .alarm_cli import app as alarm_app
from .replaying import RefitRequest

app = typer.Typer(
    name="spool",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Watch hydraulic spool valves: simulate, estimate, monitor, record and replay.\n\n"
    "Example: [bold]./spool demo --seconds 60 --out demo_output[/bold]",
)

JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the result as JSON, SI units.")]
ValveFile = Annotated[str, typer.Option("--valve", help="YAML file of the valve, or a shipped one's name.")]
BagArgument = Annotated[Path, typer.Argument(help="rosbag2 directory or .mcap file.", metavar="BAG")]


@app.command()
def demo(
    seconds: Annotated[float, typer.Option(help="Length of the run, s; at least 30.")] = 60.0,
    out: Annotated[Path, typer.Option(help="Folder for bag, analysis and report.")] = Path("spool_demo"),
) -> None:
    """Run the main job live: two valves simulated, estimated, monitored and recorded by ROS 2 nodes.

    Example: ./spool demo --seconds 60 --out my_demo
    """
    from .demo import run_demo  # noqa: PLC0415 - rclpy is needed here only

    raise typer.Exit(run_demo(seconds, out))


@app.command(
    context_settings={
        "allow_extra_args": True,
        "ignore_unknown_options": True,
        "allow_interspersed_args": False,  # what follows the node's name is the node's
    }
)
def run(
    context: typer.Context,
    package: Annotated[str, typer.Argument(metavar="PACKAGE", help="e.g. spool_sim")],
    executable: Annotated[str, typer.Argument(metavar="EXECUTABLE", help="e.g. simulator")],
) -> None:
    """Start a node as `ros2 run` does; what follows is passed on.

    Example: ./spool run spool_sim simulator --ros-args -r __ns:=/valve_1 -p excitation:=sweep
    """
    from .processes import replace_by_node  # noqa: PLC0415

    replace_by_node(package, executable, context.args)


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(help="Bag to be made.", metavar="BAG")],
    valve: ValveFile = "4weh10_soft",
    model: Annotated[str, typer.Option(help="Model: its name or a YAML file.")] = "coulomb",
    excitation: Annotated[
        str, typer.Option(help="Body acceleration: a preset, a YAML file, or a record (bag or CSV file).")
    ] = "sweep",
    seconds: Annotated[
        float | None, typer.Option(help="Length, s; default: the recorded excitation's, else 40.")
    ] = None,
    sample_rate: Annotated[float, typer.Option(help="Hz")] = 2000.0,
    block_rate: Annotated[float, typer.Option(help="Blocks a second.")] = 50.0,
    coulomb_force: Annotated[float | None, typer.Option(help="N; default: the model's.")] = None,
    noise: Annotated[float, typer.Option(help="Sensor noise, rms, m/s^2.")] = 0.05,
    sensors: Annotated[Path | None, typer.Option(help="YAML file of the sensors, replaces --noise.")] = None,
    oil_temperature: Annotated[
        str | None,
        typer.Option(
            help="deg C, or 20:60 for oil that warms; default: the valve file's. Sets the viscosity."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the noise.")] = 0,
    name: Annotated[str, typer.Option(help="Namespace of the valve in the bag.")] = "valve_1",
) -> None:
    """Write a bag from the simulator, faster than real time and without DDS.

    Example: ./spool simulate --valve 4weh10_soft --excitation sweep --seconds 40 --out sweep_bag
    """
    commands.simulate(
        out, valve, model, excitation, seconds,
        sample_rate=sample_rate, block_rate=block_rate, coulomb_force=coulomb_force, noise=noise,
        sensors=sensors, oil_temperature=oil_temperature, seed=seed, name=name,
    )  # fmt: skip


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV file, may be gzipped.")],
    out: Annotated[Path, typer.Option(help="Bag to be made.", metavar="BAG")],
    name: Annotated[str, typer.Option(help="Namespace of the valve in the bag.")] = "valve_1",
    columns: Annotated[
        str | None, typer.Option(help="Names in the file, e.g. time_s=t,body_m_s2=ch1,spool_m_s2=ch2")
    ] = None,
    start: Annotated[str, typer.Option(help="Time of time_s = 0, ISO 8601, UTC.")] = "2025-01-01T00:00:00",
) -> None:
    """Turn a data logger's CSV file into a bag.

    Example: ./spool import record.csv.gz --out record_bag
    """
    commands.import_record(file, out, name, columns, start)


@app.command("export")
def export(
    bag: BagArgument,
    out: Annotated[Path, typer.Option(help="FILE.parquet, FILE.csv or FILE.csv.gz", metavar="FILE")],
    valve: Annotated[list[str] | None, typer.Option(help="Valve in the bag; default: all.")] = None,
) -> None:
    """Write a bag's samples as a table.

    Example: ./spool export record_bag --out record.parquet
    """
    commands.export(bag, out, valve)


@app.command()
def info(bag: BagArgument, json: JsonFile = None) -> None:
    """Say what is in a bag and what was lost on the way into it; exit 1 where something was.

    Example: ./spool info record_bag
    """
    raise typer.Exit(commands.info(bag, json))


@app.command()
def recover(
    bag: BagArgument, out: Annotated[Path, typer.Option(help="Bag to be made.", metavar="BAG")]
) -> None:
    """Make a damaged bag readable and count what was saved; exit 1 where something was lost.

    Example: ./spool recover killed_bag --out saved_bag
    """
    raise typer.Exit(commands.recover_bag(bag, out))


@app.command()
def replay(
    bag: BagArgument,
    valve: Annotated[
        list[str] | None,
        typer.Option(
            "--valve", help="YAML file of a valve; once for all, or once for each in order of name."
        ),
    ] = None,
    json: JsonFile = None,
    method: Annotated[str, typer.Option(help="Estimator: prediction, or equation.")] = "prediction",
    refits: Annotated[bool, typer.Option("--refits", help="Refit the last 4 s again and again.")] = False,
    refit_model: Annotated[str, typer.Option(help="Model of the refits: name or YAML file.")] = "coulomb",
    refit_period: Annotated[float, typer.Option(help="Data time between refits, s.")] = 5.0,
) -> None:
    """Run estimator and monitor over a bag, as fast as the machine can.

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --json result.json
    """
    request = RefitRequest(refit_model, refit_period) if refits else None
    commands.replay(bag, valve or [], json, request, method)


RecordsArgument = Annotated[
    list[Path], typer.Argument(help="Bags or CSV files of one valve.", metavar="RECORD...")
]
ReportFile = Annotated[
    Path | None, typer.Option("--report", help="Write pictures and tables as one HTML page.", metavar="HTML")
]
OutFolder = Annotated[
    Path | None, typer.Option("--out", help="Folder for all of these files.", metavar="DIR")
]
FittedValve = Annotated[
    str | None,
    typer.Option("--valve", help="YAML file of the valve, or a shipped one's name; default: the bag's own."),
]
NameOption = Annotated[
    str | None, typer.Option("--name", help="Which valve of a bag that holds several, e.g. valve_2.")
]
ColumnsOption = Annotated[
    str | None, typer.Option(help="Names in a CSV file, e.g. time_s=t,body_m_s2=ch1,spool_m_s2=ch2")
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


@app.command()
def fit(
    records: RecordsArgument,
    valve: FittedValve = None,
    model: Annotated[str, typer.Option(help="Model: its name or a YAML file.")] = "coulomb",
    json: JsonFile = None,
    report: ReportFile = None,
    save_model: Annotated[
        Path | None,
        typer.Option(help="Write the fitted model as YAML, for simulate and the nodes.", metavar="YAML"),
    ] = None,
    out: OutFolder = None,
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
    from .fitting import Outputs, run_fit  # noqa: PLC0415 - scipy is needed here only
    from .records import selection  # noqa: PLC0415

    code = run_fit(
        records, valve, model, selection(name, columns, start, stop), Outputs(json, report, save_model, out),
        held_out=holdout or (), free=free or (), fixed=fix or (), sensor_gain=sensor_gain,
        sensor_delay=sensor_delay,
    )  # fmt: skip
    raise typer.Exit(code)


@app.command()
def compare(
    records: RecordsArgument,
    valve: Annotated[
        list[str] | None,
        typer.Option("--valve", help="As of fit; once for all records, or once for each."),
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
    from .comparing import run_compare  # noqa: PLC0415 - scipy is needed here only
    from .fitting import Outputs  # noqa: PLC0415
    from .records import selection  # noqa: PLC0415

    code = run_compare(
        records, valve or (), models.split(",") if models else (), selection(name, columns, start, stop),
        Outputs(json, report, None, out), held_out=holdout or (), together=together,
        sensor_gain=sensor_gain, sensor_delay=sensor_delay,
    )  # fmt: skip
    raise typer.Exit(code)


@app.command()
def gap(
    records: RecordsArgument,
    valve: FittedValve = None,
    base: Annotated[
        str, typer.Option(help="Model that something may be missing from: name or YAML file.")
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
    save_model: Annotated[
        Path | None,
        typer.Option(help="Write the model found as YAML, for simulate and the nodes.", metavar="YAML"),
    ] = None,
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
    from .gapping import GapOutputs, run_gap  # noqa: PLC0415 - scipy is needed here only
    from .records import selection  # noqa: PLC0415

    code = run_gap(
        records, valve, base, kind, selection(name, columns, start, stop),
        GapOutputs(json, save_model, report), holdout=holdout or (),
        gain_tolerance=gain_tolerance, delay_tolerance=delay_tolerance,
    )  # fmt: skip
    raise typer.Exit(code)


@app.command()
def paper(
    out: Annotated[Path, typer.Option(help="Folder for page, pictures and tables.")] = Path("spool_paper"),
) -> None:
    """Run the paper's four series and four models; write figures and tables beside the printed numbers.

    The authors' measurements are not published: the data are made by a stated truth.

    Example: ./spool paper --out my_paper
    """
    from .paper import run_paper  # noqa: PLC0415 - scipy and matplotlib are needed here only

    run_paper(out)


@app.command()
def study(
    what: Annotated[
        str,
        typer.Argument(
            help="gap: effects named right? gap-limit: how small? estimation: do intervals hold? "
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
    from .study import run_study  # noqa: PLC0415

    run_study(what, cases, seed, out, workers)


@app.command()
def trend(
    valve: Annotated[str, typer.Argument(metavar="VALVE", help="Namespace of the valve, e.g. valve_1.")],
    state_folder: Annotated[
        Path | None, typer.Option(help="The monitors' state_folder; default: where they keep it by default.")
    ] = None,
    parameter: Annotated[
        list[str] | None, typer.Option(help="Once for each, e.g. coulomb_force; default: all.")
    ] = None,
    since: Annotated[
        str | None, typer.Option(help="How long ago, e.g. 6h, 7d, or a time (UTC); default: all.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Picture FILE.png or page FILE.html.")] = None,
    json: JsonFile = None,
) -> None:
    """Show what the monitor kept of a valve: minimum, mean, maximum per minute, hour or day, and counters.

    Example: ./spool trend valve_1 --since 7d --out valve_1.html
    """
    from .trend import show_trend  # noqa: PLC0415 - matplotlib is needed here only

    show_trend(valve, state_folder, parameter or [], since, out, json)


app.add_typer(alarm_app, name="alarm")


@app.command()
def bench(
    what: Annotated[str | None, typer.Argument(help="Which one; default: all there are.")] = None,
    json: JsonFile = None,
) -> None:
    """Time the suite beside its peers, on the same work in one run.

    Example: ./spool bench bag --json bench.json
    """
    from .bench import run_bench  # noqa: PLC0415

    run_bench(what, json)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code: 0 done, 1 found a problem, 2 bad input or usage."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        result = app(arguments, prog_name="spool", standalone_mode=False)
    except InputError as error:
        return _fail(str(error))
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except typer.Exit as stop:
        return stop.exit_code
    except typer.Abort:
        return _fail("interrupted", 130)
    except TyperException as error:
        command = next((word for word in arguments if not word.startswith("-")), "")
        text = error.format_message()
        if not text:  # no arguments: the help has been shown
            return 2
        return _fail(f"{text} See: ./spool {command} --help".replace("  ", " "))
    return result if isinstance(result, int) else 0


def _fail(text: str, code: int = 2) -> int:
    print("spool: " + " ".join(text.split()), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
