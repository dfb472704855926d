"""Speed of a shaft from the pulses of a tacho that was sampled beside the accelerations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.text import plural

#: Distance of the two levels over the deviation within them, from which a channel has pulses. Split at their
#: mean, Gaussian noise has 2.65 (1.60 over 0.60), evenly spread values 3.46, a sine 4.14.
PULSED = 3.0
#: Samples between pulses, at least: fewer alias, or leave no low sample between two high ones.
DENSEST = 4.0
#: Pulses that may be missing in a row for their places to be filled in; a longer pause is one of the shaft.
MOST_MISSING = 3
#: Intervals that one is compared with, and its deviation in them: missing from 1.5 on, double below 0.5.
BESIDE, OFF = 9, 0.25
#: s that a speed is averaged over, at least; rounded up to whole revolutions, in which uneven teeth cancel.
SPAN = 0.1


@dataclass(frozen=True, slots=True)
class TachoSpeed:
    """Speed from pulses.

    Attributes:
        rpm: rev/min, shape (n,), NaN where unknown.
        pulses: that were found.
        repairs: counts of those that were filled in and left out.
        warnings: what was repaired, one line each.
    """

    rpm: Array
    pulses: int
    repairs: dict[str, int]
    warnings: list[str]

    def __str__(self) -> str:
        """Counts, for people."""
        slow, fast = np.nanmin(self.rpm), np.nanmax(self.rpm)
        return f"{plural(self.pulses, 'tacho pulse')}, speed {slow:.1f} to {fast:.1f} rev/min"


def speed_from_pulses(
    signal: Array, time: Array, gaps: NDArray[np.int64], per_revolution: int, where: str
) -> TachoSpeed:
    """Return the speed of the shaft at each sample.

    Rising edges are found with hysteresis, at a third and two thirds between the two levels of the signal
    (Otsu, IEEE Trans. SMC 9, 1979), and placed where it crosses the middle.

    Args:
        signal: of the tacho, in any unit, shape (n,); NaN where it was not read.
        time: s, shape (n,).
        gaps: index of each first sample after a gap.
        per_revolution: pulses.
        where: for errors: file and channel.

    Raises:
        InputError: it has no pulses, or they are too few or too dense.
    """
    low, high = _levels(signal, where)
    rising = _edges(signal, time, low, high)
    period = float(np.median(np.diff(time)))
    speed = np.full(time.size, np.nan)
    found = missing = double = pauses = 0
    for first, end in pairwise([0, *gaps.tolist(), time.size]):
        part = slice(first, end)
        inside = rising[(rising >= time[first]) & (rising <= time[end - 1])]
        found += inside.size
        kept, of_missing, of_double = _repaired(inside)
        missing, double, pauses = missing + of_missing, double + of_double, pauses + max(0, len(kept) - 1)
        for run in kept:
            if run.size <= per_revolution:
                continue
            every = float(np.median(np.diff(run)))
            if every < DENSEST * period:
                raise InputError(
                    f"{where}: pulses every {every / period:.1f} samples are too dense for "
                    f"{1.0 / period:.6g} Hz: sample faster, divide the pulses, or record the speed in rev/min"
                )
            turns = min(math.ceil(SPAN / (every * per_revolution)), (run.size - 1) // per_revolution)
            step = turns * per_revolution
            rpm = 60.0 * turns / (run[step:] - run[:-step])
            at = time[part]
            known = (at >= run[0]) & (at <= run[-1])
            speed[part][known] = np.interp(at[known], 0.5 * (run[step:] + run[:-step]), rpm)
    if not np.isfinite(speed).any():
        raise InputError(
            f"{where}: {plural(found, 'pulse')} in it, fewer than one revolution of {per_revolution}: name "
            "another column, or correct --pulses-per-revolution"
        )
    warnings = [
        f"tacho: {plural(count, noun)} {done}"
        for count, noun, done in (
            (missing, "missing pulse", "filled in"),
            (double, "double pulse", "left out"),
            (pauses, "pause", f"of more than {MOST_MISSING} pulses: no speed there"),
        )
        if count
    ]
    return TachoSpeed(speed, found, {"tacho_missing": missing, "tacho_double": double}, warnings)


def _levels(signal: Array, where: str) -> tuple[float, float]:
    """Return the means of the low and the high samples, split where they differ most."""
    ordered = np.sort(signal[np.isfinite(signal)].astype(np.float64))
    if ordered.size < 2 or ordered[0] == ordered[-1]:
        raise InputError(f"{where}: it is constant, no tacho pulses: name another column with --columns")
    below = np.arange(1, ordered.size)
    sums = np.cumsum(ordered)
    lower, upper = sums[:-1] / below, (sums[-1] - sums[:-1]) / (ordered.size - below)
    at = int(np.argmax(below * (ordered.size - below) * (upper - lower) ** 2))
    parts = ordered[: at + 1], ordered[at + 1 :]
    within = math.sqrt(sum(part.size * float(part.var()) for part in parts) / ordered.size)
    low, high = float(lower[at]), float(upper[at])
    if high - low < PULSED * within:
        raise InputError(
            f"{where}: it has no two levels, no tacho pulses: name another column with --columns"
        )
    return low, high


def _edges(signal: Array, time: Array, low: float, high: float) -> Array:
    """Return the times (s) of the rising edges."""
    third = (high - low) / 3.0
    state = np.where(signal >= high - third, 1, np.where(signal <= low + third, -1, 0))
    known = np.flatnonzero(state)
    ups = known[1:][(state[known][1:] == 1) & (state[known][:-1] == -1)]
    middle = 0.5 * (low + high)
    crossed = np.flatnonzero((signal[:-1] < middle) & (signal[1:] >= middle))
    if not crossed.size:
        return np.zeros(0)
    at = crossed[np.maximum(np.searchsorted(crossed, ups) - 1, 0)]
    share = (middle - signal[at]) / (signal[at + 1] - signal[at])
    return np.asarray(time[at] + share * (time[at + 1] - time[at]), dtype=np.float64)


def _repaired(pulses: Array) -> tuple[list[Array], int, int]:
    """Return the runs of pulses (s) between pauses, and how many were filled in and left out."""
    from scipy.ndimage import median_filter  # noqa: PLC0415 - who only needs the bag's speed needs no scipy

    if pulses.size < 3:
        return [pulses], 0, 0
    usual = median_filter(np.diff(pulses), BESIDE, mode="nearest")
    runs: list[list[float]] = [[float(pulses[0])]]
    missing = double = 0
    for pulse, interval in zip(pulses[1:].tolist(), usual.tolist(), strict=True):
        run = runs[-1]
        count = (pulse - run[-1]) / interval
        whole = round(count)
        if count < 0.5:
            double += 1
        elif whole <= 1:
            run.append(pulse)
        elif whole <= MOST_MISSING + 1 and abs(count - whole) < OFF:
            missing += whole - 1
            run += np.linspace(run[-1], pulse, whole + 1)[1:].tolist()
        else:
            runs.append([pulse])
    return [np.array(run) for run in runs], missing, double
