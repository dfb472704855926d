"""`./spool check`: what was understood of a record, in lines and as a page with pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from spool_bag.importing.choices import Choices
from spool_bag.importing.formats.format import format_of, open_table
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_bag.importing.table import STAMP
from spool_bag.importing.table import Table as Channels
from spool_bag.importing.units import quantity_of
from spool_core.errors import InputError
from spool_core.uncertainty import number
from spool_estimator.identification.record import LARGEST

from spool_tools.operations.record_loading import Selection, load_recording, stretches_of_table
from spool_tools.operations.record_quality import COHERENT, RecordQuality, quality_of
from spool_tools.outputs import write_file, write_json
from spool_tools.report import page as html
from spool_tools.terminal import cell

_BODY, _SPOOL, _LINE = "#0072B2", "#D55E00", "#000000"
#: Points of a drawn line, minimum and maximum of each piece beyond.
_POINTS = 4000


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
    print_quality(found, [note for note in notes if note not in shown], Console())
    if json is not None:
        write_json(json, _dictionary(tables, record, found))
    if report is not None:
        write_file(report, quality_page(found, notes))
    return True


def check(record: Path, selection: Selection, json: Path | None, report: Path | None) -> bool:
    """Show the quality of a record; return whether nothing speaks against an estimate from it."""
    found, notes = record_quality(record, selection)
    print_quality(found, notes, Console())
    if json is not None:
        write_json(json, quality_dictionary(found, notes))
    if report is not None:
        write_file(report, quality_page(found, notes))
    return not found.doubts


def record_quality(record: Path, selection: Selection) -> tuple[RecordQuality, tuple[str, ...]]:
    """Return the quality of a record, and how the record was understood.

    Raises:
        InputError: the record cannot be read.
    """
    recording = load_recording(record, replace(selection, longest=LARGEST, described=False))
    found = quality_of(recording.stretches, str(record), left_out=recording.left_out)
    return found, recording.notes


def quality_dictionary(quality: RecordQuality, notes: Sequence[str]) -> dict[str, Any]:
    """Return what ``check --json`` writes."""
    return {**quality.dictionary(), "notes": list(notes)}


def quality_page(quality: RecordQuality, notes: Sequence[str]) -> str:
    """Return the page; ``notes`` say how the record was understood."""
    doubts = quality.doubts or ["nothing speaks against an estimate from this record"]
    sections = [
        html.verdict(doubts[0] if len(doubts) == 1 else f"{len(doubts)} doubts, the first: {doubts[0]}"),
        html.table(["what", "value"], facts(quality)),
        html.table(list(channel_rows(quality)[0]), channel_rows(quality)),
        html.heading("What speaks against an estimate from it"),
        html.listing(doubts),
        html.heading("Signals"),
        html.drawing(
            signals_figure(quality),
            "Top: body and spool over time; gray where more than one sample falls on a point. Bottom: the "
            "liveliest second, in which flat tops and spikes would show.",
        ),
        html.heading("Spectra"),
        html.drawing(
            _spectra(quality),
            "Top: power density of both channels; what lies flat at high frequencies is noise. "
            "Middle: how much "
            "more the spool moves than the body; its peak is the resonance. Bottom: squared coherence; below "
            f"{COHERENT:g} (dashed) nothing is known of the spool's response.",
        ),
    ]
    if notes:
        sections += [html.heading("How the record was understood"), html.listing(notes)]
    return html.page(f"Quality of {quality.name}", sections, [("record", quality.name)])


def facts(quality: RecordQuality) -> list[dict[str, object]]:
    """Return what is known of the whole record."""
    frequency, size = quality.resonance
    seen = f"{number(frequency)} Hz, {number(size)} times the body" if math.isfinite(frequency) else "none"
    return [
        {"what": "duration", "value": f"{quality.duration:.1f} s"},
        {"what": "sampling rate", "value": f"{quality.rate:.6g} Hz"},
        {
            "what": "gaps",
            "value": f"{quality.gaps}, {number(quality.missing)} s missing" if quality.gaps else "none",
        },
        {"what": "excitation", "value": f"{number(quality.band[0])} to {number(quality.band[1])} Hz"},
        {"what": "coherence of the channels", "value": f"{quality.coherence:.2f}"},
        {"what": "resonance seen", "value": seen},
    ]


def channel_rows(quality: RecordQuality) -> list[dict[str, object]]:
    """Return what is known of each channel, in m/s^2."""
    return [
        {
            "channel": one.name,
            "mean (m/s²)": number(one.mean),
            "rms (m/s²)": number(one.rms),
            "peak (m/s²)": number(one.peak),
            "noise, rms (m/s²)": f"at most {number(one.noise)}" if one.at_most else number(one.noise),
            "clipped": f"{100.0 * one.clipped:.2g} %",
        }
        for one in quality.channels
    ]


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


def print_quality(found: RecordQuality, notes: Sequence[str], console: Console) -> None:
    """Show the quality of a record; ``notes`` say how the record was understood."""
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


def signals_figure(quality: RecordQuality) -> Figure:
    """Return body and spool over time, and their liveliest second."""
    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1)
    record = quality.longest
    step = max(1, record.body.size // _POINTS)
    whole = record.body.size // step * step
    time = np.arange(0, whole, step) * record.sample_period
    for row, colour, name in ((record.spool, _SPOOL, "spool"), (record.body, _BODY, "body")):
        pieces = row[:whole].reshape(-1, step)
        upper.fill_between(
            time, pieces.min(axis=1), pieces.max(axis=1), color=colour, alpha=0.6, lw=0.3, label=name
        )
    upper.set_xlabel("time (s)")
    width = min(record.body.size, max(2, round(record.sample_rate)))
    power = np.convolve(np.square(record.spool - record.spool.mean()), np.ones(width), "valid")
    at = int(np.argmax(power))
    span = np.arange(at, at + width)
    lower.plot(span * record.sample_period, record.spool[span], color=_SPOOL, lw=0.9, label="spool")
    lower.plot(span * record.sample_period, record.body[span], color=_BODY, lw=0.9, ls="--", label="body")
    lower.set_xlabel("time (s)")
    for axis in (upper, lower):
        axis.set_ylabel("acceleration (m/s²)")
        axis.grid(alpha=0.3)
        axis.legend(loc="upper right")
    return figure


def _spectra(quality: RecordQuality) -> Figure:
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    density, amplification, coherence = figure.subplots(3, 1, sharex=True)
    found = quality.response
    frequency = found.frequency[1:]
    density.loglog(frequency, found.body[1:], color=_BODY, ls="--", label="body")
    density.loglog(frequency, found.spool[1:], color=_SPOOL, label="spool")
    density.set_ylabel("density ((m/s²)²/Hz)")
    density.legend(loc="upper right")
    known = found.coherence[1:] > COHERENT
    amplification.semilogx(
        frequency, np.where(known, found.amplification[1:], np.nan), color=_LINE, marker=".", ms=3
    )
    amplification.set_ylabel("spool over body")
    coherence.semilogx(frequency, found.coherence[1:], color=_LINE, lw=0.9)
    coherence.axhline(COHERENT, color=_LINE, ls="--", lw=0.8)
    coherence.set_ylim(0.0, 1.02)
    coherence.set_ylabel("coherence")
    coherence.set_xlabel("frequency (Hz)")
    for axis in (density, amplification, coherence):
        axis.axvspan(max(quality.band[0], frequency[0]), quality.band[1], color="#999999", alpha=0.15, lw=0.0)
        axis.grid(alpha=0.3, which="both")
        if math.isfinite(quality.resonance[0]):
            axis.axvline(quality.resonance[0], color=_LINE, ls=":", lw=1.0)
    return figure
