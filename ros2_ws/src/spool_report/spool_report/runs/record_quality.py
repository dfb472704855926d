"""Quality of a record: what its channels hold, what an estimate would suffer from, in lines and as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from spool_bag.importing.choices import Choices
from spool_bag.importing.formats.format import format_of, open_table
from spool_bag.importing.logger_record import read_record
from spool_bag.importing.table import STAMP
from spool_bag.importing.table import Table as Channels
from spool_bag.importing.units import quantity_of
from spool_core.errors import InputError
from spool_core.events.language import ENGLISH
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS
from spool_core.uncertainty import BY_NAME, LEFT_OUT, as_json, named, number
from spool_estimator import record_judgement as judgement
from spool_estimator.identification.record import LARGEST, Record
from spool_estimator.identification.spectra import cross_spectrum, noise_of
from spool_monitor.orders import OrderLine, OrderSpectrum, order_spectrum
from spool_report import page as html
from spool_report.outputs import write_file, write_json
from spool_report.records import record_loading
from spool_report.requests import Selection
from spool_report.terminal import Table, captions, cell

#: s of the pieces that spectra are averaged over: lines 0.5 Hz apart.
PIECE = 2.0
#: Noise that cannot be seen.
COVERED = "not measurable"
_BODY, _SPOOL, _LINE = "#0072B2", "#D55E00", "#000000"
#: Points of a drawn line, minimum and maximum of each piece beyond.
_POINTS = 4000


def look(files: Sequence[Path], how: Choices, json: Path | None, report: Path | None) -> bool:
    """Show what is understood of files, and the record's quality; return whether `import` would take them."""
    tables = [open_table(path) for path in files]
    for table in tables:
        console = Console()
        console.print(f"{cell(str(table.path))}: {format_of(table.path).name}", soft_wrap=True, markup=False)
        for note in table.notes:
            console.print(f"  {cell(note)}", soft_wrap=True, markup=False)
        listed = [
            (
                f"  {one.number}",
                f"{group.name}/{one.name}" if group.name else one.name,
                "time of day" if one.unit == STAMP else one.unit or "not named",
                "time" if one.time or one.unit == STAMP else quantity_of(one.unit) or "not known",
            )
            for group in table.groups
            for one in group.channels
        ]
        Table(("  #", "channel", "unit", "quantity"), listed).show(console)
    try:
        record = read_record(files, how=how)
    except InputError as error:
        Console().print(f"import would refuse it: {cell(str(error))}", soft_wrap=True, markup=False)
        if json is not None:
            write_json(json, {"files": [_channels(table) for table in tables], "refused": str(error)})
        return False
    found = quality_of(record_loading.stretches_of_table(record), record.path.name, record.warnings)
    notes = [*record.notes]
    shown = {f"{table.path.name}: {note}" for table in tables for note in table.notes}
    shown |= {note for table in tables for note in table.notes}
    print_quality(found, [note for note in notes if note not in shown], Console())
    if json is not None:
        clocks = record.clocks
        write_json(
            json,
            {
                "files": [_channels(table) for table in tables],
                "refused": None,
                "notes": record.notes,
                "columns": [as_json(use) | {"unit": _named_unit(use.unit)} for use in record.uses],
                "repairs": record.repairs,
                "clocks": None
                if clocks is None
                else {
                    "offset_s": {"value": clocks.offset, "std": clocks.offset_std},
                    "drift": {"value": clocks.drift, "std": clocks.drift_std},
                },
                **as_json(found),
            },
        )
    if report is not None:
        write_file(report, quality_page(found, notes))
    return True


def check(record: Path, selection: Selection, json: Path | None, report: Path | None) -> bool:
    """Show the quality of a record; return whether nothing speaks against an estimate from it."""
    found, notes = quality_of_record(record, selection)
    print_quality(found, notes, Console())
    if json is not None:
        write_json(json, as_json(found) | {"notes": notes})
    if report is not None:
        write_file(report, quality_page(found, notes))
    return not found.doubts


def quality_of_record(record: Path, selection: Selection) -> tuple[RecordQuality, tuple[str, ...]]:
    """Return the quality of a record, and how the record was understood.

    Raises:
        InputError: the record cannot be read.
    """
    recording = record_loading.load_recording(record, replace(selection, longest=LARGEST))
    found = quality_of(recording.stretches, str(record), left_out=recording.left_out)
    if recording.speeds:
        rows = [(one.start, one.sample_period, one.body, one.spool) for one in recording.stretches]
        components = recording.described.components if recording.described else ()
        found.orders = order_spectrum(rows, recording.speeds, components)
        found.order_lines = found.orders.lines
    return found, recording.notes


def quality_page(quality: RecordQuality, notes: Sequence[str]) -> str:
    """Return the page; ``notes`` say how the record was understood."""
    texts = captions("quality")
    doubts = quality.doubts or ["this record is suitable for an estimate"]
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    density, amplification, coherence = figure.subplots(3, 1, sharex=True)
    found, band = quality.response, quality.excitation
    frequency = found.frequency[1:]
    density.loglog(frequency, found.body[1:], color=_BODY, ls="--", label="body")
    density.loglog(frequency, found.spool[1:], color=_SPOOL, label="spool")
    density.set_ylabel("density ((m/s²)²/Hz)")
    density.legend(loc="upper right")
    known = found.coherence[1:] > LIMITS.coherent
    amplification.semilogx(
        frequency, np.where(known, found.amplification[1:], np.nan), color=_LINE, marker=".", ms=3
    )
    amplification.set_ylabel("spool over body")
    coherence.semilogx(frequency, found.coherence[1:], color=_LINE, lw=0.9)
    coherence.axhline(LIMITS.coherent, color=_LINE, ls="--", lw=0.8)
    coherence.set_ylim(0.0, 1.02)
    coherence.set_ylabel("coherence")
    coherence.set_xlabel("frequency (Hz)")
    for axis in (density, amplification, coherence):
        axis.axvspan(max(band.low, frequency[0]), band.high, color="#999999", alpha=0.15, lw=0.0)
        axis.grid(alpha=0.3, which="both")
        if math.isfinite(quality.resonance.frequency):
            axis.axvline(quality.resonance.frequency, color=_LINE, ls=":", lw=1.0)
    sections = [
        html.verdict(doubts[0] if len(doubts) == 1 else f"{len(doubts)} doubts, the first: {doubts[0]}"),
        *(html.table(table) for table in tables(quality)),
        html.heading("Reasons against an estimate from this record"),
        html.listing(doubts),
        html.heading("Signals"),
        html.drawing(signals_figure(quality), texts["signals"]),
        html.heading("Spectra"),
        html.drawing(figure, texts["spectra"].format(coherent=LIMITS.coherent)),
    ]
    if quality.orders is not None and quality.orders.order.size:
        sections += [html.heading("Orders"), html.drawing(orders_figure(quality.orders), texts["orders"])]
    if notes:
        sections += [html.heading("How the record was understood"), html.listing(notes)]
    return html.page(f"Quality of {quality.record}", sections, [("record", quality.record)])


def tables(quality: RecordQuality) -> tuple[Table, Table]:
    """Return what is known of the whole record, and of each channel."""
    peak, band = quality.resonance, quality.excitation
    size = f"{number(peak.frequency)} Hz, amplification {number(peak.amplification)}"
    seen = size if math.isfinite(peak.frequency) else "none"
    facts = [
        ("duration", f"{quality.duration_s:.1f} s"),
        ("sampling rate", f"{quality.rate:.6g} Hz"),
        ("gaps", f"{quality.gaps}, {number(quality.missing_s)} s missing" if quality.gaps else "none"),
        ("excitation", f"{number(band.low)} to {number(band.high)} Hz"),
        ("coherence of the channels", f"{quality.coherence:.2f}"),
        ("resonance", seen),
        *_order_facts(quality.orders),
    ]
    channels = [
        (
            one.name, *map(number, (one.mean, one.rms, one.peak)),
            number(one.noise_rms) if math.isfinite(one.noise_rms) else COVERED,
            f"{100.0 * one.clipped:.2g} %",
        )
        for one in quality.channels
    ]  # fmt: skip
    measured = (f"{name} (m/s²)" for name in ("mean", "rms", "peak", "noise, rms"))
    return Table(("what", "value"), facts), Table(("channel", *measured, "clipped"), channels)


def _order_facts(found: OrderSpectrum | None) -> list[tuple[str, str]]:
    """Return speed and orders as rows; a record without a speed has none."""
    if found is None:
        return []
    fault = f"; in part not used: {ENGLISH.word(found.fault)}" if found.fault else ""
    speed = f"{number(found.slowest)} to {number(found.fastest)} rev/min{fault}"
    lines = [
        (
            f"order {one.order:.3g}" + (f", {one.component}" if one.component else ""),
            f"body {one.body:.3g}, spool {one.spool:.3g} m/s², most at {one.loudest_rpm:.0f} rev/min",
        )
        for one in found.lines
    ]
    shown = speed if found.order.size else ENGLISH.word(found.fault)
    return [("speed", shown), *(lines or [("orders", "none above the noise")])]


def orders_figure(found: OrderSpectrum) -> Figure:
    """Return the spectra of body and spool over the angle of the shaft."""
    figure = Figure(figsize=(10.0, 3.5), layout="constrained")
    axis = figure.subplots()
    for row, colour, name in ((found.spool, _SPOOL, "spool"), (found.body, _BODY, "body")):
        axis.semilogy(found.order[2:], row[2:], color=colour, lw=0.9, label=name)
    for line in found.lines:
        axis.axvline(line.order, color=_LINE, ls=":", lw=0.8)
    axis.set_xlim(0.0, max([6.0, *(1.5 * line.order for line in found.lines)]))
    axis.set_xlabel("order (per revolution of the shaft)")
    axis.set_ylabel("power ((m/s²)²)")
    axis.grid(alpha=0.3)
    axis.legend(loc="upper right")
    return figure


def _channels(table: Channels) -> dict[str, Any]:
    return {
        "file": table.path,
        "format": format_of(table.path).name,
        "notes": table.notes,
        "channels": [
            {"group": group.name, "number": one.number, "name": one.name, "unit": _named_unit(one.unit)}
            for group in table.groups
            for one in group.channels
        ],
    }


def _named_unit(unit: str) -> str | None:
    return None if unit in ("", STAMP) else unit


def print_quality(found: RecordQuality, notes: Sequence[str], console: Console) -> None:
    """Show the quality of a record; ``notes`` say how the record was understood."""
    for note in notes:
        console.print(cell(note), soft_wrap=True, markup=False)
    facts, channels = tables(found)
    facts.show(console, header=False)
    channels.show(console)
    for doubt in found.doubts:
        console.print(f"! {cell(doubt)}", soft_wrap=True, markup=False)
    if not found.doubts:
        console.print("this record is suitable for an estimate")


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


@dataclass(frozen=True, slots=True)
class ChannelQuality:
    """Quality of a channel: ``mean``, ``rms`` about it, ``peak`` and noise in ``unit``; ``clipped`` share.

    ``noise_rms`` is NaN where motion reaches up to half the sample rate, as the jumps of dry friction do.
    """

    name: str
    mean: float
    rms: float
    peak: float
    noise_rms: float
    clipped: float
    unit: str = "m/s^2"


@dataclass(frozen=True, slots=True)
class Response:
    """Response of the spool over ``frequency`` (Hz): densities, amplification, squared coherence."""

    frequency: Array
    body: Array
    spool: Array
    amplification: Array
    coherence: Array


@dataclass(frozen=True, slots=True)
class Excitation:
    """Band of frequencies, Hz, in which the body moves."""

    low: float = field(metadata=named("low_Hz"))
    high: float = field(metadata=named("high_Hz"))


@dataclass(frozen=True, slots=True)
class Resonance:
    """Highest coherent peak of the amplification; ``frequency`` in Hz, both NaN if none is seen."""

    frequency: float = field(default=math.nan, metadata=named("frequency_Hz"))
    amplification: float = math.nan


@dataclass(slots=True)
class RecordQuality:
    """Quality of the record of a name, as ``check --json`` writes it.

    ``rate``: Hz. ``coherence``: share of the spool's power in the band of the excitation that the body
    accounts for, 0 where it is not known. ``doubts``: what an estimate would suffer from. ``orders``: the
    spectrum over the angle of the shaft, ``None`` without a speed; ``order_lines`` are those of it.
    """

    record: str
    duration_s: float
    rate: float = field(metadata=named("sample_rate_Hz"))
    gaps: int
    missing_s: float
    channels: tuple[ChannelQuality, ChannelQuality] = field(metadata=BY_NAME)
    excitation: Excitation
    coherence: float
    resonance: Resonance
    response: Response = field(metadata=LEFT_OUT)
    longest: Record = field(metadata=LEFT_OUT)
    doubts: list[str] = field(default_factory=list)
    orders: OrderSpectrum | None = field(default=None, metadata=LEFT_OUT)
    order_lines: tuple[OrderLine, ...] = ()


def quality_of(
    stretches: Sequence[Record], name: str, warnings: Sequence[str] = (), left_out: int = 0
) -> RecordQuality:
    """Return the quality of a record, its stretches in order of time; ``warnings`` of its reading join.

    ``left_out`` are impossible samples that are left out already; those in ``stretches`` are left out here.
    """
    stretches, more = record_loading.cleaned_stretches(stretches)
    left_out += more
    longest = max(stretches, key=lambda one: one.body.size)
    rate = longest.sample_rate
    noise = noise_of(longest.body, longest.spool, rate)
    channels = (
        _channel("body", [one.body for one in stretches], noise.body_rms),
        _channel(
            "spool", [one.spool for one in stretches], math.nan if noise.spool_is_bound else noise.spool_rms
        ),
    )
    piece = int(min(longest.body.size, max(64, round(PIECE * longest.sample_rate))))
    both = cross_spectrum(longest.body, longest.spool, longest.sample_rate, piece)
    several = longest.body.size >= 2 * piece
    squared = both.coherence if several else np.zeros_like(both.body)
    response = Response(both.frequency, both.body, both.spool, both.amplification, squared)
    alive = all(one.rms > 0.0 for one in channels)
    ratio, coherence, _ = judgement.transfer(longest, noise) if several and alive else ((), 0.0, ())
    ends = [one.start * 1e-9 + one.duration for one in stretches]
    missing = sum(
        max(0.0, after.start * 1e-9 - end) for end, after in zip(ends[:-1], stretches[1:], strict=True)
    )
    found = RecordQuality(
        name,
        sum(one.duration for one in stretches),
        rate,
        len(stretches) - 1,
        missing,
        channels,
        Excitation(noise.low, noise.high),
        coherence if len(ratio) else 0.0,
        Resonance(*judgement.resonance_of(both, noise)) if several else Resonance(),
        response,
        longest,
    )
    outliers = [record_loading.outliers_text(left_out)] if left_out else []
    faults = [one.sentence for one in record_loading.channel_faults(stretches)]
    still = dict.fromkeys(text for one in stretches for texts in judgement.unchanging(one) for text in texts)
    # Noise alone has peaks anywhere.
    peak = math.nan if judgement.noisiness(longest, noise)[0] else found.resonance.frequency
    natural = peak if math.isfinite(peak) else 0.0
    seen = judgement.sampling(longest, noise, natural, judgement.Analysis) if alive else ()
    lengths = [one.duration for one in stretches]
    short = next(filter(None, (judgement.shortness(one, lengths) for one in judgement.Analysis)), "")
    apart = judgement.unrelated(found.coherence) if found.coherence > 0.0 else ""
    if not apart and not math.isfinite(found.resonance.frequency):
        apart = "no resonance is seen: the natural frequency may lie outside the band, or friction damps it"
    seen = (*still, *judgement.clipping(stretches), *seen, short, apart)
    found.doubts = [one for one in (*warnings, *outliers, *faults, *seen) if one]
    return found


def _channel(name: str, rows: Sequence[Array], noise: float) -> ChannelQuality:
    row = np.concatenate(rows)
    mean = float(row.mean())
    return ChannelQuality(
        name, mean, float(np.std(row)), float(np.abs(row - mean).max()), noise, judgement.rail_of(rows)[0]
    )
