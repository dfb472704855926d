"""Run benchmarks and show them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from rich.console import Console
from rich.table import Table
from spool_stream.errors import InputError

from .benchmarks.timing import Timing
from .commands import write_json

#: Each is a module of ``benchmarks`` with ``run() -> Iterator[Timing]``.
BENCHMARKS = ("sim", "bag", "estimate", "gap", "monitor", "nodes")


def run_bench(what: str | None, json: Path | None) -> None:
    """Run the benchmark ``what``, or all; show the rows and write them as JSON.

    Raises:
        InputError: there is no benchmark of that name.

    """
    if what is not None and what not in BENCHMARKS:
        raise InputError(f"bench {what}: there is no such benchmark; there are {', '.join(BENCHMARKS)}")
    rows: list[Timing] = []
    for name in (what,) if what else BENCHMARKS:
        rows += import_module(f"{__package__}.benchmarks.{name}").run()
    table = Table("work", "beside", "ours", "theirs", "times as fast", "share", box=None, pad_edge=False)
    for row in rows:
        share = f"{100.0 / row.ratio:.1f} %"
        table.add_row(
            row.work, row.peer, f"{row.ours_s:.3g} s", f"{row.peer_s:.3g} s", f"{row.ratio:.3g}", share
        )
    Console(width=140).print(table)
    if json is not None:
        write_json(json, [row.to_dict() for row in rows])
