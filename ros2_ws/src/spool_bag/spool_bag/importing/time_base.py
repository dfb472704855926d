"""Time base of a record: its stamps as they are, or the line through them, and its gaps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_core import stamps
from spool_core.block_gate import SHORTEST_PERIOD
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS
from spool_core.stamps import Indices, Rhythm, Stamps
from spool_core.text import plural, printable

from spool_bag.importing import time_axis
from spool_bag.importing.channel_use import ClockRoles

#: Relative difference up to which --rate and the rate of a time axis are the same.
SAME = 0.005
#: Steps, of the longest there are, by which stamps may be off the line of a given rate.
OFF_LINE = 1.5
#: Share of stamps that may be late although no more of them jitter.
MOST_LATE = 0.03
#: What decides for a line that the stamps alone do not show.
GIVEN = "--rate"
#: Units in which times are taken for s, and their sizes in s.
_NAMES = {
    "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0, "hours": 3600.0,
}  # fmt: skip
Where = Callable[[int], str]


@dataclass(slots=True)
class TimeBase:
    """``time`` in s, shape (n,), ``period`` in s, ``gaps``: indices of first samples after one.

    ``rate_std``: relative standard deviation of the rate, from the stamps. ``kept``: rows that are kept,
    ``None`` for all. ``warnings``: one line each; ``repairs``: counts by name. ``given``: the rate is the one
    that the user states. ``note``: the rate and where it comes from.
    """

    time: Array
    period: float
    gaps: Indices
    rate_std: float = 0.0
    kept: NDArray[np.bool_] | None = None
    warnings: list[str] = field(default_factory=list)
    repairs: dict[str, int] = field(default_factory=dict)
    given: bool = False
    note: str = ""


def sampled(
    clock: ClockRoles,
    axis: time_axis.TimeAxis,
    rows: Sequence[NDArray[np.floating]],
    given: float | None,
    kind: str,
    *,
    regular: bool,
) -> TimeBase:
    """Return the time base of a record's samples; all that is known of their rate is compared here.

    Args:
        clock: what the file states.
        axis: what its stamps show, or the count of samples.
        rows: values of all channels on this axis.
        given: Hz, as the user types it; it stands over what the file states.
        kind: of the record, a key of ``REQUIRED``.
        regular: with False times may be spaced as they like.

    Raises:
        InputError: stamps, file and user contradict each other, or no valve is sampled so slowly.
    """
    table, group, source = clock.table, clock.group, clock.group.source or "the file"
    label = str(table.path)
    try:
        if regular:
            decides = None if axis.role is None else given
            base = time_base(label, axis.label, axis.time, rows, table.where, decides)
        else:
            base = loose_time_base(label, axis.label, axis.time, table.where)
        rate = 1.0 / base.period
        if axis.role is not None and given is not None and abs(base.period * given - 1.0) > SAME:
            raise InputError(
                f"{label}: --rate {given:g}: {axis.label} shows {rate:g} Hz: leave --rate out, or correct it"
            )
    except InputError as error:
        if axis.start is None or group.name not in table.clocks:
            raise
        raise InputError(f"{error}; or type --stamps log to use the times of reception") from error
    if axis.role is None:
        base.note = f"rate {rate:.7g} Hz from {source if given is None else '--rate'}"
        if given is not None and abs(group.rate / given - 1.0) > SAME:  # NaN: none is stated, as below
            base.warnings.append(f"--rate {given:g} is used, and {source} states {group.rate:g} Hz")
    else:
        name = printable(axis.role.name, 40)
        if given is None and abs(group.rate * base.period - 1.0) > SAME:
            raise InputError(
                f"{label}: {name} shows {rate:.7g} Hz and {source} states {group.rate:.7g} Hz: correct one "
                f"of them, or type --rate {rate:.7g} if the times hold"
            )
        near = "" if given is None else f", near --rate {given:g}"
        shown = f"--rate, which {name} allows" if base.given else f"{name}{near}"
        base.note = f"rate {rate:.7g} Hz from {shown}"
    if base.period > time_axis.LONGEST_USUAL_PERIOD or base.period < SHORTEST_PERIOD:
        units = (
            unit
            for unit, size in _NAMES.items()
            if time_axis.SHORTEST_USUAL_PERIOD <= base.period * size <= time_axis.LONGEST_USUAL_PERIOD
        )
        doubt = f"{axis.label} steps by {base.period:g} s: are these {next(units, 'seconds')}?"
        if kind == "accelerations" or not SHORTEST_PERIOD <= base.period <= time_axis.LONGEST_PERIOD:
            raise InputError(
                f"{label}: {doubt} give the unit with --unit time=ms, and the samples of a valve at "
                f"{LIMITS.rate:g} Hz or more"
            )
        base.warnings.append(doubt)
    return base


def time_base(
    label: str,
    name: str,
    time: Array,
    rows: Sequence[NDArray[np.floating]],
    where: Where,
    rate: float | None = None,
) -> TimeBase:
    """Return the time base of samples at ``time`` (s, shape (n,)).

    Rows that repeat the one before, time and all values, are left out. Stamps of a regular clock that are
    coarse, come in bursts or jitter are replaced by a line through them.

    Args:
        label: of the file, for messages.
        name: of the time axis.
        time: s, as the file has it.
        rows: values of all channels on this axis, to judge repeated rows and bursts.
        where: where a row stands.
        rate: Hz, as the user states it; it decides where the stamps leave it open.

    Raises:
        InputError: too few samples, time that goes back, or a rate that the stamps do not show.
    """
    kept, repairs, warnings = None, {}, []
    equal = stamps.first_step(time, lambda steps: steps == 0.0) is not None
    marked, sure = stamps.repeated(time, rows) if equal else (np.zeros(0, np.bool_), True)
    if marked.any():
        count = int(np.count_nonzero(marked))
        if not sure:
            raise InputError(
                f"{label}: {where(int(np.argmax(marked)))}: {count} rows have {name} and values of the row "
                "before, by repetition or by chance: remove repeated rows, or export finer times and values"
            )
        kept = ~marked
        time = time[kept]
        rows = [row[kept] for row in rows]
        places = np.flatnonzero(kept)
        outer, where = where, lambda row: outer(int(places[row]))
        repairs["repeated_rows"] = count
        warnings.append(f"{count} rows repeat the one before: left out")
    if time.size < 3:
        raise InputError(f"{label}: {time.size} samples are too few for a record")
    base = _of_stamps(name, time, _settled(label, name, time, rows, where, rate), where)
    base.kept = kept
    base.warnings = warnings + base.warnings
    base.repairs = repairs | base.repairs
    return base


def loose_time_base(label: str, name: str, time: Array, where: Where) -> TimeBase:
    """Return the time base of samples that may be spaced as they like: median step, gaps ten times that.

    Coarse stamps of a regular clock are placed on its line.

    Raises:
        InputError: too few samples, or time that goes back.
    """
    if time.size < 3 or stamps.first_step(time, lambda steps: steps <= 0.0) is not None:
        return time_base(label, name, time, (), where)  # says what is wrong
    found = stamps.judge(time)
    if found.rhythm is Rhythm.COARSE:
        return _of_stamps(name, time, found, where)
    steps = np.diff(time)
    period = float(np.median(steps))
    gaps = np.flatnonzero(steps > 10.0 * period) + 1
    base = TimeBase(time, period, gaps.astype(np.int64))
    if gaps.size:
        base.warnings.append(f"{plural(gaps.size, 'gap')} in {name}, longer than {10.0 * period:g} s")
    uneven = float(np.quantile(np.abs(steps - period), 0.99))
    if uneven > stamps.JITTER * period + stamps.resolution(time):
        base.warnings.append(f"{name} is spaced unevenly, by up to {uneven:.3g} s: resampled")
    return base


def _settled(
    label: str, name: str, time: Array, rows: Sequence[NDArray[np.floating]], where: Where, rate: float | None
) -> Stamps:
    """Return what the stamps show, what they leave open decided by the values or by the ``rate`` given.

    Raises:
        InputError: nothing decides.
    """
    found = stamps.judge(time)
    forward = found.reason != stamps.BACKWARDS
    late = stamps.placed(time, stepped=True) if found.rhythm is Rhythm.UNEVEN and forward else None
    if rate is not None and found.rhythm is not Rhythm.EVEN and forward:
        near = [
            one
            for one in (found, found.literal, late)
            if one is not None and abs(one.rate / rate - 1.0) <= SAME
        ]
        line = _line_at(time, rate)
        if near and near[0] is found.literal:
            return near[0]
        if line is not None and not found.lost:
            return replace(line, rhythm=Rhythm.COARSE if not near else found.rhythm, burst=found.burst)
        if near:
            return near[0]
        if found.rhythm is Rhythm.UNEVEN:
            shown = "" if late is None else f": they show {late.rate:.7g} Hz"
            raise InputError(
                f"{label}: --rate {rate:g}: {time.size} samples in {float(time[-1] - time[0]):g} s of {name} "
                f"do not fit it{shown}: correct it, or leave the time out with --exclude"
            )
    if found.literal is not None:
        paused = _paused(found.literal.gaps, rows)
        if paused:
            return found.literal
        if paused is None and found.rhythm is Rhythm.BURSTS:
            inner, outer = found.literal.rate, found.rate
            raise InputError(
                f"{label}: {where(int(found.literal.gaps[0]))}: {name} comes in bursts of "
                f"{found.burst:.3g} samples: type --rate {outer:.7g} if the sensor sampled without a pause "
                f"(a FIFO), or --rate {inner:.7g} if it paused"
            )
    if found.rhythm is not Rhythm.UNEVEN:
        return found
    if not forward:
        raise InputError(
            f"{label}: {where(found.at)}: {name} does not increase ({time[found.at]:g} s): a clock that was "
            "set, or two runs in one file: import each separately"
        )
    if late is not None and _few_late(time, late):
        return late
    shown = "HZ" if late is None else f"{late.rate:.7g}"
    raise InputError(
        f"{label}: {where(found.at)}: sampling is irregular, {found.reason}: resample it to a constant "
        f"period, or give the rate with --rate {shown} if only the times are poor"
    )


def _few_late(time: Array, late: Stamps) -> bool:
    """Return whether stamps are on the line through them but for a few, and hardly ever set."""
    assert late.times is not None
    if late.gaps.size > MOST_LATE * time.size:
        return False
    return float(np.quantile(np.abs(time - late.times), 1.0 - MOST_LATE)) <= stamps.JITTER * late.period


def _line_at(time: Array, rate: float) -> Stamps | None:
    """Return the line of samples at a given rate through ``time``; ``None`` where stamps are far off it.

    One step that is much longer than the others is a pause, over which no line leads.
    """
    number, steps = np.arange(time.size, dtype=np.float64), np.abs(np.diff(time))
    line, deviation = stamps.on_line(number, time, 1.0 / rate)
    longest = max(float(np.max(steps)), 1.0 / rate)
    alone = np.count_nonzero(steps > 0.5 * longest) < min(stamps.BURSTS, np.count_nonzero(steps))
    if float(np.ptp(time - line)) > OFF_LINE * (1.0 / rate if alone else longest):
        return None
    return Stamps(Rhythm.COARSE, rate, 0.0, times=line, deviation=deviation, reason=GIVEN)


def _paused(gaps: Indices, rows: Sequence[NDArray[np.floating]]) -> bool | None:
    """Return whether the values show pauses at ``gaps``; ``None`` where they cannot.

    Samples differ the more the further they are apart. Without a pause they differ across a gap as they do
    inside of bursts (lag 1); with one as much as those a whole burst apart, or more. The median square of m
    normal differences, which a few losses do not move, is known to sqrt(5.4 / m): it has to be within 3 of
    these deviations of one, where both are further apart than that, and channels must not contradict.
    """
    if gaps.size < 4:
        return None
    size = int(np.median(np.diff(gaps)))
    sure = 1.0 + 3.0 * math.sqrt(5.4 / gaps.size)
    verdicts = set()
    for row in rows:
        values = row.astype(np.float64, copy=False)
        across = float(np.median(np.square(values[gaps] - values[gaps - 1])))
        starts = gaps[:-1][np.diff(gaps) >= size]
        near = float(np.median(np.square(np.delete(np.diff(values), gaps - 1))))
        far = float(np.median(np.square(values[starts + size - 1] - values[starts]))) if size > 2 else 0.0
        if near > 0.0 and far >= sure**2 * near:
            verdicts.add(True if across >= far / sure else False if across <= near * sure else None)
    return verdicts.pop() if len(verdicts) == 1 else None


def _of_stamps(name: str, time: Array, found: Stamps, where: Where) -> TimeBase:
    """Return the time base of stamps whose clock is known."""
    base = TimeBase(time if found.times is None else found.times, found.period, found.gaps, found.rate_std)
    base.given = found.reason == GIVEN
    if found.gaps.size:
        at = base.time
        missing = float(np.sum(np.maximum(at[found.gaps] - at[found.gaps - 1] - found.period, 0.0)))
        base.warnings.append(
            f"{plural(found.gaps.size, 'gap')} in {name}, {missing:g} s missing; "
            f"first at {where(int(found.gaps[0]))}"
        )
        base.repairs["gaps"] = int(found.gaps.size)
    sure = f"{found.rate:.8g} Hz" + (f", known to {1e6 * found.rate_std:.2g} ppm" if found.rate_std else "")
    if found.rhythm is Rhythm.COARSE:
        steps = f"has steps of {found.resolution:g} s" if found.resolution else "is not used"
        base.warnings.append(f"{name} {steps}: samples are placed on a line of {sure}")
        base.repairs["placed_on_a_line"] = int(time.size)
    elif found.rhythm is Rhythm.BURSTS:
        base.warnings.append(
            f"{name} comes in bursts of {found.burst:.3g} samples: they are placed on a line of {sure}"
        )
        base.repairs["bursts_placed_on_a_line"] = int(time.size)
    elif found.rhythm is Rhythm.JITTER:
        base.warnings.append(
            f"{name} jitters by {found.deviation:.3g} s (rms) about a regular clock: placed on its line of "
            f"{sure}"
        )
        base.repairs["jitter_placed_on_a_line"] = int(time.size)
    return base
