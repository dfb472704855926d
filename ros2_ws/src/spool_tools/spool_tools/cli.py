"""The command line: parsing and one line of help for each command; the work is done elsewhere."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from spool_stream.errors import InputError
from typer.exceptions import TyperException

from spool_tools.commands.replay_command import RefitRequest
from spool_tools.commands.valve_command import app as valve_app
from spool_tools.console.cli_options import (
    BagArgument,
    ColumnsOption,
    ExcitationName,
    Force,
    JsonFile,
    ModelName,
    RecordArgument,
    ValveFile,
)
from spool_tools.console.completion import model_names, valve_names
from spool_tools.console.outputs import one_command
from spool_tools.console.terminal import fail
from spool_tools.report.provenance import remember_command

from .alarm_cli import app as alarm_app
from .analysis_cli import compare, fit, gap, paper, study
from .commands import bag_commands

app = typer.Typer(
    name="spool",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Watch hydraulic spool valves: simulate, estimate, monitor, record and replay.\n\n"
    "Example: [bold]./spool demo --seconds 60 --out demo_output[/bold]",
)


def _version(wanted: bool) -> None:
    if wanted:
        from spool_tools.console.version import suite_version  # noqa: PLC0415

        print(f"spool {suite_version()}")
        raise typer.Exit


@app.callback()
def everywhere(
    version: Annotated[
        bool,
        typer.Option("--version", help="Say which version this is.", is_eager=True, callback=_version),
    ] = False,
) -> None:
    """Watch hydraulic spool valves: simulate, estimate, monitor, record and replay.

    Example: [bold]./spool demo --seconds 60 --out demo_output[/bold]
    """


@app.command()
def demo(
    seconds: Annotated[float, typer.Option(help="Length of the run, s; at least 40.")] = 60.0,
    out: Annotated[Path, typer.Option(help="Folder for bag, analysis and report.")] = Path("spool_demo"),
) -> None:
    """Run the main job live: two valves simulated, estimated, monitored and recorded by ROS 2 nodes.

    Example: ./spool demo --seconds 60 --out my_demo
    """
    from spool_tools.demo.demo import run_demo  # noqa: PLC0415 - rclpy is needed here only

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
    from spool_tools.demo.processes import replace_by_node  # noqa: PLC0415

    replace_by_node(package, executable, context.args)


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(help="Bag to be made.", metavar="BAG")],
    valve: ValveFile = "4weh10_soft",
    model: ModelName = "coulomb",
    excitation: ExcitationName = "sweep",
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
    _force: Force = False,
) -> None:
    """Write a bag from the simulator, faster than real time and without DDS.

    Example: ./spool simulate --valve 4weh10_soft --excitation sweep --seconds 40 --out sweep_bag
    """
    bag_commands.simulate(
        out, valve, model, excitation, seconds,
        sample_rate=sample_rate, block_rate=block_rate, coulomb_force=coulomb_force, noise=noise,
        sensors=sensors, oil_temperature=oil_temperature, seed=seed, name=name,
    )  # fmt: skip


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV file, may be gzipped.")],
    out: Annotated[Path, typer.Option(help="Bag to be made.", metavar="BAG")],
    name: Annotated[str, typer.Option(help="Namespace of the valve in the bag.")] = "valve_1",
    columns: ColumnsOption = None,
    start: Annotated[
        str | None,
        typer.Option(
            help="Time of time_s = 0, ISO 8601, UTC; default: 2025-01-01, "
            "or none where time_s counts from 1970."
        ),
    ] = None,
    _force: Force = False,
) -> None:
    """Turn a data logger's CSV file into a bag.

    Example: ./spool import record.csv.gz --out record_bag
    """
    bag_commands.import_record(file, out, name, columns, start)


@app.command("export")
def export(
    bag: BagArgument,
    out: Annotated[Path, typer.Option(help="FILE.parquet, FILE.csv or FILE.csv.gz", metavar="FILE")],
    name: Annotated[
        list[str] | None,
        typer.Option("--name", "--valve", help="Namespace of a valve in the bag; default: all."),
    ] = None,
    _force: Force = False,
) -> None:
    """Write a bag's samples as a table.

    Example: ./spool export record_bag --out record.parquet
    """
    bag_commands.export(bag, out, name)


@app.command()
def info(
    record: RecordArgument, columns: ColumnsOption = None, json: JsonFile = None, _force: Force = False
) -> None:
    """Say what is in a record and what was lost on the way into it; exit 1 where something was.

    Example: ./spool info record_bag
    """
    raise typer.Exit(bag_commands.info(record, json, columns))


@app.command()
def recover(
    bag: BagArgument,
    out: Annotated[Path, typer.Option(help="Bag to be made.", metavar="BAG")],
    _force: Force = False,
) -> None:
    """Make a damaged bag readable and count what was saved; exit 1 where something was lost.

    Example: ./spool recover killed_bag --out saved_bag
    """
    raise typer.Exit(bag_commands.recover_bag(bag, out))


@app.command()
def replay(
    record: RecordArgument,
    valve: Annotated[
        list[str] | None,
        typer.Option(
            "--valve",
            help="YAML file of the valve, or a shipped one's name; of several valves NAME=FILE for each. "
            "Default: what the bag says of its valves.",
            autocompletion=valve_names,
        ),
    ] = None,
    columns: ColumnsOption = None,
    json: JsonFile = None,
    _force: Force = False,
    method: Annotated[str, typer.Option(help="Estimator: prediction, or equation.")] = "prediction",
    refits: Annotated[bool, typer.Option("--refits", help="Refit the last 4 s again and again.")] = False,
    refit_model: Annotated[
        str, typer.Option(help="Model of the refits: name or YAML file.", autocompletion=model_names)
    ] = "coulomb",
    refit_period: Annotated[float, typer.Option(help="Data time between refits, s.")] = 5.0,
) -> None:
    """Run estimator and monitor over a record, as fast as the machine can.

    Example: ./spool replay bags/practice_03 --valve 4weh10_soft --json result.json
    """
    request = RefitRequest(refit_model, refit_period) if refits else None
    bag_commands.replay(record, valve or [], json, request, method, columns)


for _command in (fit, compare, gap, paper, study):
    app.command()(_command)


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
    _force: Force = False,
) -> None:
    """Show what the monitor kept of a valve: minimum, mean, maximum per minute, hour or day, and counters.

    Example: ./spool trend valve_1 --since 7d --out valve_1.html
    """
    from spool_tools.commands.trend import show_trend  # noqa: PLC0415 - matplotlib is needed here only

    show_trend(valve, state_folder, parameter or [], since, out, json)


app.add_typer(alarm_app, name="alarm")
app.add_typer(valve_app, name="valve")


@app.command()
def bench(
    what: Annotated[str | None, typer.Argument(help="Which one; default: all there are.")] = None,
    json: JsonFile = None,
    seed: Annotated[int | None, typer.Option(help="gap, monitor: of the first record that is drawn.")] = None,
    cases: Annotated[int | None, typer.Option(help="gap: records; monitor: of every kind.")] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the table as Markdown.", metavar="FILE")
    ] = None,
    _force: Force = False,
) -> None:
    """Time the suite beside its peers, on the same work in one run.

    Example: ./spool bench bag --json bench.json
    """
    from spool_evaluation.bench import run_bench  # noqa: PLC0415

    run_bench(what, json, seed, cases, markdown)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code: 0 done, 1 found a problem, 2 bad input or usage."""
    arguments = sys.argv[1:] if arguments is None else arguments
    with one_command():
        remember_command(arguments)
        return _run(arguments)


def _run(arguments: list[str]) -> int:
    try:
        result = app(arguments, prog_name="spool", standalone_mode=False)
    except InputError as error:
        return fail(str(error))
    except BrokenPipeError:  # the reader of the output has ended: no fault, and nobody to tell
        raise
    except OSError as error:
        return fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except KeyboardInterrupt:
        return fail("interrupted", 130)
    except typer.Exit as stop:
        return stop.exit_code
    except typer.Abort:
        return fail("interrupted", 130)
    except TyperException as error:
        command = next((word for word in arguments if not word.startswith("-")), "")
        text = error.format_message()
        if not text:  # no arguments: the help has been shown
            return 2
        return fail(f"{text} See: ./spool {command} --help".replace("  ", " "))
    return result if isinstance(result, int) else 0


if __name__ == "__main__":
    sys.exit(main())
