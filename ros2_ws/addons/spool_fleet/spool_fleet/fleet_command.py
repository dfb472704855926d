"""`./spool fleet`: many bags of many valves: catalogue, analyses, questions, trends, page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from spool_report.outputs import write_json
from spool_report.requests import ParamsFile
from spool_report.terminal import Table, warn, wide_console
from spool_tools import command as cli

fleet = typer.Typer(
    no_args_is_help=True,
    help="Catalogue and analyse many bags of many valves, query the results, show them on a page.\n\n"
    "Example: ./spool fleet run --store fleet",
)

Store = Annotated[
    Path, typer.Option("--store", metavar="DIR", help="Folder of the fleet's catalogue and tables.")
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", min=1, max=256, help="Processes at work; default: one for each processor."),
]
#: Lines about bags and analyses that are shown at most; the tables have them all.
MOST_LINES = 20


@fleet.command("add")
def add_bags(
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER...", help="Folders with bags in and below them.")
    ],
    store: Store,
    pattern: Annotated[
        str | None,
        typer.Option(
            help="Pattern of the bags' paths, such as '{machine}/{date}/{valve}'; * matches any text."
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(help="CSV file with the columns bag,machine,valve[,date], in place of a pattern."),
    ] = None,
    valve: Annotated[
        str,
        typer.Option("--valve", help="Valve file or name of a shipped valve, for bags without description."),
    ] = "",
    workers: Workers = None,
) -> None:
    """Bring bags into the catalogue: machine, valve, time, rate, gaps, oil temperature.

    Damaged and duplicate bags are reported and left out of the analyses.

    Dates are YYYY-MM-DD, YYYYMMDD or a month, YYYY-MM. Bags whose path does not fit are reported with the
    reason, and left out where nothing else states their machine.

    Example: ./spool fleet add recordings --store fleet --pattern {machine}/{date}/{valve}
    """
    from spool_fleet.operations import add_to_store  # noqa: PLC0415 - slow to load, as below

    added = add_to_store(store, folders, pattern, table, valve, workers)
    _tell(added.told, "bags", "SELECT bag, reason FROM bags WHERE status <> 'ok'")
    if added.redated:
        warn(f"{added.redated} bags have a path whose date contradicts their stamps: the path's date is used")
    if added.nameless > 1:
        warn(
            f"{added.nameless} bags state no machine: valves with the same name count as one valve; name "
            "the machines with --pattern or --table"
        )
    print(
        f"{store}: {added.new} bags added or changed, {added.unchanged} known already; "
        f"{added.damaged} damaged, {added.duplicates} duplicates"
        + (f", {added.left_out} left out" if added.left_out else "")
    )


@fleet.command("run")
def run_analyses(
    store: Store,
    analysis: Annotated[
        str,
        typer.Option(help="Analyses to run on each bag, separated by commas: fit, monitor, gap, features."),
    ] = "fit,monitor",
    workers: Workers = None,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Dask scheduler, such as tcp://10.0.0.5:8786; local: start one here."
        ),
    ] = None,
    params_file: ParamsFile = None,
) -> None:
    """Analyse the catalogue's new bags; continues an interrupted run.

    Example: ./spool fleet run --store fleet --analysis fit,monitor --workers 2
    """
    from spool_fleet.operations import run_over_store  # noqa: PLC0415

    result, trends = run_over_store(store, analysis, workers, dask, params_file)
    _tell(result.failed, "analyses", "SELECT bag, analysis, reason FROM analyses WHERE status <> 'ok'")
    print(f"{store}: {result.bags} bags analysed, {len(result.failed)} of {result.analyses} analyses failed")
    for line in trends:
        print(line)


@fleet.command("query")
def query_tables(
    store: Store,
    sql: Annotated[str | None, typer.Argument(metavar="SQL", help="One SELECT over the tables.")] = None,
    question: Annotated[
        str | None, typer.Option(help="Name of a prepared question; 'list' lists all.")
    ] = None,
    machine: Annotated[str, typer.Option(help="Machine that a question is about.")] = "",
    valve: Annotated[str, typer.Option("--valve", help="Valve that a question is about.")] = "",
    parameter: Annotated[
        str, typer.Option(help="Parameter that a question is about.")
    ] = "viscous_coefficient",
    json: cli.JsonFile = None,
    _force: cli.Force = False,
) -> None:
    """Query the tables: bags, analyses, parameters, events, gaps, trends, services.

    Example: ./spool fleet query --store fleet --question worst

    Example: ./spool fleet query --store fleet --question trend --machine press_1 --valve valve_2
    """
    from spool_fleet.operations import answer  # noqa: PLC0415

    rows = answer(store, sql, question, machine, valve, parameter)
    if json is not None:
        write_json(json, rows)
        return
    _show(rows)


@fleet.command("event")
def tell_event(
    store: Store,
    machine: Annotated[str, typer.Option(help="Machine (without --valve: all its valves).")] = "",
    valve: Annotated[str, typer.Option("--valve", help="Valve, as the tables name it.")] = "",
    oil_change: Annotated[
        str | None, typer.Option(metavar="DATE", help="Date of the oil change, YYYY-MM-DD.")
    ] = None,
    spring_change: Annotated[
        str | None, typer.Option(metavar="DATE", help="Date of the spring change.")
    ] = None,
    repair: Annotated[
        str | None, typer.Option(metavar="DATE", help="Date of a spool or sleeve change.")
    ] = None,
    comment: Annotated[str, typer.Option(help="Comment.")] = "",
) -> None:
    """Record a service; parameters that it affects get a new baseline from that date.

    Example: ./spool fleet event --store fleet --machine press_1 --oil-change 2026-05-04
    """
    from spool_fleet.operations import add_service  # noqa: PLC0415

    dates = {"oil_change": oil_change, "spring_change": spring_change, "repair": repair}
    for line in add_service(store, machine, valve, dates, comment):
        print(line)


@fleet.command("page")
def make_page(
    store: Store,
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="Page to write.")],
    reports: Annotated[
        int,
        typer.Option(min=0, help="Number of newest bags per conspicuous valve to write replay reports for."),
    ] = 0,
    params_file: ParamsFile = None,
    _force: cli.Force = False,
) -> None:
    """Write a page of the fleet: state of each valve, changes of this month, trends of the parameters.

    Example: ./spool fleet page --store fleet --out fleet.html
    """
    from spool_fleet.operations import write_page  # noqa: PLC0415

    print(write_page(store, out, reports, params_file))


def _tell(lines: list[str], table: str, sql: str) -> None:
    for line in lines[:MOST_LINES]:
        warn(line)
    if len(lines) > MOST_LINES:
        warn(f'{len(lines) - MOST_LINES} more {table}: ./spool fleet query "{sql}"')


def _show(rows: list[dict[str, Any]]) -> None:
    console = wide_console(240)
    if not rows:
        console.print("nothing found")
        return
    cells = [
        [f"{one:.5g}" if isinstance(one, float) else "" if one is None else one for one in row.values()]
        for row in rows
    ]
    Table(list(rows[0]), cells).show(console)


COMMAND = cli.Command(fleet, place=400, line="many bags of many valves: catalogue, analyses, questions, page")
