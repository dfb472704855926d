"""`./spool study`: how often the suite is right, over many blind records."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError
from spool_tools.command import Command

from spool_evaluation.studies import STUDIES


def study(
    what: Annotated[
        str,
        typer.Argument(
            help="field: hidden effects named right, behind real measuring chains? "
            "estimation: do intervals hold? "
            "loggers: behind filters of loggers? "
            "operation: false alarms and delays over valve-days? "
            "operation-fit, operation-agreement: its surrogate. "
            "orders: false orders and speeds? "
            "fleet: drift found over a year? fleet-cost: what does a bag cost? "
            "stale: which pages of docs/results are older than the code that they measured?"
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for tables and pictures; needed for all but stale.")
    ] = None,
    cases: Annotated[int, typer.Option("--cases", "--days", help="Number of cases or days.", min=1)] = 200,
    seed: Annotated[int, typer.Option(help="First seed; below 1000: development.", min=0)] = 1000,
    workers: Annotated[
        int | None, typer.Option("--workers", "--jobs", help="Processes; default: as many as cores.", min=1)
    ] = None,
    diagnose: Annotated[
        bool, typer.Option("--diagnose", help="State why each wrong verdict is wrong (field only).")
    ] = False,
    faulty: Annotated[
        int | None, typer.Option(help="Number of days with a fault (operation only).", min=0)
    ] = None,
    day: Annotated[
        int | None, typer.Option(help="Seed of one valve-day to replay (operation only).", min=0)
    ] = None,
) -> None:
    """Count over many blind records how often the suite is right.

    Example: ./spool study field --cases 60 --seed 1000 --out study_field
    """
    if what == "stale":
        from spool_evaluation.results.stale import OLD, ROOT, ages  # noqa: PLC0415 - slow to load

        pages = ages(ROOT / "docs" / "results")
        print("\n".join(map(str, pages)) or "no page is older than its code")
        raise typer.Exit(int(any(one.share > OLD for one in pages)))
    if what not in STUDIES:
        raise InputError(f"study {what}: there is no such study; there are {', '.join(STUDIES)}, stale")
    if diagnose and what != "field":
        raise InputError(f"study {what}: only the study field has a diagnosis; remove --diagnose")
    if what != "operation" and (faulty is not None or day is not None):
        raise InputError(f"study {what}: only the study operation has valve-days; remove --faulty and --day")
    if out is None:
        raise InputError(f"study {what}: name a folder for its tables and pictures with --out")
    out.mkdir(parents=True, exist_ok=True)
    module, function = STUDIES[what]
    given = {"diagnosing": diagnose or None, "faulty": faulty, "day": day}
    options = {name: value for name, value in given.items() if value is not None}
    found = import_module(module if module.startswith("spool_") else f"spool_evaluation.{module}")
    getattr(found, function)(cases, seed, out, workers, **options)


COMMAND = Command(study, place=520, line="how often the suite is right, over many blind records")
