"""`./spool import`: a data logger's file as a bag."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated

import typer
from spool_stream.errors import InputError

from spool_tools.console.cli_options import ColumnsOption, Force, NewBag
from spool_tools.console.command import Command
from spool_tools.console.outputs import making_room
from spool_tools.console.terminal import warn


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV file, may be gzipped.")],
    out: NewBag,
    name: Annotated[str, typer.Option(help="Namespace of the valve in the bag.")] = "valve_1",
    columns: ColumnsOption = None,
    start: Annotated[
        str | None,
        typer.Option(
            help="Time of time_s = 0, ISO 8601, UTC; default: 2025-01-01, "
            "or none where time_s counts from 1970."
        ),
    ] = None,
    _force: Force = False,
) -> None:
    """Turn a data logger's CSV file into a bag.

    Example: ./spool import record.csv.gz --out record_bag
    """
    from spool_bag.tables.csv_import import import_csv  # noqa: PLC0415 - slow to load, as below

    from spool_tools.input.record_names import parse_columns  # noqa: PLC0415

    moment = None if start is None else _moment(start)
    with making_room(out):
        result = import_csv(file, out, valve=name, columns=parse_columns(columns), start=moment)
    for warning in result.warnings:
        warn(warning)
    lost = f", {result.lost_blocks} blocks lost in gaps" if result.lost_blocks else ""
    print(
        f"{out}: {result.samples} samples in {result.blocks} blocks of /{name}, "
        f"{result.duration:.1f} s at {1.0 / result.period:g} Hz{lost}"
    )


def _moment(start: str) -> int:
    """Return the time ``start`` (ISO 8601, UTC where it names no zone) in ns since 1970."""
    try:
        time = datetime.fromisoformat(start.replace("Z", "+00:00"))
        zoned = time if time.tzinfo else time.replace(tzinfo=timezone.utc)
        return round(zoned.timestamp()) * 1_000_000_000
    except (ValueError, OverflowError) as error:
        raise InputError(f"--start {start!r}: write it like 2025-01-31T12:00:00") from error


COMMAND = Command(import_, place=40, line="a data logger's CSV file to a bag")
