"""`./spool bench`: timings side by side with peers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_tools.command import Command, Force, JsonFile


def bench(
    what: Annotated[str | None, typer.Argument(help="Which one; default: all there are.")] = None,
    json: JsonFile = None,
    seed: Annotated[
        int | None, typer.Option(help="gap, monitor: of the first record that is drawn.", min=0)
    ] = None,
    cases: Annotated[int | None, typer.Option(help="gap: records; monitor: of every kind.", min=1)] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the table as Markdown.", metavar="FILE")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="host, record: of each run.", min=10.0, max=3600.0)
    ] = None,
    valves: Annotated[
        list[int] | None, typer.Option(help="host, record: how many; as often as wanted.", min=1, max=1000)
    ] = None,
    _force: Force = False,
) -> None:
    """Time the suite side by side with its peers, on the same work in one run.

    Example: ./spool bench bag --json bench.json
    """
    from spool_evaluation.bench import run_bench  # noqa: PLC0415 - slow to load

    run_bench(what, json, seed, cases, markdown, seconds, valves)


COMMAND = Command(bench, place=170, line="timings against the peers")
