"""Trend of a valve: the monitor's history as a picture, a page or numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from spool_bag.names import check_valve
from spool_core.errors import InputError
from spool_core.uncertainty import exact, number, unit_text
from spool_monitor.history.state_file import default_folder, valve_folder
from spool_monitor.history.trend import KEPT, TrendStore, finest, own_file
from spool_monitor.history.valve_state import TRENDS

from spool_tools.console.outputs import check_output, write_file, write_json
from spool_tools.report.trend_page import for_people, trend_page, trend_rows

_UNITS = {"m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}


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
    begin = _since(since)
    base = (state_folder or default_folder()).expanduser()
    path = own_file(valve_folder(base, valve) / TRENDS)
    if not path.is_file():
        there = sorted(str(one.parent.parent.relative_to(base)) for one in base.glob(f"**/{TRENDS}"))
        raise InputError(
            f"{valve}: no trends in {base}; there are trends of: {', '.join(there) or 'no valve'}. "
            "A monitor keeps them while it runs; name its state_folder with --state-folder"
        )
    store = TrendStore(path, read_only=True)
    try:
        result = _read(store, valve, parameters, begin)
    finally:
        store.close()
    if json is not None:
        write_json(json, _as_json(result))
    shown = for_people(result)
    if out is not None:
        page, content = trend_page(shown)
        write_file(out, content if out.suffix == ".png" else page, "--out")
    _print(shown, out)


def _read(store: TrendStore, valve: str, wanted: Sequence[str], since: int) -> dict[str, Any]:
    units = store.units()
    for name in wanted:
        if name not in units:
            raise InputError(f"--parameter {name}: {valve} has: {', '.join(units)}")
    chosen = list(wanted) or list(units)
    hours = [span for name in chosen for span in store.spans(name, 3600, since - since % 3600)]
    if not hours:
        raise InputError(f"{valve}: nothing was kept since then: leave --since out")
    seconds = finest(KEPT, max(span.start for span in hours) + 3600 - min(span.start for span in hours))
    return {
        "valve": valve,
        "seconds": seconds,
        "counters": {name: (value, units[name]) for name, value in store.counters().items()},
        "parameters": {
            name: (units[name], store.spans(name, seconds, since - since % seconds)) for name in chosen
        },
    }


def _since(text: str | None) -> int:
    """Return s since 1970 of ``text``: a time, or how long ago, like 6h; 0 for all."""
    if text is None:
        return 0
    ago = re.fullmatch(r"(\d+(?:\.\d+)?)([mhdw])", text)
    if ago:
        length = timedelta(seconds=float(ago[1]) * _UNITS[ago[2]])
        try:
            return max(0, round((datetime.now(timezone.utc) - length).timestamp()))
        except OverflowError:
            return 0
    try:
        time = datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError as error:
        raise InputError(
            f"--since {text!r}: write it like 90m, 6h, 7d or 2w, or like 2025-01-31T12:00:00 (UTC)"
        ) from error
    return max(0, round((time if time.tzinfo else time.replace(tzinfo=timezone.utc)).timestamp()))


def _as_json(result: dict[str, Any]) -> dict[str, Any]:
    return {
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
    }


def _print(result: dict[str, Any], out: Path | None) -> None:
    console = Console()
    length = {60: "minutes", 3600: "hours", 86400: "days"}[result["seconds"]]
    console.print(
        f"{result['valve']}: history in {length}" + (f", see {out}" if out else ""), highlight=False
    )
    rows = trend_rows(result)
    shown = Table(*rows[0], box=None, pad_edge=False)
    for row in rows:
        shown.add_row(
            *(number(value, 5) if isinstance(value, float) else str(value) for value in row.values())
        )
    console.print(shown)
    for name, (value, unit) in result["counters"].items():
        console.print(f"{name} in all: {exact(value)}{unit_text(unit)}", highlight=False)
