"""`./spool info`: what is in a record, and what was lost on the way into it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer
from rich.console import Console
from spool_report.outputs import damaged_places, fail, lost_messages, write_json
from spool_report.requests import ColumnsOption, RecordArgument, TimeSpan
from spool_report.terminal import Table, cell, progress, warn

from spool_tools import command as cli

if TYPE_CHECKING:
    from spool_bag.information import BagInformation


def info(
    record: RecordArgument,
    columns: ColumnsOption = None,
    json: cli.JsonFile = None,
    _force: cli.Force = False,
    *,
    when: TimeSpan,
) -> None:
    """Show the content of a record and its lost samples; exit 1 if samples were lost.

    Example: ./spool info record_bag
    """
    cli.refuse_missing(record)
    from spool_bag.information import describe  # noqa: PLC0415
    from spool_bag.metadata import ACCELERATION_BLOCK  # noqa: PLC0415 - slow to load, as below
    from spool_report.records.record_sources import is_table, span_of  # noqa: PLC0415

    with progress("reading"):
        if is_table(record):
            from spool_bag.importing.choices import columns_of  # noqa: PLC0415
            from spool_report.records.record_sources import TableSource  # noqa: PLC0415

            found = TableSource(record, columns_of(columns)).describe()
        else:
            found = describe(record, span_of(record, when))
    if json is not None:
        write_json(json, found)
    _show(found)
    if not found.valves:
        held = ", ".join(f"{topic.name} ({topic.type})" for topic in found.topics[:5]) or "nothing"
        text = f"no valve found: the bag contains {held}; a valve has a topic NAME/acceleration of "
        raise typer.Exit(fail(f"{record}: {text}{ACCELERATION_BLOCK}"))
    broken = not found.closed or found.damages or found.undecodable_messages
    lost = any(valve.lost_blocks or valve.refused_blocks for valve in found.valves)
    raise typer.Exit(1 if broken or lost else 0)


def _show(found: BagInformation) -> None:
    console = Console()
    duration = "?" if found.duration_s is None else f"{found.duration_s:.1f} s"
    state = "closed properly" if found.closed else "not closed properly: see ./spool recover"
    text = f"{found.bag}: {duration}, {found.size_bytes / 1e6:.1f} MB, {state}"
    console.print(cell(text), soft_wrap=True)
    topics = [
        (one.name, one.type, one.messages, "" if one.rate_per_s is None else f"{one.rate_per_s:.1f}")
        for one in found.topics
    ]
    Table(("topic", "type", "messages", "per second"), topics).show(console)
    valves = [
        (
            one.name, one.blocks, one.samples, "?" if one.sample_rate is None else f"{one.sample_rate:g}",
            one.lost_blocks, one.refused_blocks,
        )
        for one in found.valves
    ]  # fmt: skip
    Table(("valve", "blocks", "samples", "Hz", "lost", "refused"), valves).show(console)
    if found.damages:
        lost = lost_messages(found.lost_messages, estimated=found.lost_messages_estimated)
        text = f"{damaged_places(found.damages)}, {lost} messages lost: see ./spool recover"
        console.print(cell(text), soft_wrap=True)
    for warning in found.warnings:
        warn(warning)


COMMAND = cli.Command(info, place=110, line="the content of a bag and its lost samples")
