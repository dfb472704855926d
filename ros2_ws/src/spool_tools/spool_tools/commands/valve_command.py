"""`./spool valve`: what follows from a valve file by the paper's equations, and what looks wrong in it."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools.console.command import Command

app = typer.Typer(no_args_is_help=True)


@app.callback()
def group() -> None:
    """Look at valve files.

    Example: ./spool valve check 4weh10_soft
    """


@app.command()
def check(
    file: Annotated[str, typer.Argument(metavar="FILE", help="YAML file, or a shipped valve's name.")],
) -> None:
    """Show what follows from a valve file; exit 1 where a number looks wrong.

    Example: ./spool valve check 4weh10_soft
    """
    from spool_sim.valve.description import find_valve  # noqa: PLC0415 - slow to load, as below
    from spool_sim.valve.plausibility import implausible  # noqa: PLC0415

    from spool_tools.operations.valve_quantities import quantities  # noqa: PLC0415

    valve = find_valve(file)
    for line in quantities(valve):
        print(line)
    wrong = implausible(valve)
    for said in wrong:
        print(f"looks wrong: {said}")
    raise typer.Exit(1 if wrong else 0)


COMMAND = Command(app, place=140, line="what follows from a valve file, and what looks wrong in it")
