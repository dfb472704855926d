"""`./spool plan`: what a planned record could tell."""

from __future__ import annotations

from typing import Annotated

import typer
from spool_core.errors import InputError
from spool_tools import command as cli
from spool_tools.command import Command

from spool_design.requests import PlanRequest


def plan(
    request: PlanRequest,
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
    from spool_design.record_plan import plan_record  # noqa: PLC0415 - slow to load

    raise typer.Exit(plan_record(request, json))


COMMAND = Command(plan, place=405, line="what a planned record can determine")
