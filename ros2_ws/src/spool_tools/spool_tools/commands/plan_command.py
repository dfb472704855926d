"""`./spool plan`: what a planned record could tell."""

from __future__ import annotations

from typing import Annotated

import typer
from spool_core.errors import InputError

from spool_tools import command as cli
from spool_tools.command import Command


def plan(
    question: Annotated[
        str | None,
        typer.Option(
            help="Question: coulomb_friction, stribeck_friction, mixed_friction, viscous_coefficient, "
            "spring_stiffness, end_stop or which_effect."
        ),
    ] = None,
    recover: Annotated[
        bool,
        typer.Option(
            "--recover", help="Draw a valve, fit its planned record blind, show truth and intervals."
        ),
    ] = False,
    model: cli.ModelName = "coulomb",
    valve: cli.ValveFile = "4weh10_soft",
    excitation: cli.ExcitationName = "sweep",
    seconds: Annotated[float, typer.Option(help="Length of the record, s.")] = 40.0,
    sample_rate: Annotated[float, typer.Option(help="Sample rate in Hz.")] = 2000.0,
    noise: Annotated[
        float, typer.Option(help="Noise of each sensor, rms, m/s^2.", callback=cli.in_range(0.0))
    ] = 0.05,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect to try for which_effect; repeatable; default: five common effects."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 0,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    _force: cli.Force = False,
) -> None:
    """Predict what a planned record can determine; exit 1 if it cannot answer the question.

    With --recover, exit 1 if an interval misses the truth, which one in 20 does.

    The command simulates the planned record and analyses it like a measured one: fits or gap workflow.

    Example: ./spool plan --valve 4weh10_soft --question coulomb_friction --noise 0.05 --seconds 20

    Example: ./spool plan --recover --model coulomb --seconds 10 --noise 0.1 --report plan.html
    """
    if recover and question is not None:
        raise InputError("--recover and --question: pass one of them")
    if recover:
        from spool_tools.operations.plan_recovery import recover_record  # noqa: PLC0415 - slow to load

        raise typer.Exit(
            recover_record(valve, model, excitation, seconds, sample_rate, noise, seed, json, report)
        )
    if report is not None:
        raise InputError("--report: only --recover writes a page; pass --json for the answer to a question")
    if question is None:
        raise InputError("--question: name one, or pass --recover")
    from spool_tools.operations.record_plan import plan_record  # noqa: PLC0415 - slow to load

    raise typer.Exit(
        plan_record(valve, question, excitation, seconds, sample_rate, noise, seed, effect or [], json)
    )


COMMAND = Command(plan, place=25, line="what a planned record can determine")
