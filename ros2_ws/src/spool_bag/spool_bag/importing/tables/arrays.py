"""Arrays of a file as channels: which of them belong to one clock, and the rate stated beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.units.header import split_header
from spool_bag.importing.units.units import quantity_of

from .table import MOST_CHANNELS, STAMP, ArrayTable, Channel, Group

#: Names of a number that states a sampling rate (+1) or a period (-1), and of one that may as well be the
#: speed of a shaft or an excitation's; `_Hz`, `_kHz`, `_s`, `_ms`, `_us` may follow.
_RATES = dict.fromkeys(
    (
        "fs", "f_s", "sr", "samplerate", "sample_rate", "samplingrate", "sampling_rate", "samp_rate",
        "fsample", "f_sample", "samplefrequency", "sample_frequency", "samplingfrequency",
        "sampling_frequency",
        "sampling_freq", "sample_freq", "samples_per_second", "abtastrate", "abtastfrequenz",
    ),
    1.0,
)  # fmt: skip
_PERIODS = dict.fromkeys(
    (
        "dt", "ts", "t_s", "delta_t", "deltat", "sampleperiod", "sample_period", "samplingperiod",
        "sampling_period", "sampleinterval", "sample_interval", "samplinginterval", "sampling_interval",
        "sampletime", "sample_time", "time_step", "timestep", "abtastzeit",
    ),
    -1.0,
)  # fmt: skip
_SURE = {**_RATES, **_PERIODS}
_DOUBTFUL = {"rate": 1.0, "frequency": 1.0, "freq": 1.0, "period": -1.0}
_SUFFIXES = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Relative difference up to which two settings are one rate.
_SAME = 1e-6
#: Names of time axes.
TIMES = ("t", "time", "zeit", "timestamp", "time_s")
#: Samples from which a row is a record; shorter ones are settings.
SHORTEST = 3


@dataclass(frozen=True, slots=True)
class StatedRate:
    """Rate (Hz) that a setting states for a channel, NaN for none; ``source``: the settings' own names.

    ``doubt``: why none is taken though there are settings, with what to type.
    """

    rate: float = math.nan
    source: str = ""
    doubt: str = ""


def stated_rate(channel: str, settings: Mapping[str, Any]) -> StatedRate:
    """Return the rate that holds for a channel: of the settings nearest to it, else of those elsewhere.

    Args:
        channel: its path, e.g. ``bearing/gs``; settings on the way to it are beside it.
        settings: numbers by their paths, e.g. ``bearing/sr``.
    """
    sure: list[tuple[int, str, float]] = []
    doubtful: list[str] = []
    for path, value in settings.items():
        parent, _, name = path.rpartition("/")
        number = _positive(value)
        plain = name.lower().strip().replace(" ", "_")
        if number is None:
            continue
        power, size = _rate_name(plain, _SURE)
        beside = not parent or channel == parent or channel.startswith(f"{parent}/")
        if power:
            depth = (0 if not parent else 1 + parent.count("/")) if beside else -1
            sure.append((depth, path, float((number * size) ** power)))
        elif _rate_name(plain, _DOUBTFUL)[0] and beside:
            doubtful.append(f"{printable(path, 60)} = {number:.7g}")
    if not sure:
        may_be = f"{' and '.join(doubtful)} may be a sampling rate or not: if it is, type it with --rate"
        return StatedRate(doubt=may_be if doubtful else "")
    nearest = max(depth for depth, _, _ in sure)
    taken = [(path, rate) for depth, path, rate in sure if depth == nearest]
    rate = taken[0][1]
    if any(abs(other / rate - 1.0) > _SAME for _, other in taken):
        said = " and ".join(f"{printable(path, 60)} = {one:.7g} Hz" for path, one in taken[:4])
        return StatedRate(doubt=f"{said} disagree: type the right one, e.g. --rate {rate:.7g}")
    name = taken[0][0].rpartition("/")[2]
    return StatedRate(rate, printable(" and ".join(path for path, _ in taken[:3]), 120) or name)


def _rate_name(name: str, known: Mapping[str, float]) -> tuple[float, float]:
    """Return 1 for a rate's name, -1 for a period's, 0 for others, and the size of the unit in it."""
    if name in known:
        return known[name], 1.0
    base, _, suffix = name.rpartition("_")
    power, size = known.get(base, 0.0), _SUFFIXES.get(suffix, 0.0)
    return (power, size) if power and size and ("hz" in suffix) == (power > 0.0) else (0.0, 1.0)


def _positive(value: Any) -> float | None:
    """Return a setting as a number above 0, ``None`` for others."""
    try:
        held = np.asarray(value).reshape(-1)
        number = float(held[0]) if held.size == 1 else math.nan
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) and number > 0.0 else None


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
        settings: numbers by their paths; arrays of one number are settings as well.

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
    known = {**(settings or {}), **{key: value for key, value in arrays.items() if np.size(value) == 1}}
    by_size: dict[int, list[str]] = {}
    for name, row in rows.items():
        by_size.setdefault(row.size, []).append(name)
    groups: list[Group] = []
    kept: dict[tuple[str, str], Any] = {}
    for size, names in by_size.items():
        channels = {
            name: Channel(
                name,
                STAMP if dated else (units or {}).get(name, "") or split_header(name.rpartition("/")[2])[1],
                time=dated,
            )
            for name in names
            for dated in [rows[name].dtype.kind == "M"]
        }
        stated = {name: stated_rate(name, known) for name in names}
        rates = {
            round(one.rate, 6): one
            for name, one in stated.items()
            if one.rate > 0.0 and not _is_time(channels[name])
        }
        for rate in rates or {0.0: StatedRate()}:
            inside = [
                name
                for name in names
                if len(rates) < 2 or round(stated[name].rate, 6) == rate or _is_time(channels[name])
            ]
            title = f"{size} samples" if len(by_size) > 1 else ""
            title += f"{' ' if title else ''}at {rate:.7g} Hz" if len(rates) > 1 else ""
            of_rate = [stated[name] for name in inside if round(stated[name].rate, 6) == rate]
            sources = dict.fromkeys(one.source for one in of_rate)
            doubts = dict.fromkeys(stated[name].doubt for name in inside if stated[name].doubt)
            groups.append(
                Group(
                    title,
                    tuple(channels[name] for name in inside),
                    of_rate[0].rate if of_rate else math.nan,
                    source=", ".join(sources),
                    doubt="; ".join(doubts),
                )
            )
            kept |= {(title, name): rows[name] for name in inside}
    return ArrayTable(path, tuple(groups), kept)


def _is_time(channel: Channel) -> bool:
    """Return whether a channel may be a time axis, which all channels of its length share."""
    return (
        channel.time
        or quantity_of(channel.unit) == "time"
        or channel.name.rpartition("/")[2].lower() in TIMES
    )


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
