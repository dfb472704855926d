"""`./spool plan`: what a planned record could tell."""

from __future__ import annotations

from typing import Annotated

import typer
from spool_core.errors import InputError
from spool_report.requests import ExcitationName, ShippedValve, in_range

from spool_tools import command as cli


def plan(
    question: Annotated[
        str | None,
        typer.Option(
            help="Question: coulomb_friction, stribeck_friction, mixed_friction, viscous_coefficient, "
            "spring_stiffness, end_stop or which_effect."
        ),
    ] = None,
    valve: ShippedValve = "4weh10_soft",
    excitation: ExcitationName = "sweep",
    seconds: Annotated[float, typer.Option(help="Length of the record, s.")] = 40.0,
    sample_rate: Annotated[float, typer.Option(help="Sample rate in Hz.")] = 2000.0,
    noise: Annotated[
        float, typer.Option(help="Noise of each sensor, rms, m/s^2.", callback=in_range(0.0))
    ] = 0.05,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect to try for which_effect; repeatable; default: five common effects."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 0,
    json: cli.JsonFile = None,
    _force: cli.Force = False,
    recover: Annotated[bool, typer.Option("--recover", hidden=True)] = False,
    of_recover: Annotated[str, typer.Option("--model", "--report", hidden=True)] = "",
) -> None:
    """Predict what a planned record can determine; exit 1 if it cannot answer the question.

    The command simulates the planned record and analyses it like a measured one: fits or gap workflow.

    Example: ./spool plan --valve 4weh10_soft --question coulomb_friction --noise 0.05 --seconds 20
    """
    if recover or of_recover:
        raise InputError(
            "--recover, --model and --report were removed: run simulate with another valve file, then fit"
        )
    if question is None:
        raise InputError("--question: name one")
    from spool_tools.operations.record_plan import plan_record  # noqa: PLC0415 - slow to load

    raise typer.Exit(
        plan_record(valve, question, excitation, seconds, sample_rate, noise, seed, effect or [], json)
    )


COMMAND = cli.Command(plan, place=310, line="what a planned record can determine")
