"""Arrays of a file as channels: which of them belong to one clock, and the rate stated beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from spool_stream.errors import InputError

from spool_import.units.header import split_header

from .table import MOST_CHANNELS, STAMP, ArrayTable, Channel, Group

#: Names of a number beside the channels that states their rate (Hz) or period (s).
RATES = (
    "fs",
    "f_s",
    "samplerate",
    "sample_rate",
    "samplingrate",
    "sampling_rate",
    "rate",
    "rate_hz",
    "fs_hz",
)
PERIODS = ("dt", "ts", "t_s", "delta_t", "sample_period", "sampleinterval", "sample_interval", "period")
#: Samples from which a row is a record; shorter ones are settings.
SHORTEST = 3


def stated_rate(settings: Mapping[str, Any]) -> float:
    """Return the rate (Hz) that numbers beside the channels state, NaN where none does."""
    plain = {
        str(name).lower().rpartition("/")[2].replace(" ", "_"): value for name, value in settings.items()
    }
    for names, power in ((RATES, 1.0), (PERIODS, -1.0)):
        for name in names:
            value = plain.get(name)
            try:
                number = float(np.asarray(value).reshape(-1)[0]) if value is not None else math.nan
            except (TypeError, ValueError, IndexError):
                continue
            if math.isfinite(number) and number > 0.0:
                return float(number**power)
    return math.nan


def array_table(
    path: Path,
    arrays: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> ArrayTable:
    """Return the table of named arrays: those of one length share a clock.

    Args:
        path: of the file.
        arrays: rows, and matrices whose columns are channels, or whose rows are where these are longer.
        units: by the arrays' names, where the file states them.
        settings: numbers beside them.

    Raises:
        InputError: there is no row of numbers.
    """
    rows: dict[str, Any] = {}
    for name, value in arrays.items():
        for key, row in _rows(name, np.asarray(value)):
            if row.size >= SHORTEST and row.dtype.kind in "fiubM":
                rows[key] = row
    if not rows:
        raise InputError(f"{path}: no row of at least {SHORTEST} numbers in it")
    if len(rows) > MOST_CHANNELS:
        raise InputError(f"{path}: {len(rows)} channels, more than {MOST_CHANNELS}")
    rate = stated_rate(
        {**(settings or {}), **{key: value for key, value in arrays.items() if np.size(value) == 1}}
    )
    by_size: dict[int, list[str]] = {}
    for name, row in rows.items():
        by_size.setdefault(row.size, []).append(name)
    several = len(by_size) > 1
    groups, kept = [], {}
    for size, names in by_size.items():
        group = f"{size} samples" if several else ""
        channels = []
        for name in names:
            dated = rows[name].dtype.kind == "M"
            unit = STAMP if dated else (units or {}).get(name, "") or split_header(name.rpartition("/")[2])[1]
            channels.append(Channel(name, unit, time=dated))
            kept[group, name] = rows[name]
        groups.append(Group(group, tuple(channels), rate))
    return ArrayTable(path, tuple(groups), kept)


def _rows(name: str, value: Any) -> list[tuple[str, Any]]:
    """Return the rows of an array by name: itself, its fields, or the columns of a matrix."""
    if value.dtype.names:
        return [pair for part in value.dtype.names for pair in _rows(f"{name}/{part}", value[part])]
    value = value.squeeze()
    if value.ndim == 1:
        return [(name, value)]
    if value.ndim != 2:
        return []
    columns = value.T if value.shape[0] >= value.shape[1] else value
    return [(f"{name}/{at}", column) for at, column in enumerate(columns[:MOST_CHANNELS])]
