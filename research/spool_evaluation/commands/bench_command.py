"""`./spool bench`: timings side by side with peers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_tools.command import Command, Force, JsonFile


def bench(
    what: Annotated[str | None, typer.Argument(help="Name of the benchmark (default: all).")] = None,
    json: JsonFile = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the first record (gap only).", min=0)] = None,
    cases: Annotated[int | None, typer.Option(help="Number of records (gap only).", min=1)] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the table as Markdown.", metavar="FILE")
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(help="Duration of each run, in seconds (host and record only).", min=10.0, max=3600.0),
    ] = None,
    valves: Annotated[
        list[int] | None,
        typer.Option(help="Number of valves; repeatable (host and record only).", min=1, max=1000),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="Published page; report rows that cost over 1.3 times as much.", metavar="FILE"),
    ] = None,
    _force: Force = False,
) -> None:
    """Time the suite side by side with its peers, on the same work in one run.

    Example: ./spool bench estimate --json bench.json
    """
    from spool_evaluation.bench import run_bench  # noqa: PLC0415 - slow to load

    if run_bench(what, json, seed, cases, markdown, seconds, valves, against):
        raise typer.Exit(1)


COMMAND = Command(bench, place=510, line="timings against the peers")
