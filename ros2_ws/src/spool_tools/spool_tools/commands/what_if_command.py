"""`./spool what-if`: the response of a valve under changed conditions."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console
from spool_report.outputs import write_file, write_json
from spool_report.terminal import warn

from spool_tools import command as cli
from spool_tools.command import Command


def what_if(
    valve: Annotated[
        str,
        typer.Option(
            help="YAML file of the valve, or name of a shipped valve.", autocompletion=cli.valve_names
        ),
    ],
    model: Annotated[
        str | None,
        typer.Option(
            help="Model: its name or a YAML file; a file of fit or gap gives intervals. Default: fluid.",
            autocompletion=cli.model_names,
        ),
    ] = None,
    spring_stiffness: Annotated[float | None, typer.Option(help="Other springs, N/m, both together.")] = None,
    changed: Annotated[
        list[str] | None,
        typer.Option("--set", help="Other value of a parameter, SI units: mass=0.2; repeatable."),
    ] = None,
    oil: Annotated[str | None, typer.Option(help="Other oil by its name, e.g. HL68 or 'ISO VG 46'.")] = None,
    oil_temperature: Annotated[float | None, typer.Option(help="Other oil temperature, deg C.")] = None,
    mount_frequency: Annotated[
        float | None, typer.Option(help="Natural frequency of an isolating mount of the valve, Hz.")
    ] = None,
    mount_damping: Annotated[float | None, typer.Option(help="Damping ratio of that mount.")] = None,
    excitation: Annotated[
        str | None,
        typer.Option(
            help="Preset or YAML file of sines or machine orders, in place of the options below.",
            autocompletion=cli.excitation_names,
        ),
    ] = None,
    amplitude: Annotated[
        float | None, typer.Option(help="Peak acceleration of the machine, m/s^2; default: 10.")
    ] = None,
    frequency_range: Annotated[
        str | None,
        typer.Option(help="Frequencies to show, Hz; default: around the resonances.", metavar="LOW:HIGH"),
    ] = None,
    speed_range: Annotated[
        str | None, typer.Option(help="Speeds of engine or pump, rev/min.", metavar="LOW:HIGH")
    ] = None,
    order: Annotated[
        str | None, typer.Option(help="Orders of engine or pump, e.g. 1,2,9.", metavar="N,...")
    ] = None,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    _force: cli.Force = False,
) -> None:
    """Predict the response of a valve with other springs, oil, mass or mount, and compare it with today.

    Example: ./spool what-if --valve 4weh10_soft --spring-stiffness 5846 --speed-range 600:2400 --order 1,2

    Example: ./spool what-if --valve 4weh10_soft --model coulomb --mount-frequency 6 --mount-damping 0.1
    """
    from spool_report.runs.what_if import WhatIfRequest, print_what_if  # noqa: PLC0415 - slow to load
    from spool_report.runs.what_if import what_if as predict  # noqa: PLC0415 - slow to load

    request = WhatIfRequest(
        valve, model, spring_stiffness, changed or (), oil, oil_temperature, mount_frequency, mount_damping,
        excitation, amplitude, frequency_range, speed_range, order,
    )  # fmt: skip
    found = predict(request)
    for note in found.notes:
        warn(note)
    print_what_if(found, Console())
    if json is not None:
        write_json(json, found)
    if report is not None:
        from spool_report.what_if_page import what_if_page  # noqa: PLC0415 - matplotlib is needed here only

        write_file(report, what_if_page(found), "--report")
        print(f"{report}: pictures and tables")


COMMAND = Command(what_if, place=305, line="response with other springs, oil, mass or mount")
