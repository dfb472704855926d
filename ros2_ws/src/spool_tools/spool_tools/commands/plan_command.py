"""`./spool plan`: what a planned record could tell."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools import command as cli
from spool_tools.command import Command


def plan(
    question: Annotated[
        str,
        typer.Option(
            help="coulomb_friction, stribeck_friction, mixed_friction, viscous_coefficient, "
            "spring_stiffness, end_stop or which_effect."
        ),
    ],
    valve: cli.ValveFile = "4weh10_soft",
    excitation: cli.ExcitationName = "sweep",
    seconds: Annotated[float, typer.Option(help="Length of the record, s.")] = 40.0,
    sample_rate: Annotated[float, typer.Option(help="Hz")] = 2000.0,
    noise: Annotated[
        float, typer.Option(help="Noise of each sensor, rms, m/s^2.", callback=cli.in_range(0.0))
    ] = 0.05,
    effect: Annotated[
        list[str] | None, typer.Option(help="Of which_effect, once for each; default: five usual ones.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the noise.", min=0)] = 0,
    json: cli.JsonFile = None,
    _force: cli.Force = False,
) -> None:
    """Say what a record could tell before it is measured; exit 1 where it would not answer the question.

    The record is simulated as planned and goes through the same fits, or the gap workflow, as a measured one.

    Example: ./spool plan --valve 4weh10_soft --question coulomb_friction --noise 0.05 --seconds 20
    """
    from spool_tools.operations.record_plan import plan_record  # noqa: PLC0415 - slow to load

    raise typer.Exit(
        plan_record(valve, question, excitation, seconds, sample_rate, noise, seed, effect or [], json)
    )


COMMAND = Command(plan, place=25, line="what a planned record could tell, before it is measured")
