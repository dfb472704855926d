"""`./spool export`: a bag's samples as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_core.text import printable

from spool_tools.command import (
    AroundOption,
    BagArgument,
    Command,
    Force,
    SinceOption,
    UntilOption,
    refuse_missing,
)
from spool_tools.outputs import making_room
from spool_tools.terminal import progress, warn


def export(
    bag: BagArgument,
    out: Annotated[Path, typer.Option(help="FILE.parquet, FILE.csv or FILE.csv.gz", metavar="FILE")],
    name: Annotated[
        list[str] | None,
        typer.Option("--name", "--valve", help="Namespace of a valve in the bag; default: all."),
    ] = None,
    since: SinceOption = None,
    until: UntilOption = None,
    around: AroundOption = None,
    _force: Force = False,
) -> None:
    """Write a bag's samples as a table.

    Example: ./spool export record_bag --out record.parquet
    """
    refuse_missing(bag)
    from spool_bag.export import export_bag  # noqa: PLC0415 - slow to load

    from spool_tools.operations.record_sources import span_of  # noqa: PLC0415

    with making_room(out), progress("exporting") as advance:
        span = span_of(bag, since, until, around)
        result = export_bag(bag, out, valves=name, span=span, progress=advance)
    for warning in result.warnings:
        warn(warning)
    print(f"{out}: {result.rows} rows of {printable(', '.join(result.valves))}")


COMMAND = Command(export, place=50, line="a bag to Parquet or CSV")
