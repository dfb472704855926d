"""Trends of a valve: what its monitor kept over hours to years, read as `./spool trend` reads it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from spool_core.errors import InputError
from spool_monitor.history.state_file import valve_folder
from spool_monitor.history.trend import KEPT, TrendStore, finest, own_file

from .values import rounded

#: Name of the file: `valve_state` has it too, and takes 130 MB of libraries along.
TRENDS = "trends.sqlite"
#: Lengths that can be asked for, s; 0: all there is.
RANGES = {"hour": 3600, "day": 86400, "week": 7 * 86400, "year": 366 * 86400, "all": 0}
#: Points that are sent at most.
MOST_POINTS = 1500
#: Shown where nothing else is asked for.
FIRST = "natural_frequency"
#: s that a reading waits for the monitor's own writing.
PATIENCE = 1.0


def trend_of(base: Path, valve: str, parameter: str, length: str) -> dict[str, Any]:
    """Return the trend of a parameter of ``valve``, or of ``FIRST`` where ``parameter`` is empty.

    Args:
        base: the monitors' ``state_folder``.
        valve: namespace.
        parameter: name.
        length: one of ``RANGES``.

    Raises:
        InputError: there is none, or the file is damaged.
        OSError: it can't be read.
    """
    path = own_file(valve_folder(base, valve) / TRENDS, PATIENCE)
    store = TrendStore(path, read_only=True, patience=PATIENCE)
    try:
        units = store.units()
        name = parameter or (FIRST if FIRST in units else next(iter(units), ""))
        if name not in units:
            raise InputError(f"{valve}: no trend of that name is kept")
        now = int(time.time())
        since = now - RANGES[length] if RANGES[length] else 0
        hours = store.spans(name, 3600, since - since % 3600)
        duration = now - since if since else (now - hours[0].start if hours else 0)
        seconds = finest(KEPT, duration, MOST_POINTS)
        spans = store.spans(name, seconds, since - since % seconds)[-MOST_POINTS:]
    finally:
        store.close()
    return {
        "parameters": list(units),
        "parameter": name,
        "unit": units[name],
        "seconds": seconds,
        "from": since or None,
        "until": now,
        "start": [span.start for span in spans],
        "minimum": [rounded(span.minimum) for span in spans],
        "mean": [rounded(span.mean) for span in spans],
        "maximum": [rounded(span.maximum) for span in spans],
    }
