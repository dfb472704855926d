"""Time of a record: from its stamps, its rate or what is said, checked sample by sample."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.block_gate import SHORTEST_PERIOD
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.stamps import (
    BACKWARDS,
    BURSTS,
    JITTER,
    Rhythm,
    Stamps,
    first_step,
    judge,
    number_error,
    placed,
    repeated,
    resolution,
    ticks,
)
from spool_core.text import plural, printable

from spool_bag import TIME
from spool_bag.importing.choices import Choices
from spool_bag.importing.roles import Source, reference
from spool_bag.importing.table import LOG_TIME, STAMP, Channel, Group, Table, Values
from spool_bag.importing.units import WORDS, factor, quantity_of, split_header

#: Beyond any acceleration, force, displacement or time in ns since 1970.
LARGEST_NUMBER = 1e19

#: s: at 20 Hz not even 10 Hz can be seen, below any spool valve's natural frequency.
LONGEST_USUAL_PERIOD = 0.05
#: s, of a force record, which may be as slow as its machine.
LONGEST_PERIOD = 10.0
#: s: 100 kHz is beyond what accelerometers of valves are sampled with.
SHORTEST_USUAL_PERIOD = 1e-5
#: s since 1970: from 2001 to 2038; numbers of that size in some unit count from 1970.
CALENDAR = (1e9, 2.0**31)

#: Day numbers of spreadsheets and of MATLAB: the number of 1970-01-01; and of which days since then.
_DAYS = {"days since 1899-12-30 (Excel)": 25_569.0, "days since year 0 (MATLAB)": 719_529.0}
_DATES = (10_957.0, 24_837.0)
#: Names of a column of fractions of a second beside whole seconds, and their size in s.
_FRACTIONS = {
    "ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3,
    "millisekunden": 1e-3, "us": 1e-6, "usec": 1e-6, "micros": 1e-6, "microsecond": 1e-6,
    "microseconds": 1e-6, "ns": 1e-9, "nanoseconds": 1e-9, "nanosec": 1e-9,
}  # fmt: skip
_PIECE = 1 << 20

_SIZES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_NAMES = {
    "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0, "hours": 3600.0,
}  # fmt: skip


#: Bits of counters of a clock, how often one may begin again in a record, and usual steps that one may pass
#: meanwhile.
COUNTERS, MOST_WRAPS, LONGEST_WRAP = (16, 24, 31, 32), 100_000, 100.0
#: Relative difference up to which --rate and the rate of a time axis are the same.
SAME = 0.005
#: Steps, of the longest there are, by which stamps may be off the line of a given rate.
OFF_LINE = 1.5
#: Share of stamps that may be late although no more of them jitter.
MOST_LATE = 0.03
#: What decides for a line that the stamps alone do not show.
GIVEN = "--rate"
Indices = NDArray[np.int64]
Where = Callable[[int], str]


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """What the spool's clock shows more than the body's, and how much faster it runs.

    ``offset`` in s at the body's first sample, ``drift`` relative, each with its standard deviation;
    ``coherence``: squared, over the band of both channels. ``natural_frequency`` (Hz): of the spool, by
    the way.
    """

    offset: float
    offset_std: float
    drift: float
    drift_std: float
    coherence: float
    natural_frequency: float

    def __str__(self) -> str:
        """What it is, for people."""
        return (
            f"the spool's clock shows {self.offset:+.5f} s (std {1e3 * self.offset_std:.2g} ms) "
            "against the body's and "
            f"runs {1e6 * self.drift:+.1f} ppm fast (std {1e6 * self.drift_std:.2g} ppm)"
        )


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """``time`` in s, shape (n,), from ``start`` (ns since 1970, ``None`` where not known) on.

    ``label``: name for messages. ``notes``: how it was understood.
    """

    time: Array
    start: int | None
    label: str
    notes: tuple[str, ...] = ()


def other_times(group: Group, axis: Channel, taken: Sequence[Channel]) -> list[Channel]:
    """Return the other channels of a group that may hold a time: by format, unit or name (`T2`, `Time_1`)."""
    if any(one.name == LOG_TIME for one in group.channels):
        return []  # of a bag, whose times of sending and of reception are a choice of the user
    found = []
    for one in group.channels:
        if one == axis or one in taken or one.role:
            continue
        if one == fraction_of(group, axis, taken):
            continue
        words = re.split(r"[\W_]+", split_header(one.header)[0].rpartition("/")[2].lower())
        called = any(word.rstrip("0123456789") in WORDS["time"] for word in words if word)
        quantity = quantity_of(one.unit)
        if one.time or quantity == "time" or (called and not quantity and not one.unit):
            found.append(one)
    return found


def fraction_of(group: Group, axis: Channel, taken: Sequence[Channel]) -> Channel | None:
    """Return the channel beside a time axis that holds its fraction of a second, by its name."""
    return next(
        (
            one
            for one in group.channels
            if one != axis and one not in taken and split_header(one.header)[0].strip().lower() in _FRACTIONS
        ),
        None,
    )


def counted(size: int, number: Values | None, rate: float, delay: float) -> TimeAxis:
    """Return the time of ``size`` samples at ``rate`` (Hz), counted by ``number`` where a column does.

    ``delay``: s, time of the first one.
    """
    if number is None:
        time = np.arange(size, dtype=np.float64) / rate
    else:
        held = np.asarray(number, dtype=np.float64)
        time = (held - held[:1]) / rate
    return TimeAxis(time + delay if delay else time, None, "the sample index")


def read_axis(
    table: Table,
    group: Group,
    axis: Channel,
    others: Sequence[Channel],
    values: Mapping[str, Values],
    asked: Choices,
) -> TimeAxis:
    """Return the time of a group's samples by ``axis``, once no other time in the file contradicts it.

    Args:
        table, group: of the axis.
        axis: chosen by name or by the user.
        others: other channels that may hold the time.
        values: of all of them by name, and of the fraction beside ``axis``.
        asked: units that the user states.

    Raises:
        InputError: the unit is no time or not known, values are missing, or two times are two clocks.
    """
    found = _axis(table, axis, values[axis.name], asked)
    part = fraction_of(group, axis, [])
    if part is not None and part.name in values:
        found = _with_fraction(found, part, values[part.name])
    for other in others:
        held = np.asarray(values[other.name], dtype=np.float64)
        known = held[np.isfinite(held)]
        if known.size < 3 or float(np.min(np.diff(known))) < 0.0 or known[0] == known[-1]:
            continue  # no clock
        if known.size < found.time.size:
            missing = found.time.size - known.size
            raise _two_clocks(
                table, group, axis, other, f"{printable(other.header, 40)} lacks {missing} values"
            )
        try:
            second = _axis(table, other, values[other.name], _any_unit(asked))
        except InputError:
            continue  # a time without a unit that could be several
        apart = found.time - found.time[0] - (second.time - second.time[0])
        drift, allowed = float(np.ptp(apart)), _allowed(found.time, second.time)
        # Dates and times since the start of a logger count from different moments, others from one.
        begun = float(found.time[0] - second.time[0])
        begun += 0.0 if found.start is None or second.start is None else (found.start - second.start) * 1e-9
        if (found.start is None) == (second.start is None) and abs(begun) > allowed:
            raise _two_clocks(table, group, axis, other, f"{abs(begun):.3g} s apart")
        if drift <= allowed:
            if found.start is None and second.start is not None:
                found = replace(
                    found, start=second.start - round(1e9 * float(found.time[0] - second.time[0]))
                )
            continue
        raise _two_clocks(table, group, axis, other, f"they move apart by {drift:.3g} s")
    return found


def finite(
    path: Path, name: str, values: NDArray[Any], where: Callable[[int], str], *, holes: bool
) -> NDArray[Any]:
    """Return ``values``, shape (n,); with ``holes`` empty cells are NaN.

    Raises:
        InputError: a value is missing, infinite or larger than anything measured.
    """
    name = printable(name, 40)
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    if math.isfinite(low) and math.isfinite(high) and max(-low, high) <= LARGEST_NUMBER:
        return values  # nothing is to be looked for, and no memory is taken for it
    bad = np.isinf(values) if holes else ~np.isfinite(values)
    if bad.any():
        raise InputError(
            f"{path}: {where(int(np.argmax(bad)))}: {name} is empty, NaN or infinite "
            f"({int(np.count_nonzero(bad))} such cells)"
            + ("" if np.isinf(values).any() else "; --empty-as-gap leaves out rows that a channel lacks")
        )
    huge = np.abs(values) > LARGEST_NUMBER
    if huge.any():
        at = int(np.argmax(huge))
        raise InputError(
            f"{path}: {where(at)}: {name} is {values[at]:g}, which nothing measures "
            f"({int(np.count_nonzero(huge))} such cells)"
        )
    return values


def period_check(path: Path, name: str, period: float, kind: str) -> str:
    """Return what is odd about a sampling period (s), "" where nothing is.

    Raises:
        InputError: the time is hardly in s: an error by 1000 would go through every number.
    """
    name = printable(name, 40)
    slowest = LONGEST_USUAL_PERIOD if kind == "accelerations" else LONGEST_PERIOD
    if not SHORTEST_PERIOD <= period <= slowest:
        raise InputError(
            f"{path}: {name} steps by {period:g} s: are these {_usual(period)}? give the unit with "
            "--unit time=ms, "
            f"and the samples of a valve at more than {1.0 / LONGEST_USUAL_PERIOD:g} Hz"
        )
    return (
        f"{name} steps by {period:g} s: are these {_usual(period)}?" if period > LONGEST_USUAL_PERIOD else ""
    )


@dataclass(slots=True)
class TimeBase:
    """``time`` in s, shape (n,), ``period`` in s, ``gaps``: indices of first samples after one.

    ``rate_std``: relative standard deviation of the rate, from the stamps. ``kept``: rows that are kept,
    ``None`` for all. ``warnings``: one line each; ``repairs``: counts by name. ``given``: the rate is the one
    that the user states.
    """

    time: Array
    period: float
    gaps: Indices
    rate_std: float = 0.0
    kept: NDArray[np.bool_] | None = None
    warnings: list[str] = field(default_factory=list)
    repairs: dict[str, int] = field(default_factory=dict)
    given: bool = False


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
        InputError: too few samples, time that goes back, a rate that the stamps do not show or contradict.
    """
    if time.size < 3:
        raise InputError(f"{label}: {time.size} samples are too few for a record")
    kept, repairs, warnings = None, {}, []
    equal = first_step(time, lambda steps: steps == 0.0) is not None
    marked, sure = repeated(time, rows) if equal else (np.zeros(0, np.bool_), True)
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
    found = _settled(label, name, time, rows, where, rate)
    base = _of_stamps(name, time, found, where)
    base.kept = kept
    base.warnings = warnings + base.warnings
    base.repairs = repairs | base.repairs
    if rate is not None and abs(base.period * rate - 1.0) > SAME:
        raise InputError(
            f"{label}: --rate {rate:g}: {name} shows {1.0 / base.period:g} Hz: leave --rate out, or "
            "correct it"
        )
    return base


def loose_time_base(label: str, name: str, time: Array, where: Where) -> TimeBase:
    """Return the time base of samples that may be spaced as they like: median step, gaps ten times that.

    Coarse stamps of a regular clock are placed on its line.

    Raises:
        InputError: too few samples, or time that goes back.
    """
    if time.size < 3 or first_step(time, lambda steps: steps <= 0.0) is not None:
        return time_base(label, name, time, (), where)  # says what is wrong
    found = judge(time)
    if found.rhythm is Rhythm.COARSE:
        return _of_stamps(name, time, found, where)
    steps = np.diff(time)
    period = float(np.median(steps))
    gaps = np.flatnonzero(steps > 10.0 * period) + 1
    base = TimeBase(time, period, gaps.astype(np.int64))
    if gaps.size:
        base.warnings.append(f"{plural(gaps.size, 'gap')} in {name}, longer than {10.0 * period:g} s")
    uneven = float(np.quantile(np.abs(steps - period), 0.99))
    if uneven > JITTER * period + resolution(time):
        base.warnings.append(f"{name} is spaced unevenly, by up to {uneven:.3g} s: resampled")
    return base


def _any_unit(asked: Choices) -> Choices:
    """Return the choices without the time's unit, which is that of the chosen axis."""
    return replace(
        asked,
        units={role: unit for role, unit in asked.units.items() if role != TIME},
        columns={role: own for role, own in asked.columns.items() if role != TIME},
    )


def _allowed(first: Array, second: Array) -> float:
    """Return by how much (s) two columns of one clock may differ: their rounding, or a part of a period."""
    period = float(first[-1] - first[0]) / max(first.size - 1, 1)
    noise = [number_error(time) for time in (first, second)]
    tick = max(float(ticks(time, one).max()) for time, one in zip((first, second), noise, strict=True))
    return 1.01 * tick if tick > 1.01 * period else JITTER * period


def _two_clocks(table: Table, group: Group, axis: Channel, other: Channel, why: str) -> InputError:
    """Return the error of two time columns, with what to type."""
    second = reference([table], Source(table, group, other))
    return InputError(
        f"{table.path}: {printable(axis.header, 40)} (#{axis.number}) and {printable(other.header, 40)} "
        f"(#{other.number}) are two clocks, {why}: write each channel with its own time into its own file; "
        f"or, if the first holds for both channels, type --exclude {shlex.quote(second)}"
    )


def _axis(table: Table, axis: Channel, stamps: Values, asked: Choices) -> TimeAxis:
    """Return the times of one channel."""
    label = printable(axis.header, 40)
    if axis.unit == STAMP:
        whole = np.asarray(stamps, dtype=np.int64)
        if whole.size == 0:
            raise InputError(f"{table.path}: 0 samples are too few for a record")
        time = np.empty(whole.size)
        for at in range(0, whole.size, _PIECE):
            time[at : at + _PIECE] = (whole[at : at + _PIECE] - whole[0]) * 1e-9
        if not axis.dated:
            note = f"{label} has no date: the record begins on 2025-01-01, or when --start states"
            return TimeAxis(time, None, label, (note,))
        return TimeAxis(time, int(whole[0]) if whole[0] > 0 else None, label)
    numbers = finite(table.path, axis.name, np.asarray(stamps, dtype=np.float64), table.where, holes=False)
    return _in_seconds(table.path, axis, numbers, asked)


def _with_fraction(found: TimeAxis, part: Channel, values: Values) -> TimeAxis:
    """Return times in whole seconds with the fraction that another channel holds."""
    size = _FRACTIONS[split_header(part.header)[0].strip().lower()]
    held = np.asarray(values, dtype=np.float64)
    whole = np.abs(found.time - np.rint(found.time)) < 1e-6
    fits = np.isfinite(held).all() and float(held.min()) >= 0.0 and float(held.max()) * size < 1.0
    if not (whole.all() and fits and found.time.size > 2):
        return found
    time = found.time + held * size
    label = f"{found.label} and {printable(part.header, 40)}"
    notes = (*found.notes, f"{label} together are the time")
    return TimeAxis(time, found.start, label, notes)


def _in_seconds(path: Path, axis: Channel, values: Array, asked: Choices) -> TimeAxis:
    """Return times of numbers; a unit that is not named is recognised where only one is plausible."""
    label = printable(axis.header, 40)
    unit = asked.units.get(TIME) or axis.unit or ("s" if asked.states_unit(TIME) else "")
    values, notes = _continued(label, values)
    if unit:
        if quantity_of(unit) != "time":
            raise InputError(f"{path}: {label} is in {printable(unit, 30)}, which is no time")
        size = factor(unit, "time")
        return TimeAxis(values if size == 1.0 else values * size, None, label, notes)
    found = _plausible(values)
    if len(found) != 1:
        way = "s" if "s" in found or not found else found[0]
        kinds = " or ".join(found or list(_SIZES))
        raise InputError(
            f"{path}: {label} has no unit and could be in {kinds}: state it with --unit time={way}"
        )
    (only,) = found
    if only in _DAYS:
        first = float(values[0])
        start = round((first - _DAYS[only]) * 86_400e6) * 1000  # whole us: float64 days hold no more
        note = f"{label} has no unit: by its steps and size it counts {only}"
        return TimeAxis((values - first) * 86_400.0, start, label, (note,))
    note = f"{label} has no unit: by its steps and size it is in {only}"
    return TimeAxis(values if only == "s" else values * _SIZES[only], None, label, (*notes, note))


def _continued(label: str, values: Array) -> tuple[Array, tuple[str, ...]]:
    """Return counts of a clock as one line that begins again after its largest number, e.g. of `micros()`.

    Such a step back is, with the range of the counter added, a step forward by some usual steps.
    """
    back = np.flatnonzero(np.diff(values) < 0.0)
    if values.size < 3 or not 0 < back.size <= MOST_WRAPS or np.any(values != np.rint(values)):
        return values, ()
    steps, usual = np.diff(values)[back], float(np.median(np.diff(values[: 1 << 16])))
    for bits in COUNTERS:
        size = 2.0**bits
        inside = float(np.max(values)) - float(np.min(values)) <= size
        if inside and usual > 0.0 and np.all((steps + size > 0.0) & (steps + size <= LONGEST_WRAP * usual)):
            turns = np.zeros(values.size)
            turns[back + 1] = size
            note = f"{label} counts to 2^{bits} and begins again there: continued"
            return values + np.cumsum(turns), (note,)
    return values, ()


def _plausible(values: Array) -> list[str]:
    """Return the units in which times count from 1970, or else in which their steps are a usual period."""
    if values.size < 3:
        return ["s"]
    first = float(values[0])
    calendar = [unit for unit, size in _SIZES.items() if CALENDAR[0] < first * size < CALENDAR[1]]
    step = float(np.median(np.diff(values[: 1 << 16])))
    days = [
        name
        for name, zero in _DAYS.items()
        if _DATES[0] < first - zero < _DATES[1]
        and SHORTEST_USUAL_PERIOD <= step * 86_400.0 <= LONGEST_USUAL_PERIOD
    ]
    if days:
        return days
    if calendar:
        fitting = [unit for unit in calendar if step * _SIZES[unit] <= LONGEST_PERIOD]
        return fitting or calendar
    return [
        unit for unit, size in _SIZES.items() if SHORTEST_USUAL_PERIOD <= step * size <= LONGEST_USUAL_PERIOD
    ]


def _usual(period: float) -> str:
    """Return the unit in which ``period`` would be plausible."""
    plausible = [unit for unit, size in _NAMES.items() if 1e-5 <= period * size <= LONGEST_USUAL_PERIOD]
    return plausible[0] if plausible else "seconds"


def _settled(
    label: str, name: str, time: Array, rows: Sequence[NDArray[np.floating]], where: Where, rate: float | None
) -> Stamps:
    """Return what the stamps show, what they leave open decided by the values or by the ``rate`` given.

    Raises:
        InputError: nothing decides.
    """
    found = judge(time)
    late = placed(time, stepped=True) if found.rhythm is Rhythm.UNEVEN and found.reason != BACKWARDS else None
    if rate is not None and found.rhythm is not Rhythm.EVEN and found.reason != BACKWARDS:
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
    if found.reason == BACKWARDS:
        raise InputError(
            f"{label}: {where(found.at)}: {name} does not increase ({time[found.at]:g} s): a clock that was "
            "set, or two runs in one file: import each by itself"
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
    return float(np.quantile(np.abs(time - late.times), 1.0 - MOST_LATE)) <= JITTER * late.period


def _line_at(time: Array, rate: float) -> Stamps | None:
    """Return the line of samples at a given rate through ``time``; ``None`` where stamps are far off it.

    One step that is much longer than the others is a pause, over which no line leads.
    """
    line = np.arange(time.size, dtype=np.float64) / rate
    off, steps = time - line, np.abs(np.diff(time))
    longest = max(float(np.max(steps)), 1.0 / rate)
    long = np.count_nonzero(steps > 0.5 * longest)
    alone = long < min(BURSTS, np.count_nonzero(steps))
    if float(np.ptp(off)) > OFF_LINE * (1.0 / rate if alone else longest):
        return None
    line += float(off.mean())
    deviation = float(np.sqrt(np.mean(np.square(time - line))))
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
