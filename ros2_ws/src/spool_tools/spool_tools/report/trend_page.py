"""Page of a valve's trend: parameters over time, as a picture and as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timezone
from typing import Any

from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from spool_core.uncertainty import number
from spool_monitor.history.trend import Span

from . import page as html

_LINE, _BAND = "#0072B2", "#56B4E9"


def trend_page(result: dict[str, Any]) -> tuple[str, bytes]:
    """Return the page of a history in units that are read easily, and its picture as PNG."""
    image, content = html.picture(draw(result), _seen(result))
    rows = trend_rows(result)
    return html.page(f"History of {result['valve']}", [image, html.table(list(rows[0]), rows)]), content


def for_people(result: dict[str, Any]) -> dict[str, Any]:
    """Return a history in units that are read easily: lengths below 1 m in mm; JSON keeps SI units."""
    parameters = {name: _in_mm(unit, spans) for name, (unit, spans) in result["parameters"].items()}
    return {**result, "parameters": parameters}


def _in_mm(unit: str, spans: Sequence[Span]) -> tuple[str, Sequence[Span]]:
    if unit != "m" or any(max(abs(span.minimum), abs(span.maximum)) >= 1.0 for span in spans):
        return unit, spans
    return "mm", [
        replace(span, minimum=1e3 * span.minimum, mean=1e3 * span.mean, maximum=1e3 * span.maximum)
        for span in spans
    ]


def draw(result: dict[str, Any]) -> Figure:
    """Return the history as one axis per parameter: mean as a line, from minimum to maximum as a band."""
    shown = {name: entry for name, entry in result["parameters"].items() if entry[1]}
    figure = Figure(figsize=(10.0, 0.6 + 1.7 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)
    for axis, (name, (unit, spans)) in zip(axes[:, 0], shown.items(), strict=True):
        times, low, mean, high = _steps(spans, result["seconds"])
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


def _steps(
    spans: Sequence[Span], seconds: int
) -> tuple[list[datetime], list[float], list[float], list[float]]:
    """Return middle, minimum, mean and maximum of each span; NaN where spans are missing, so lines break."""
    rows: list[tuple[float, float, float, float]] = []
    for span in spans:
        middle = span.start + 0.5 * seconds
        if rows and middle - rows[-1][0] > 1.5 * seconds:
            rows.append((middle - seconds, *(float("nan"),) * 3))
        rows.append((middle, span.minimum, span.mean, span.maximum))
    times = [datetime.fromtimestamp(row[0], timezone.utc) for row in rows]
    return times, [row[1] for row in rows], [row[2] for row in rows], [row[3] for row in rows]


def _seen(result: dict[str, Any]) -> str:
    """Return what the picture shows, in words."""
    parts = [
        f"{name.replace('_', ' ')} from {number(min(span.minimum for span in spans))} to "
        f"{number(max(span.maximum for span in spans))} {unit}"
        for name, (unit, spans) in result["parameters"].items()
        if spans
    ]
    return f"History of {result['valve']}: {'; '.join(parts)}."


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
