"""Samples of several sensors in one channel: rows of each in turn, or two drivers on one topic."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array
from spool_core.text import printable

#: Most sensors that may take turns, and fewest turns that show it.
MOST, FEWEST = 8, 100
#: Share of the groups of samples that must have one size, and of the power of differences from one sample to
#: the next that is left in those from one turn to the next. One sensor only shows that for a tone near half
#: the sampling rate, where no record can be used.
ALIKE, LEFT = 0.9, 0.1
#: Ratio of the variances of two sensors, and difference of their means over the standard deviation, from
#: which samples that come in groups are those of different sensors.
VARIANCES, MEANS = 2.0, 0.5
#: Relative difference of short and long steps from which stamps come in pairs.
PAIRED = 0.2
#: Samples that are looked at: a quarter of an hour at 1 kHz, and no more memory than that.
PROBED = 1 << 20

Rows = Sequence[NDArray[np.floating]]


def mixed(time: Array, rows: Rows, others: Callable[[], dict[str, Array]]) -> str:
    """Return by what the samples show that several sensors take turns in them, "" where one alone is seen.

    Args:
        time: s, shape (n,), as the file has it.
        rows: values of the channels, shape (n,) each.
        others: gives the other numbers of the file by name, one of which may number the sensors.
    """
    time, rows = time[:PROBED], [row[:PROBED] for row in rows]
    size = _group_size(time)
    if size > 1:
        for name, values in others().items():
            # As many whole numbers as samples share a stamp, in turn.
            kept = values[: values.size // size * size].reshape(-1, size)
            turn = kept[0]
            whole = bool(np.all(np.isfinite(turn)) and np.all(turn == np.rint(turn)))
            if (
                whole
                and np.unique(turn).size == size
                and float(np.mean(np.all(kept == turn, axis=1))) >= ALIKE
            ):
                shown = ", ".join(f"{one:g}" for one in values[:size].tolist())
                return f"each time is there {size} times, and {printable(name, 40)} is {shown} in turn"
    for row in rows:
        if _alternates(row, 2):
            return "the values alternate from sample to sample"
        paired = size or (2 if _in_pairs(time) else 0)
        if paired and (_alternates(row, paired) or _differ(row, paired)):
            return f"samples come in groups of {paired} whose members differ in size"
    return ""


def _group_size(time: Array) -> int:
    """Return how many samples share each stamp, 0 where that is no fixed number from 2 to ``MOST``."""
    begins = np.flatnonzero(np.diff(time, prepend=-math.inf) != 0.0)
    if begins.size < FEWEST:
        return 0
    sizes = np.diff(begins)
    size = int(np.median(sizes))
    return size if 1 < size <= MOST and np.count_nonzero(sizes == size) >= ALIKE * sizes.size else 0


def _in_pairs(time: Array) -> bool:
    """Return whether every other step is the shorter one."""
    steps = np.diff(time)
    if steps.size < 2 * FEWEST:
        return False
    first, second = np.sort(np.array([np.median(steps[0::2]), np.median(steps[1::2])]))
    even, odd = steps[0 : steps.size // 2 * 2 : 2], steps[1 : steps.size // 2 * 2 : 2]
    in_turn = max(np.count_nonzero(even < odd), np.count_nonzero(even > odd))
    return bool(first < (1.0 - PAIRED) * second and in_turn >= ALIKE * even.size)


def _alternates(row: NDArray[np.floating], size: int) -> bool:
    """Return whether values are alike from turn to turn of ``size`` samples, not from sample to sample."""
    if row.size < FEWEST * size:
        return False
    values = row.astype(np.float64, copy=False)
    power = [float(np.mean(np.square(values[lag:] - values[:-lag]))) for lag in range(1, size + 1)]
    return power[-1] < LEFT * min(power[:-1])


def _differ(row: NDArray[np.floating], size: int) -> bool:
    """Return whether the samples at one place of all groups differ in size or mean from those at another."""
    kept = row[: row.size // size * size].astype(np.float64, copy=False).reshape(-1, size)
    spread, level = kept.std(axis=0), kept.mean(axis=0)
    if kept.shape[0] < FEWEST or not float(spread.max()) > 0.0:
        return False
    ratio = float(spread.max()) ** 2 >= VARIANCES * float(spread.min()) ** 2
    return ratio or float(np.ptp(level)) > MEANS * float(spread.max())
