"""Clocks of two topics of a bag: whether the stamps of both belong to one time.

Drivers set the clock of one sensor after a resynchronisation. The stamps of that topic then step against the
times at which the recorder received the messages; lost messages leave a gap in both.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from spool_stream.alignment.step_watch import CERTAIN, CHUNK, LEAST_STEP, MEDIAN_TO_DEVIATION, SLEW, SPAN
from spool_stream.errors import InputError
from spool_stream.stamps import Rhythm, judge_stamps, unpaired
from spool_stream.text.printable import printable

#: s by which two clocks may run apart over a record before that is a warning.
WANDERS = 1e-3
#: Chunks beside a step that its size is averaged over.
BESIDE = 10

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


class TopicTimes(NamedTuple):
    """Times of a topic: header stamps and times of reception, ns, shape (n,) each, in order of the stamps."""

    name: str
    stamps: Stamps
    received: Stamps


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
    places, lag = _apart(body, spool)
    step = _step(lag) or _step(_phases(body, spool, places))
    if step is not None:
        at, by = step
        seconds = float(places[at]) * CHUNK
        raise InputError(
            f"{path}: the clock of one of {names} was set by {1e3 * abs(by):.3g} ms at about {seconds:.1f} "
            "s: which samples belong together is unknown; record again with synchronised clocks, or type "
            "--stamps log to use the times of reception"
        )
    found = judge_stamps(body.stamps), judge_stamps(spool.stamps)
    reason = unpaired((body.name, spool.name), found, (body.stamps, spool.stamps))
    if reason:
        raise InputError(
            f"{path}: {printable(reason, 300)}; or type --stamps log to use the times of reception"
        )
    if lag.size <= SPAN + 1:
        return []
    ends = [float(np.median(part)) for part in (lag[:BESIDE], lag[-BESIDE:])]
    gained = abs(ends[1] - ends[0]) * 1e-9
    if gained > max(WANDERS, 1e-9 * CERTAIN * _scale(lag)):
        return [f"the clocks of {names} ran apart by {1e3 * gained:.3g} ms, as the times of reception show"]
    return []


def _apart(body: TopicTimes, spool: TopicTimes) -> tuple[NDArray[np.int64], Array]:
    """Return chunks (of ``CHUNK`` s of reception) and by how much the body's stamps lead in each, ns."""
    begin = min(int(body.received[0]), int(spool.received[0]))
    means = [
        _means(one.received - begin, (one.stamps - one.stamps[0]) - (one.received - one.received[0]))
        for one in (body, spool)
    ]
    places = np.intersect1d(means[0][0], means[1][0])
    first, second = (mean[np.searchsorted(at, places)] for at, mean in means)
    return places, np.asarray(first - second, dtype=np.float64)


def _phases(body: TopicTimes, spool: TopicTimes, places: NDArray[np.int64]) -> Array:
    """Return by how much the body's stamps lead the spool's in each chunk, whole periods left out, ns.

    No sample that is lost changes it: a step of it is one of a clock, also where a bag's times of reception
    are copies of the stamps.
    """
    rows = []
    begin = min(int(body.received[0]), int(spool.received[0]))
    for one in (body, spool):
        found = judge_stamps(one.stamps)
        if found.rhythm is not Rhythm.EVEN:
            return np.empty(0)
        period = 1e9 * found.period
        steps = np.diff(one.stamps).astype(np.float64)
        off = np.concatenate([[0.0], np.cumsum(steps - period * np.rint(steps / period))])
        at, mean = _means(one.received - begin, off)
        rows.append(mean[np.searchsorted(at, places)])
    return np.asarray(rows[0] - rows[1], dtype=np.float64)


def _means(time: Stamps, values: Stamps | Array) -> tuple[NDArray[np.int64], Array]:
    """Return the chunks that have values, and the mean of each."""
    chunk = (np.maximum(time, 0) // round(1e9 * CHUNK)).astype(np.int64)
    places, inverse, counts = np.unique(chunk, return_inverse=True, return_counts=True)
    return places, np.bincount(inverse, weights=values.astype(np.float64)) / counts


def _scale(row: Array) -> float:
    return MEDIAN_TO_DEVIATION * float(np.median(np.abs(np.diff(row)))) if row.size > 1 else 0.0


def _step(row: Array) -> tuple[int, float] | None:
    """Return the chunk of the largest lasting step and its size (s), ``None`` where there is none."""
    if row.size <= SPAN:
        return None
    limit = max(LEAST_STEP + 2.0 * SLEW * 1e9 * CHUNK, CERTAIN * _scale(row))
    first, second = row[SPAN - 2 : -1] - row[: -SPAN + 1], row[SPAN - 1 :] - row[: -SPAN + 1]
    lasting = np.where(np.sign(first) == np.sign(second), np.minimum(np.abs(first), np.abs(second)), 0.0)
    at = int(np.argmax(lasting))
    if lasting[at] <= limit:
        return None
    before, after = row[max(0, at - BESIDE) : at + 1], row[at + SPAN - 1 : at + SPAN + BESIDE]
    return at + 1, 1e-9 * float(np.median(after) - np.median(before))
