"""Clocks of a record: two files with a clock each, and the clocks of a bag's messages.

Drivers set the clock of one sensor after a resynchronisation. The stamps of that topic then step against
those of the other one. Lost messages leave a step of whole periods; times of reception then show whether a
clock was set. Those times alone make no step: they are late, and messages come in lumps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from spool_core import sensor_clock as live
from spool_core.aligner import margin, rate_ratio, resampled
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.stamps import JITTER, Indices, Rhythm, Stamps, judge_stamps, unpaired
from spool_core.text import printable

from spool_bag.importing.table import MOST_SAMPLES
from spool_bag.importing.time_axis import ClockOffset

#: Rounds in which the remaining delay is taken off; and its remainder, in samples and relative, once it
#: has settled: a fit takes both channels to be sampled together to a hundredth of a period.
ROUNDS, SETTLED, SETTLED_DRIFT = 4, 0.005, 2e-7
#: Samples that are interpolated at a time: 64 MB of weights.
_PIECE = 1 << 17


#: s by which two clocks may run apart over a record before that is a warning.
WANDERS = 1e-3
#: Chunks beside a step that its size is averaged over, and their least number.
BESIDE, FEWEST = 10, 2
#: Share of the steps that are regular where a clock was set a few times, and nothing else is wrong.
REGULAR = 0.9


@dataclass(frozen=True, slots=True)
class Series:
    """Series of a sensor on its own clock: ``time`` in s, shape (n,); the rest as of a record."""

    label: str
    time: Array
    values: Array
    period: float
    gaps: Indices
    start: int | None


@dataclass(frozen=True, slots=True)
class Merged:
    """Both on one grid, as a record has it; ``note`` says how, ``clocks`` by what."""

    time: Array
    body: Array
    spool: Array
    period: float
    gaps: Indices
    start: int | None
    note: str
    clocks: ClockOffset | None = None


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
        joined = _joined(body, spool, (first, second), (shift, 0.0))
        text = "body and spool are stamped by one clock: they are brought to the same instants"
        return replace(joined, note=f"{text}; {joined.note}")
    from spool_bag.importing.clock_offset import clock_offset, refined  # noqa: PLC0415 - 100 MB of SciPy and fits that one clock does not need

    found = clock_offset(first, body.period, second, spool.period, f"{body.label} and {spool.label}")
    for _ in range(ROUNDS):
        aligned = _joined(body, spool, (first, second), (found.offset, found.drift))
        time, gaps = aligned.time - float(body.time[0]), aligned.gaps.tolist()
        better = refined(found, time, aligned.body, aligned.spool, aligned.period, gaps)
        if better is None:
            break
        left, drift = better.offset - found.offset, better.drift - found.drift
        found = better
        if abs(left) < SETTLED * body.period and abs(drift) < SETTLED_DRIFT:
            break
    # As the clocks of the files show it, which do not begin at 0 by themselves.
    shown = float(spool.time[0] - body.time[0])
    if body.start is not None and spool.start is not None:
        shown += (spool.start - body.start) * 1e-9
    told = replace(found, offset=found.offset + shown)
    joined = _joined(body, spool, (first, second), (found.offset, found.drift))
    return replace(joined, note=f"two clocks, by cross-correlation: {told}; {joined.note}", clocks=told)


class TopicTimes(NamedTuple):
    """Times of a topic: header stamps and times of reception, ns, shape (n,) each, in order of the stamps."""

    name: str
    stamps: Indices
    received: Indices


def check_one_time(path: Path, body: TopicTimes, spool: TopicTimes) -> list[str]:
    """Check that the stamps of both topics are those of one time; return warnings, one line each.

    Raises:
        InputError: they never overlap, come in different packets, or one clock was set in between.
    """
    names = f"{printable(body.name, 60)} and {printable(spool.name, 60)}"
    if body.stamps[0] > spool.stamps[-1] or spool.stamps[0] > body.stamps[-1]:
        raise InputError(
            f"{path}: header stamps of {names} never overlap (they begin at {1e-9 * body.stamps[0]:.3f} and "
            f"{1e-9 * spool.stamps[0]:.3f} s): type --stamps log to use the times of reception"
        )
    found = judge_stamps(body.stamps), judge_stamps(spool.stamps)
    places, lag = _apart(body, spool)
    step = None
    if lag.size > live.SPAN:
        step = _received_step(body, spool, found, places, lag) or _step(*_phases(body, spool, found, places))
    if step is not None:
        at, by = step
        seconds = float(places[at]) * live.CHUNK
        raise InputError(
            f"{path}: the clock of one of {names} was set by {1e3 * abs(by):.3g} ms at about {seconds:.1f} "
            "s: which samples belong together is unknown; record again with synchronised clocks, or type "
            "--stamps log to use the times of reception"
        )
    reason = unpaired((body.name, spool.name), found, (body.stamps, spool.stamps))
    if reason:
        raise InputError(
            f"{path}: {printable(reason, 300)}; or type --stamps log to use the times of reception"
        )
    if lag.size <= live.SPAN + 1:
        return []
    ends = [float(np.median(part)) for part in (lag[:BESIDE], lag[-BESIDE:])]
    gained = abs(ends[1] - ends[0]) * 1e-9
    # Lumps that beat with the samples shift the mean by up to a period, for seconds.
    late = max(min(2.0 * _late(one), float(np.median(np.diff(one.stamps)))) for one in (body, spool))
    if gained > WANDERS + 1e-9 * max(live.CERTAIN * live.usual_change(lag), late):
        return [f"the clocks of {names} ran apart by {1e3 * gained:.3g} ms, as the times of reception show"]
    return []


def _joined(body: Series, spool: Series, filled: tuple[Array, Array], line: tuple[float, float]) -> Merged:
    """Return both series on one grid, by the line of the spool's clock from its first sample.

    Raises:
        InputError: they do not overlap.
    """
    first, second = filled
    offset, drift = line
    ratio = rate_ratio(spool.period, body.period)
    slower = ratio > 1.0
    if slower:
        times = np.asarray((spool.period * np.arange(second.size) - offset) / (1.0 + drift))
        values = {"spool": second, "body": _resampled(first, times / body.period, ratio)}
        period = spool.period / (1.0 + drift)
    else:
        times = np.asarray(body.period * np.arange(first.size))
        places = np.asarray(((1.0 + drift) * times + offset) / spool.period)
        values = {"body": first, "spool": _resampled(second, places, rate_ratio(body.period, spool.period))}
        period = body.period
    kept = np.flatnonzero(np.isfinite(values["body"]) & np.isfinite(values["spool"]))
    if kept.size < 3:
        raise InputError(f"{body.label} and {spool.label}: body and spool do not overlap in time")
    return Merged(
        times[kept] + float(body.time[0]),
        values["body"][kept],
        values["spool"][kept],
        period,
        (np.flatnonzero(np.diff(kept) > 1) + 1).astype(np.int64),
        body.start,
        f"grid of {1.0 / period:.6g} Hz, that of the {'spool' if slower else 'body'}",
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
    edge = margin(ratio)
    padded = np.pad(row, edge, constant_values=math.nan)
    pieces = np.array_split(places, 1 + places.size // _PIECE)
    return np.concatenate(
        [resampled(lambda at: padded.take(at + edge, mode="clip"), piece, ratio) for piece in pieces]
    )


def _apart(body: TopicTimes, spool: TopicTimes) -> tuple[Indices, Array]:
    """Return chunks (of ``CHUNK`` s of reception) and by how much the body's stamps lead in each, ns."""
    begin = min(int(body.received[0]), int(spool.received[0]))
    means = [
        _means(one.received - begin, (one.stamps - one.stamps[0]) - (one.received - one.received[0]))
        for one in (body, spool)
    ]
    places = np.intersect1d(means[0][0], means[1][0])
    first, second = (mean[np.searchsorted(at, places)] for at, mean in means)
    return places, np.asarray(first - second, dtype=np.float64)


def _received_step(
    body: TopicTimes, spool: TopicTimes, found: tuple[Stamps, Stamps], places: Indices, lag: Array
) -> tuple[int, float] | None:
    """Return the chunk where stamps step most against the times of reception, and by how much (s).

    Only chunks count in which a topic's stamps go on elsewhere. ``None`` where reception explains the rest.
    """
    begin = min(int(body.received[0]), int(spool.received[0]))
    moved = np.zeros(places.size, dtype=np.bool_)
    spread, least = 0.0, math.inf
    for one, shown in zip((body, spool), found, strict=True):
        order = np.argsort(one.received, kind="stable")
        stamps, received = one.stamps[order], one.received[order] - begin
        steps = np.diff(stamps).astype(np.float64)
        period = 1e9 * shown.period if shown.rhythm is Rhythm.EVEN else float(np.median(steps))
        breaks = np.flatnonzero(np.abs(steps - period) > 0.5 * period) + 1
        moved |= np.isin(places, received[breaks] // round(1e9 * live.CHUNK))
        spread = math.hypot(spread, _late(one))
        grid = shown.rhythm in (Rhythm.COARSE, Rhythm.BURSTS)
        # Steps of parts of a period show in the stamps (:func:`_phases`).
        drift = live.SLEW * 1e9 * live.CHUNK * (BESIDE + FEWEST)
        least = min(least, live.LEAST_STEP + drift if grid else 0.5 * period)
    # Not beside a break: there the other clock may have been set as well, and is seen a little later.
    calm = ~np.convolve(moved, np.ones(3), "same").astype(np.bool_)
    if 2 * np.count_nonzero(calm) < calm.size:
        calm[:] = True
    usual = live.LAG_CERTAIN * live.usual_change(lag)
    best: tuple[int, float] | None = None
    for at in np.flatnonzero(moved).tolist():
        before, after = lag[:at][calm[:at]][-BESIDE:], lag[at + 1 :][calm[at + 1 :]][:BESIDE]
        count = min(before.size, after.size)
        if count < FEWEST:
            continue
        change = float(after.mean() - before.mean())
        error = math.hypot(usual / math.sqrt(count), live.lump_error(spread, count * live.CHUNK))
        if abs(change) > max(least, error) and (best is None or abs(change) > 1e9 * abs(best[1])):
            best = at, 1e-9 * change
    return best


def _late(one: TopicTimes) -> float:
    """Return the standard deviation (ns) of the times of reception about the stamps within a chunk."""
    lag = (one.stamps - one.stamps[0]) - (one.received - one.received[0])
    time = one.received - one.received.min()
    at, mean = _means(time, lag)
    return float(np.std(lag - mean[np.searchsorted(at, time // round(1e9 * live.CHUNK))]))


def _phases(
    body: TopicTimes, spool: TopicTimes, found: tuple[Stamps, Stamps], places: Indices
) -> tuple[Array, float]:
    """Return by how much (ns) the body's stamps lead the spool's in each chunk, and the shorter period (ns).

    Whole periods are left out. There is no chunk where there is no regular period.

    No sample that is lost changes it: a step of it is one of a clock, also where a bag's times of reception
    are copies of the stamps.
    """
    rows, periods = [], []
    begin = min(int(body.received[0]), int(spool.received[0]))
    for one, shown in zip((body, spool), found, strict=True):
        steps = np.diff(one.stamps).astype(np.float64)
        period = 1e9 * shown.period
        if shown.rhythm in (Rhythm.UNEVEN, Rhythm.JITTER):
            usual = float(np.median(steps))
            regular = steps[np.abs(steps - usual) <= JITTER * usual]
            period = float(regular.mean()) if regular.size > REGULAR * steps.size else math.nan
        elif shown.rhythm is not Rhythm.EVEN:
            period = math.nan
        if not period > 0.0:
            return np.empty(0), math.nan
        periods.append(period)
        off = np.concatenate([[0.0], np.cumsum(steps - period * np.rint(steps / period))])
        at, mean = _means(one.received - begin, off)
        rows.append(mean[np.searchsorted(at, places)])
    return np.asarray(rows[0] - rows[1], dtype=np.float64), min(periods)


def _means(time: Indices, values: Indices | Array) -> tuple[Indices, Array]:
    """Return the chunks that have values, and the mean of each."""
    chunk = (np.maximum(time, 0) // round(1e9 * live.CHUNK)).astype(np.int64)
    places, inverse, counts = np.unique(chunk, return_inverse=True, return_counts=True)
    return places, np.bincount(inverse, weights=values.astype(np.float64)) / counts


def _step(row: Array, period: float) -> tuple[int, float] | None:
    """Return the chunk of the largest lasting step and its size (s), ``None`` where there is none.

    Whole ``period`` s (ns) are no step: half a period rounds either way.
    """
    if not row.size:
        return None
    limit, lasting = live.step_limit(row, live.CHUNK), live.lasting_moves(row)
    for at in np.argsort(-lasting)[: np.count_nonzero(lasting > limit)].tolist():
        before, after = row[max(0, at - BESIDE) : at + 1], row[at + live.SPAN - 1 : at + live.SPAN + BESIDE]
        by = float(np.median(after) - np.median(before))
        by -= period * round(by / period)
        if abs(by) > limit:
            return at + 1, 1e-9 * by
    return None
