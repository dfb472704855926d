"""Look at a record: what is understood of files before anything is written, and a record's quality."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from spool_bag.importing.formats.format import format_of, open_table
from spool_bag.importing.records.choices import Choices
from spool_bag.importing.records.logger_record import LoggerRecord, read_record
from spool_bag.importing.tables.table import STAMP
from spool_bag.importing.tables.table import Table as Channels
from spool_bag.importing.units.units import quantity_of
from spool_core.errors import InputError
from spool_estimator.identification.record_parts import LARGEST

from spool_tools.console.outputs import write_file, write_json
from spool_tools.console.terminal import cell
from spool_tools.input.record_loading import Selection, load_recording, stretches_of_table
from spool_tools.quality.record_quality import RecordQuality, quality_of
from spool_tools.report.quality_page import channel_rows, facts, quality_page


def look(files: Sequence[Path], how: Choices, json: Path | None, report: Path | None) -> bool:
    """Show what is understood of files, and the record's quality; return whether `import` would take them."""
    tables = [open_table(path) for path in files]
    for table in tables:
        _show_channels(table)
    try:
        record = read_record(files, how=how)
    except InputError as error:
        Console().print(f"import would refuse it: {cell(str(error))}", soft_wrap=True, markup=False)
        if json is not None:
            write_json(json, {"files": [_channels(table) for table in tables], "refused": str(error)})
        return False
    found = quality_of(stretches_of_table(record), record.path.name, record.warnings)
    notes = [*record.notes]
    shown = {f"{table.path.name}: {note}" for table in tables for note in table.notes}
    shown |= {note for table in tables for note in table.notes}
    _show(found, [note for note in notes if note not in shown])
    if json is not None:
        write_json(json, _dictionary(tables, record, found))
    if report is not None:
        write_file(report, quality_page(found, notes))
    return True


def check(record: Path, selection: Selection, json: Path | None, report: Path | None) -> bool:
    """Show the quality of a record; return whether nothing speaks against an estimate from it."""
    recording = load_recording(record, replace(selection, longest=LARGEST, described=False))
    found = quality_of(recording.stretches, str(record), left_out=recording.left_out)
    _show(found, recording.notes)
    if json is not None:
        write_json(json, {**found.dictionary(), "notes": list(recording.notes)})
    if report is not None:
        write_file(report, quality_page(found, recording.notes))
    return not found.doubts


def _dictionary(tables: Sequence[Channels], record: LoggerRecord, found: RecordQuality) -> dict[str, Any]:
    clocks = record.clocks
    return {
        "files": [_channels(table) for table in tables],
        "refused": None,
        "notes": list(record.notes),
        "columns": [use.dictionary() for use in record.uses],
        "repairs": dict(record.repairs),
        "clocks": None
        if clocks is None
        else {
            "offset_s": {"value": clocks.offset, "std": clocks.offset_std},
            "drift": {"value": clocks.drift, "std": clocks.drift_std},
        },
        **found.dictionary(),
    }


def _channels(table: Channels) -> dict[str, Any]:
    return {
        "file": str(table.path),
        "format": format_of(table.path).name,
        "notes": list(table.notes),
        "channels": [
            {
                "group": group.name,
                "number": one.number,
                "name": one.name,
                "unit": None if one.unit in ("", STAMP) else one.unit,
            }
            for group in table.groups
            for one in group.channels
        ],
    }


def _show_channels(table: Channels) -> None:
    console = Console()
    console.print(f"{cell(str(table.path))}: {format_of(table.path).name}", soft_wrap=True, markup=False)
    for note in table.notes:
        console.print(f"  {cell(note)}", soft_wrap=True, markup=False)
    shown = Table(box=None, pad_edge=False)
    for column in ("  #", "channel", "unit", "measures"):
        shown.add_column(column)
    for group in table.groups:
        for one in group.channels:
            name = f"{group.name}/{one.name}" if group.name else one.name
            unit = "time of day" if one.unit == STAMP else one.unit or "not named"
            what = "time" if one.time or one.unit == STAMP else quantity_of(one.unit) or "not known"
            shown.add_row(f"  {one.number}", cell(name), cell(unit), what)
    console.print(shown)


def _show(found: RecordQuality, notes: Sequence[str]) -> None:
    console = Console()
    for note in notes:
        console.print(cell(note), soft_wrap=True, markup=False)
    summary = Table(box=None, pad_edge=False, show_header=False)
    for fact in facts(found):
        summary.add_row(str(fact["what"]), str(fact["value"]))
    console.print(summary)
    rows = channel_rows(found)
    table = Table(box=None, pad_edge=False)
    for column in rows[0]:
        table.add_column(column)
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    console.print(table)
    for doubt in found.doubts:
        console.print(f"! {cell(doubt)}", soft_wrap=True, markup=False)
    if not found.doubts:
        console.print("nothing speaks against an estimate from this record")
