"""`./spool trend`: the monitor's history of a valve as numbers, a picture or a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from rich.console import Console
from spool_bag import check_valve
from spool_core.errors import InputError
from spool_core.system import expanded
from spool_core.text import seconds_of
from spool_core.uncertainty import exact, number, unit_text
from spool_monitor.state_database import valves_in
from spool_monitor.state_file import default_folder
from spool_monitor.trend import KEPT, TrendStore, finest
from spool_report import page as html
from spool_report.outputs import check_output, write_file, write_json
from spool_report.records.record_sources import iso_time
from spool_report.terminal import Table

_LINE, _BAND = "#0072B2", "#56B4E9"


def show_trend(
    valve: str,
    state_folder: Path | None,
    parameters: Sequence[str],
    since: str | None,
    out: Path | None,
    json: Path | None,
) -> None:
    """Show the history of ``valve``; write it as PNG or HTML (``out``) and as JSON.

    Raises:
        InputError: there is none, or an option is wrong; what there is, is named.

    """
    check_valve(valve)
    if out is not None and out.suffix not in (".png", ".html"):
        raise InputError(f"--out {out}: name a file that ends in .png or .html")
    check_output(out, "--out")
    begin = moment(since)
    store = TrendStore(kept_files(state_folder, valve, "trends")[valve], read_only=True)
    try:
        result = _read(store, valve, parameters, begin)
    finally:
        store.close()
    if json is not None:
        write_json(
            json,
            {
                "valve": result["valve"],
                "span_s": result["seconds"],
                "counters": {
                    name: {"value": value, "unit": unit} for name, (value, unit) in result["counters"].items()
                },
                "parameters": {
                    name: {
                        "unit": unit,
                        "start_s": [span.start for span in spans],
                        "count": [span.count for span in spans],
                        "minimum": [span.minimum for span in spans],
                        "mean": [span.mean for span in spans],
                        "maximum": [span.maximum for span in spans],
                    }
                    for name, (unit, spans) in result["parameters"].items()
                },
            },
        )
    shown = for_people(result)
    if out is not None:
        page, content = trend_page(shown)
        write_file(out, content if out.suffix == ".png" else page, "--out")
    _print(shown, out)


def trend_page(result: dict[str, Any]) -> tuple[str, bytes]:
    """Return the page of a history in units that are read easily, and its picture as PNG."""
    parts = [
        f"{name.replace('_', ' ')} from {number(min(span.minimum for span in spans))} to "
        f"{number(max(span.maximum for span in spans))} {unit}"
        for name, (unit, spans) in result["parameters"].items()
        if spans
    ]
    image, content = html.picture(draw(result), f"History of {result['valve']}: {'; '.join(parts)}.")
    return html.page(
        f"History of {result['valve']}", [image, html.table(Table.of(trend_rows(result)))]
    ), content


def for_people(result: dict[str, Any]) -> dict[str, Any]:
    """Return a history in units that are read easily: lengths below 1 m in mm; JSON keeps SI units."""
    parameters = dict(result["parameters"])
    for name, (unit, spans) in parameters.items():
        if unit == "m" and all(max(abs(span.minimum), abs(span.maximum)) < 1.0 for span in spans):
            parameters[name] = (
                "mm",
                [
                    replace(
                        span, minimum=1e3 * span.minimum, mean=1e3 * span.mean, maximum=1e3 * span.maximum
                    )
                    for span in spans
                ],
            )
    return {**result, "parameters": parameters}


def draw(result: dict[str, Any]) -> Figure:
    """Return the history as one axis per parameter: mean as a line, from minimum to maximum as a band."""
    shown = {name: entry for name, entry in result["parameters"].items() if entry[1]}
    figure = Figure(figsize=(10.0, 0.6 + 1.7 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)
    for axis, (name, (unit, spans)) in zip(axes[:, 0], shown.items(), strict=True):
        # NaN where spans are missing, so lines break.
        seconds = result["seconds"]
        rows: list[tuple[float, float, float, float]] = []
        for span in spans:
            middle = span.start + 0.5 * seconds
            if rows and middle - rows[-1][0] > 1.5 * seconds:
                rows.append((middle - seconds, *(float("nan"),) * 3))
            rows.append((middle, span.minimum, span.mean, span.maximum))
        times = [datetime.fromtimestamp(row[0], timezone.utc) for row in rows]
        _, low, mean, high = zip(*rows, strict=True)
        axis.fill_between(times, low, high, color=_BAND, alpha=0.4, lw=0.0)
        axis.plot(times, mean, color=_LINE, lw=1.2, marker="." if len(spans) < 30 else None)
        axis.set_ylabel(f"{name.replace('_', ' ')}\n({unit})", fontsize=8)
        axis.grid(alpha=0.3)
    last = axes[-1, 0]
    locator = AutoDateLocator()
    last.xaxis.set_major_locator(locator)
    last.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    last.set_xlabel("time (UTC)")
    return figure


def trend_rows(result: dict[str, Any]) -> list[dict[str, object]]:
    """Return a row for each parameter that has values: least, mean and largest, and how many they are."""
    rows: list[dict[str, object]] = []
    for name, (unit, spans) in result["parameters"].items():
        if not spans:
            continue
        count = sum(span.count for span in spans)
        rows.append(
            {
                "parameter": name.replace("_", " "),
                "unit": unit,
                "minimum": min(span.minimum for span in spans),
                "mean": sum(span.mean * span.count for span in spans) / count,
                "maximum": max(span.maximum for span in spans),
                "values": str(count),
            }
        )
    return rows


def _read(store: TrendStore, valve: str, wanted: Sequence[str], since: int) -> dict[str, Any]:
    units = store.units()
    for name in wanted:
        if name not in units:
            raise InputError(f"--parameter {name}: {valve} has: {', '.join(units)}")
    chosen = list(wanted) or list(units)
    hours = [span for name in chosen for span in store.spans(name, 3600, since - since % 3600)]
    length = max(span.start for span in hours) + 3600 - min(span.start for span in hours) if hours else 0
    seconds = finest(KEPT, length)
    # The hour that --since lies in may hold values of before only.
    parameters = {name: (units[name], store.spans(name, seconds, since - since % seconds)) for name in chosen}
    if not any(spans for _, spans in parameters.values()):
        of = f" of {', '.join(wanted)}" if wanted else ""
        raise InputError(
            f"{valve}: nothing{of} was kept " + ("since then: leave --since out" if since else "yet")
        )
    return {
        "valve": valve,
        "seconds": seconds,
        "counters": {name: (value, units[name]) for name, value in store.counters().items()},
        "parameters": parameters,
    }


def kept_files(state_folder: Path | None, valve: str | None, what: str) -> dict[str, Path]:
    """Return the state file of ``valve``, or of every valve (``None``), by namespace.

    Raises:
        InputError: there is none; those that there are, are named.

    """
    base = expanded(state_folder or default_folder())
    files = valves_in(base)
    if valve is None and files:
        return files
    if valve is None or valve not in files:
        raise InputError(
            f"{valve or 'no valve'}: no {what} in {base}; there are {what} of: "
            f"{', '.join(files) or 'no valve'}. "
            "A monitor keeps them while it runs; name its state_folder with --state-folder"
        )
    return {valve: files[valve]}


def moment(text: str | None) -> int:
    """Return s since 1970 of ``text``: a time, or how long ago, like 6h; 0 for ``None``.

    Raises:
        InputError: it is neither.

    """
    if text is None:
        return 0
    ago = seconds_of(text)
    if ago is not None:
        return max(0, round(datetime.now(timezone.utc).timestamp() - ago))
    try:
        return max(0, round(iso_time(text).timestamp()))
    except ValueError as error:
        raise InputError(
            f"--since {text!r}: write it like 90m, 6h, 7d or 2w, or like 2025-01-31T12:00:00 (UTC)"
        ) from error


def _print(result: dict[str, Any], out: Path | None) -> None:
    console = Console()
    length = {60: "minute", 3600: "hour", 86400: "day"}[result["seconds"]]
    console.print(
        f"{result['valve']}: one value per {length}" + (f", see {out}" if out else ""), highlight=False
    )
    Table.of(trend_rows(result)).show(console)
    for name, (value, unit) in result["counters"].items():
        console.print(f"{name} in all: {exact(value)}{unit_text(unit)}", highlight=False)
