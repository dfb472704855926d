"""Time base of a record: sampling period, gaps, repeated rows and stamps that jitter."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from spool_stream.errors import InputError

#: Periods: a longer step is a gap, one missing sample makes two; a sample further off its place is no
#: rounding of printed times.
GAP = 1.5
JITTER = 0.25
#: Correlation of a step with the next one below which stamps jitter about a regular clock: errors of stamps
#: give -1/2, samples that truly come at irregular times 0 (the first difference of white noise).
STAMP_NOISE = -0.3
#: Standard deviations of the steps that one of them may be off: beyond, rows were exchanged or a clock set.
JITTER_REACH = 6.0
#: Samples on each side of a long step by which a loss is told from a late stamp.
BESIDE = 50
#: Share of rows that may repeat the one before: more is no slip of a logger.
MOST_REPEATED = 0.05
_PIECE = 1 << 20

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(slots=True)
class TimeBase:
    """Time base: ``time`` in s, shape (n,), ``period`` in s, ``gaps``: indices of first samples after one.

    ``kept``: rows that are kept, ``None`` for all. ``warnings``: one line each; ``repairs``: counts by name.
    """

    time: Array
    period: float
    gaps: Indices
    kept: NDArray[np.bool_] | None = None
    warnings: list[str] = field(default_factory=list)
    repairs: dict[str, int] = field(default_factory=dict)


def time_base(
    label: str, name: str, time: Array, rows: Sequence[NDArray[np.floating]], where: Callable[[int], str]
) -> TimeBase:
    """Return the time base of samples at ``time`` (s, shape (n,)).

    Rows that repeat the one before, time and values, are left out; coarse or jittering stamps of a regular
    clock are replaced by a line through them.

    Args:
        label: of the file, for messages.
        name: of the time axis.
        time: s, as the file has it.
        rows: the channels' values, to tell repeated rows.
        where: where a row stands.

    Raises:
        InputError: too few samples, time that goes back, or samples that come at irregular times.
    """
    if time.size < 3:
        raise InputError(f"{label}: {time.size} samples are too few for a record")
    kept, repairs, warnings = None, {}, []
    back = _first(time, lambda steps: steps <= 0.0)
    if back is not None:
        kept = _without_repeats(time, rows)
        repeated = time.size - int(np.count_nonzero(kept))
        if 0 < repeated <= MOST_REPEATED * time.size:
            time = time[kept]
            repairs["repeated_rows"] = repeated
            warnings.append(f"{repeated} rows repeat the one before: left out")
        else:
            kept = None
        back = _first(time, lambda steps: steps <= 0.0)
    if back is not None:
        found = _coarse(time)
        usual = _median_step(time)
        placed = _placed(time, usual) if found is None and _back_by_jitter(time, usual) else None
        if placed is not None:
            return _on_its_line(name, time, placed, where, kept, repairs, warnings)
        if found is None:
            raise InputError(f"{label}: {where(back + 1)}: {name} does not increase ({time[back + 1]:g} s)")
        quantum, period = found
        warnings.append(
            f"{name} has steps of {quantum:g} s, coarser than the samples: they are placed on a line"
        )
        repairs["placed_on_a_line"] = int(time.size)
        count = np.arange(time.size, dtype=np.float64) - 0.5 * (time.size - 1)
        line = np.asarray(float(time.mean()) + period * count, dtype=np.float64)
        return TimeBase(line, period, np.empty(0, np.int64), kept, warnings, repairs)
    found_base = _increasing(label, name, time, where)
    found_base.kept = kept
    found_base.warnings = warnings + found_base.warnings
    found_base.repairs = repairs | found_base.repairs
    return found_base


def _increasing(label: str, name: str, time: Array, where: Callable[[int], str]) -> TimeBase:
    usual = _median_step(time)
    gaps = _where(time, lambda steps: steps > GAP * usual) + 1
    regular = time.size - 1 - gaps.size
    if regular < 2:
        raise InputError(f"{label}: {name} is not sampled regularly: resample it to a constant period")
    lost = float(np.sum(time[gaps] - time[gaps - 1])) if gaps.size else 0.0
    low, high = _extremes(time, GAP * usual)
    period = sampling_period((float(time[-1] - time[0]) - lost) / regular, high - low, regular)
    allowed = JITTER * period + resolution(time)
    if max(high - period, period - low) <= allowed:
        return _with_gaps(name, time, period, gaps, where)
    placed = _placed(time, usual)
    if placed is None:
        at = _first(time, lambda steps: (np.abs(steps - period) > allowed) & (steps <= GAP * usual))
        at = 0 if at is None else at
        raise InputError(
            f"{label}: {where(at + 1)}: sampling is irregular, a step of {time[at + 1] - time[at]:g} s where "
            f"{period:g} s is usual: resample it to a constant period"
        )
    return _on_its_line(name, time, placed, where, None, {}, [])


def _on_its_line(
    name: str,
    time: Array,
    placed: tuple[Array, float, Indices],
    where: Callable[[int], str],
    kept: NDArray[np.bool_] | None,
    repairs: dict[str, int],
    warnings: list[str],
) -> TimeBase:
    """Return the time base of stamps that jitter, by the line through them."""
    line, period, gaps = placed
    deviation = float(np.sqrt(np.mean(np.square(time - line))))
    base = _with_gaps(name, line, period, gaps, where)
    text = f"{name} jitters by {deviation:.3g} s (rms) about a regular clock: placed on its line"
    base.warnings = [*warnings, *base.warnings, text]
    base.repairs = repairs | base.repairs | {"jitter_placed_on_a_line": int(time.size)}
    base.kept = kept
    return base


def _with_gaps(name: str, time: Array, period: float, gaps: Indices, where: Callable[[int], str]) -> TimeBase:
    base = TimeBase(time, period, gaps.astype(np.int64))
    if gaps.size:
        missing = float(np.sum(time[gaps] - time[gaps - 1] - period))
        base.warnings.append(
            f"{gaps.size} gaps in {name}, {missing:g} s missing; first at {where(int(gaps[0]))}"
        )
        base.repairs["gaps"] = int(gaps.size)
    return base


def loose_time_base(label: str, name: str, time: Array, where: Callable[[int], str]) -> TimeBase:
    """Return the time base of samples that may be spaced as they like: median step, gaps ten times that.

    Raises:
        InputError: too few samples, or time that goes back.
    """
    if time.size < 3 or _first(time, lambda steps: steps <= 0.0) is not None:
        return time_base(label, name, time, (), where)  # says what is wrong
    steps = np.diff(time)
    period = float(np.median(steps))
    gaps = np.flatnonzero(steps > 10.0 * period) + 1
    base = TimeBase(time, period, gaps.astype(np.int64))
    if gaps.size:
        base.warnings.append(f"{gaps.size} gaps in {name}, longer than {10.0 * period:g} s")
    uneven = float(np.quantile(np.abs(steps - period), 0.99))
    if uneven > JITTER * period + resolution(time):
        base.warnings.append(f"{name} is spaced unevenly, by up to {uneven:.3g} s: resampled")
    return base


def sampling_period(mean: float, spread: float, count: int) -> float:
    """Return the period (s) behind ``count`` steps that were printed with few decimals.

    Their ``mean`` (s) is exact to one digit of print over the whole record, ``spread`` is the largest less
    the smallest; the roundest rate in whole Hz, or a period in whole microseconds, within that is what the
    logger was set to.
    """
    tolerance = max(2.0 * spread / count, 1e-7 * mean)
    for digits in (-3, -2, -1, 0):
        rate = round(1.0 / mean, digits)
        if rate > 0.0 and abs(1.0 / rate - mean) <= tolerance:
            return 1.0 / rate
    rounded = round(mean * 1e6) / 1e6
    return rounded if rounded > 0.0 and abs(rounded - mean) <= tolerance else mean


def resolution(time: Array) -> float:
    """Return the last digit (s) in which ``time`` was printed, or that its numbers can hold."""
    probe = time[: min(time.size, 200)]
    finest = max(1e-12, 2.0 * float(np.spacing(np.abs(probe).max())))
    for decimals in range(3, 12):
        if np.allclose(probe, np.round(probe, decimals), rtol=0.0, atol=1e-13):
            return max(float(10.0**-decimals), finest)
    return finest


def _steps(time: Array) -> Iterator[tuple[int, Array]]:
    """Yield the number of the first step and the steps, piece by piece."""
    for first in range(0, time.size - 1, _PIECE):
        yield first, np.diff(time[first : first + _PIECE + 1])


def _first(time: Array, test: Callable[[Array], NDArray[np.bool_]]) -> int | None:
    """Return the number of the first step that passes ``test``."""
    for first, steps in _steps(time):
        found = test(steps)
        if found.any():
            return first + int(np.argmax(found))
    return None


def _where(time: Array, test: Callable[[Array], NDArray[np.bool_]]) -> Indices:
    return np.concatenate([first + np.flatnonzero(test(steps)) for first, steps in _steps(time)])


def _extremes(time: Array, most: float) -> tuple[float, float]:
    """Return the shortest and the longest step up to ``most``."""
    low, high = math.inf, -math.inf
    for _, steps in _steps(time):
        usual = steps[steps <= most]
        if usual.size:
            low, high = min(low, float(usual.min())), max(high, float(usual.max()))
    return low, high


def _median_step(time: Array) -> float:
    """Return the median step; of a long record that of a piece at its beginning, middle and end."""
    starts = {0, max(0, time.size // 2 - _PIECE // 2), max(0, time.size - _PIECE)}
    return float(np.median(np.concatenate([np.diff(time[at : at + _PIECE]) for at in sorted(starts)])))


def _without_repeats(time: Array, rows: Sequence[NDArray[np.floating]]) -> NDArray[np.bool_]:
    """Return which rows do not repeat the one before, time and values."""
    same = np.diff(time) == 0.0
    for row in rows:
        same &= row[1:] == row[:-1]
    return np.concatenate([[True], ~same])


def _back_by_jitter(time: Array, usual: float) -> bool:
    """Return whether times go back no further than the jitter of all their steps explains."""
    steps = np.diff(time)
    usual_error = 1.4826 * float(np.median(np.abs(steps - usual)))
    return float(steps.min()) > usual - JITTER_REACH * usual_error


def _coarse(time: Array) -> tuple[float, float] | None:
    """Return step and period of regular samples whose times were rounded coarsely, ``None`` for others."""
    steps = np.diff(time)
    if (steps < 0.0).any() or not (steps > 0.0).any():
        return None
    quantum = float(np.min(steps[steps > 0.0]))
    count = np.arange(time.size) - 0.5 * (time.size - 1)
    period = float(count @ (time - time[0])) / float(count @ count)
    off = time - time[0] - period * count
    return (
        (quantum, period)
        if float(np.ptp(off)) <= 1.5 * quantum and float(steps.max()) <= 1.5 * quantum
        else None
    )


def _placed(time: Array, usual: float) -> tuple[Array, float, Indices] | None:
    """Return the line through jittering stamps, period and gaps; ``None`` where no clock is behind."""
    steps = np.diff(time)
    inner = steps[steps < 3.0 * usual]
    centred = inner - inner.mean()
    power = float(centred @ centred)
    if inner.size < 100 or power == 0.0 or float(centred[1:] @ centred[:-1]) / power > STAMP_NOISE:
        return None
    period = float(np.median((time[BESIDE:] - time[:-BESIDE]) / BESIDE))
    phase = time - period * np.arange(time.size)
    gaps = []
    long = np.flatnonzero(steps > GAP * period) + 1
    # The longest first: what it explains is taken off before its neighbours are judged.
    for at in long[np.argsort(-steps[long - 1])]:
        before, after = phase[max(0, at - BESIDE) : at], phase[at : at + BESIDE]
        missing = round(float(np.median(after) - np.median(before)) / period)
        if missing >= 1:
            gaps.append(int(at))
            phase[at:] -= missing * period
    gaps.sort()
    edges = [0, *gaps, time.size]
    line, fitted, samples = np.empty_like(time), 0.0, 0
    for begin, end in pairwise(edges):
        count = np.arange(end - begin) - 0.5 * (end - begin - 1)
        slope = (
            float(count @ time[begin:end]) / max(float(count @ count), 1e-300)
            if end - begin > 10 * BESIDE
            else period
        )
        line[begin:end] = float(time[begin:end].mean()) + slope * count
        fitted += slope * (end - begin)
        samples += end - begin
    # A line through jitter cannot be surer than the jitter: half a period off is another clock.
    if float(np.quantile(np.abs(time - line), 0.999)) > 5.0 * period:
        return None
    return line, fitted / samples, np.asarray(gaps, dtype=np.int64)
