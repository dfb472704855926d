"""`./spool valve`: a valve file from a data sheet, what follows from one, and what looks wrong in it."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError
from spool_report.outputs import check_output
from spool_report.requests import option

from spool_tools.command import Command, Force, JsonFile, flat

app = typer.Typer(no_args_is_help=True)

Text = str | None
Stated = Annotated[Text, option("Value with unit; SI if no unit is given.")]


@dataclass(frozen=True, slots=True)
class DataSheet:
    """Numbers of a data sheet, by the keys of ``valve_sheet.QUESTIONS``."""

    id: Annotated[Text, option("Name of the valve.")] = None
    moving_mass: Stated = None
    spool_mass: Stated = None
    spring_mass: Stated = None
    oil_mass: Stated = None
    spring_stiffness: Stated = None
    spring_rate: Annotated[Text, option("Rate of one of two equal springs, with unit.")] = None
    natural_frequency: Annotated[Text, option("Use this if the stiffness is unknown.")] = None
    land_diameter: Stated = None
    land_length: Stated = None
    radial_clearance: Stated = None
    oil: Annotated[Text, option("HL68, Azolla ZS22, or ISO VG 10 to ISO VG 100.")] = None
    oil_temperature: Annotated[Text, option("Temperature of the oil at work in deg C.")] = None
    dynamic_viscosity: Stated = None


@app.callback()
def group() -> None:
    """Write and check valve files.

    Example: ./spool valve check 4weh10_soft
    """


@app.command()
@flat
def new(
    out: Annotated[
        Path,
        option(
            "Valve file to write.", metavar="FILE.yaml", callback=lambda path: check_output(path, "--out")
        ),
    ],
    data_sheet: DataSheet,
    _force: Force = False,
) -> None:
    """Write a valve file from a data sheet; on a terminal you are asked for missing numbers.

    Required: --id; --moving-mass, or --spool-mass with --spring-mass; --spring-stiffness, --spring-rate
    or --natural-frequency.

    Example: ./spool valve new --out my_valve.yaml --id mine --moving-mass 180g --spring-rate 0.816N/mm
    """
    from spool_report.outputs import write_file  # noqa: PLC0415 - slow to load, as below
    from spool_report.records import valve_sheet as sheet  # noqa: PLC0415
    from spool_report.terminal import warn  # noqa: PLC0415

    answers = {key: value for key, value in asdict(data_sheet).items() if value is not None}
    if sys.stdin.isatty():
        print("Answer with units; press Enter if the data sheet does not state the value.")
        try:
            answers = sheet.asked(answers, lambda question: input(f"{question}: "), warn)
        except EOFError:
            raise InputError(
                "the answers ended before the last question: press Enter at what you do not know, or give "
                "all answers as options (./spool valve new --help)"
            ) from None
    valve, how = sheet.described(answers)
    write_file(out, sheet.file_text(valve, how), "--out")
    for line in sheet.quantities(valve):
        print(line)
    for said in sheet.judged(str(out)).wrong:
        print(f"looks wrong: {said}")
    print(f"written: {out}")


@app.command()
def check(
    file: Annotated[str, typer.Argument(metavar="FILE", help="YAML file, or a shipped valve's name.")],
    record: Annotated[Path | None, option("Record of this valve: bag or file.", metavar="RECORD")] = None,
    name: Annotated[str | None, option("Valve to use if the bag holds several.")] = None,
    columns: Annotated[str | None, option("Column names in the file.")] = None,
    json: JsonFile = None,
    _force: Force = False,
) -> None:
    """Show the properties of a valve file, and whether a record agrees; exit 1 if a value looks wrong.

    Example: ./spool valve check 4weh10_soft --record bags/practice_03
    """
    from spool_report.outputs import write_json  # noqa: PLC0415 - slow to load, as below
    from spool_report.records import valve_sheet as sheet  # noqa: PLC0415
    from spool_report.runs.record_replay import check_of_record  # noqa: PLC0415

    verdict = sheet.judged(file)
    if verdict.valve is not None:
        for line in sheet.quantities(verdict.valve):
            print(line)
        if record is not None:
            shows, doubts = check_of_record(record, verdict.valve, name, columns)
            verdict.wrong += doubts
            sheet.against_record(verdict, shows, record)
    shown = verdict.shown
    if shown is not None:
        frequency = shown["natural_frequency_Hz"]
        if frequency is None:
            print(f"{record}: the spool moves too little to show its natural frequency")
        elif verdict.valve is not None:
            filed = f"{verdict.valve.natural_frequency:.4g} Hz"
            differs = any("the record shows" in one for one in verdict.wrong)
            agreed = "the file differs" if differs else "agrees with the file"
            print(f"the record shows {frequency['value']:.4g} Hz: {agreed} ({filed})")
    for said in verdict.wrong:
        print(f"looks wrong: {said}")
    if json is not None:
        write_json(json, verdict.dictionary())
    raise typer.Exit(1 if verdict.wrong else 0)


COMMAND = Command(app, place=315, line="valve files: write one from a data sheet, check one")
