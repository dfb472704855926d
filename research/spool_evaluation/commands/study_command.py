"""`./spool study`: how often the suite is right, over many blind records."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_tools.command import Command


def study(
    what: Annotated[
        str,
        typer.Argument(
            help="gap: effects named right? field: behind real measuring chains? gap-limit: how small? "
            "estimation: do intervals hold? "
            "records: is the truth of bags/ found? steps: what does a step cost? "
            "monitor: events found in time? monitor-hours: quiet over healthy hours? "
            "operation: false alarms and delays over valve-days? operation-fit, operation-agreement: its "
            "surrogate. fleet: drift found over a year? fleet-cost: what does a bag cost?"
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for tables and pictures.")],
    cases: Annotated[int, typer.Option("--cases", "--days", help="Number of cases or days.", min=1)] = 200,
    seed: Annotated[int, typer.Option(help="Of the first; below 1000 is for development.", min=0)] = 1000,
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

    Example: ./spool study gap --cases 200 --seed 1000 --out study_gap
    """
    from spool_evaluation.study import run_study  # noqa: PLC0415 - slow to load

    run_study(what, cases, seed, out, workers, diagnosing=diagnose, faulty=faulty, day=day)


COMMAND = Command(study, place=130, line="how often the suite is right, over many blind records")
