"""Two clocks brought together: body and spool, sampled apart, on the grid of the slower one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.alignment.aligner import margin, resampled
from spool_core.errors import InputError

from spool_bag.importing.tables.table import MOST_SAMPLES

from .clocks import ClockOffset

#: Relative difference of the rates up to which they are one nominal rate, as the live adapter has it.
SAME_RATE = 0.03
#: Rounds in which the remaining delay is taken off; and what is left of it, in samples and relative, once it
#: has settled: a fit takes both channels to be sampled together to a hundredth of a period.
ROUNDS, SETTLED, SETTLED_DRIFT = 4, 0.005, 2e-7
#: Samples that are interpolated at a time: 64 MB of weights.
_PIECE = 1 << 17

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Series:
    """Series of a sensor on its own clock: ``time`` in s, shape (n,); the rest as of a record."""

    label: str
    time: Array
    values: Array
    period: float
    gaps: NDArray[np.int64]
    start: int | None


@dataclass(slots=True)
class Merged:
    """Merged series: both on one grid, as a record has it; ``note`` says how, ``clocks`` by what."""

    time: Array
    body: Array
    spool: Array
    period: float
    gaps: NDArray[np.int64]
    start: int | None
    note: str
    clocks: ClockOffset | None
    warnings: list[str] = field(default_factory=list)


def merged(body: Series, spool: Series, *, shared_clock: bool) -> Merged:
    """Return both series on the grid of the slower one, the body's where they are alike.

    Args:
        body: on its clock, which is the record's.
        spool: on another one.
        shared_clock: the stamps of both are of one clock, and are taken as they are.

    Raises:
        InputError: they do not overlap, or their clocks cannot be told.
    """
    first, second = _filled(body), _filled(spool)
    if shared_clock:
        shift = ((body.start or 0) - (spool.start or 0)) * 1e-9 + float(body.time[0] - spool.time[0])
        note = "body and spool are stamped by one clock: they are brought to the same instants"
        return _joined(body, spool, (first, second), (shift, 0.0), note, None)
    from .clock_offset import clock_offset  # noqa: PLC0415 - 100 MB of SciPy and fits that one clock does not need
    from .friction_delay import remaining_delay  # noqa: PLC0415

    label = f"{body.label} and {spool.label}"
    found = clock_offset(first, body.period, second, spool.period, label)
    for _ in range(ROUNDS):
        line = found.offset, found.drift
        aligned = _joined(body, spool, (first, second), line, "", None)
        left = remaining_delay(
            aligned.time - float(body.time[0]),
            aligned.body,
            aligned.spool,
            aligned.period,
            aligned.gaps.tolist(),
            found.natural_frequency,
        )
        if left is None:
            break
        found = replace(
            found,
            offset=found.offset + left.offset,
            offset_std=left.offset_std,
            drift=found.drift + left.drift,
            drift_std=left.drift_std,
        )
        if abs(left.offset) < SETTLED * body.period and abs(left.drift) < SETTLED_DRIFT:
            break
    # As the clocks of the files show it, which do not begin at 0 by themselves.
    shown = float(spool.time[0] - body.time[0])
    if body.start is not None and spool.start is not None:
        shown += (spool.start - body.start) * 1e-9
    told = replace(found, offset=found.offset + shown)
    note = f"two clocks, by cross-correlation: {told}"
    return _joined(body, spool, (first, second), (found.offset, found.drift), note, told)


def _joined(
    body: Series,
    spool: Series,
    filled: tuple[Array, Array],
    line: tuple[float, float],
    note: str,
    clocks: ClockOffset | None,
) -> Merged:
    """Return both series on one grid, by the line of the spool's clock from its first sample.

    Raises:
        InputError: they do not overlap.
    """
    first, second = filled
    offset, drift = line
    slower = spool.period > body.period * (1.0 + SAME_RATE)
    if slower:
        grid = np.arange(second.size, dtype=np.float64)
        times = np.asarray((spool.period * grid - offset) / (1.0 + drift), dtype=np.float64)
        values = {"spool": second, "body": _resampled(first, times / body.period, spool.period / body.period)}
        period = spool.period / (1.0 + drift)
    else:
        times = np.asarray(body.period * np.arange(first.size), dtype=np.float64)
        places = np.asarray(((1.0 + drift) * times + offset) / spool.period)
        values = {"body": first, "spool": _resampled(second, places, body.period / spool.period)}
        period = body.period
    kept = np.flatnonzero(np.isfinite(values["body"]) & np.isfinite(values["spool"]))
    if kept.size < 3:
        raise InputError(f"{body.label} and {spool.label}: body and spool do not overlap in time")
    gaps = np.flatnonzero(np.diff(kept) > 1) + 1
    return Merged(
        times[kept] + float(body.time[0]),
        values["body"][kept],
        values["spool"][kept],
        period,
        gaps.astype(np.int64),
        body.start,
        f"{note}; grid of {1.0 / period:.6g} Hz, that of the {'spool' if slower else 'body'}",
        clocks,
    )


def _filled(series: Series) -> Array:
    """Return the samples by their number since the first one, NaN where they are missing."""
    number = np.rint((series.time - series.time[0]) / series.period).astype(np.int64)
    if not series.gaps.size:
        return np.asarray(series.values, dtype=np.float64)
    size = int(number[-1]) + 1
    if size > MOST_SAMPLES:
        raise InputError(f"{series.label}: its gaps are {size} samples long in all: split the file there")
    filled = np.full(size, math.nan)
    filled[number] = series.values
    return filled


def _resampled(row: Array, places: Array, ratio: float) -> Array:
    """Return ``row`` at ``places`` (sample numbers as real numbers); NaN where samples are missing."""
    ratio = 1.0 if abs(ratio - 1.0) <= SAME_RATE else ratio
    edge = margin(ratio)
    found = np.full(places.size, math.nan)
    inside = np.flatnonzero((places >= -0.25) & (places <= row.size - 0.75))
    padded = np.concatenate([np.full(edge, math.nan), row, np.full(edge, math.nan)])
    values: Callable[[NDArray[np.int64]], Array] = lambda at: np.asarray(padded[at + edge])  # noqa: E731
    for first in range(0, inside.size, _PIECE):
        part = inside[first : first + _PIECE]
        found[part] = resampled(values, places[part], ratio)
    return found
