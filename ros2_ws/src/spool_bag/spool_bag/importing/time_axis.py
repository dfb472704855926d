"""Time of a record: from its stamps, its rate or the settings, checked sample by sample."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS
from spool_core.stamps import JITTER, first_step, median_step, number_error, ticks
from spool_core.text import printable

from spool_bag.importing.channel_use import ClockRoles, Role
from spool_bag.importing.settings import moment_of
from spool_bag.importing.table import STAMP, Table, Values

#: Beyond any acceleration, force, displacement or time in ns since 1970.
LARGEST_NUMBER = 1e19

#: s, of accelerations of any valve, live ones too.
LONGEST_USUAL_PERIOD = 1.0 / LIMITS.rate
#: s, of a force record, which may be as slow as its machine.
LONGEST_PERIOD = 10.0
#: s: 100 kHz is beyond what accelerometers of valves are sampled with.
SHORTEST_USUAL_PERIOD = 1e-5
#: s since 1970: from 2001 to 2038; numbers of that size in some unit count from 1970.
CALENDAR = (1e9, 2.0**31)

_PIECE = 1 << 20
#: Samples by which the finest of several times is known.
_LOOKED_AT = 1 << 16

_SIZES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "100ns": 1e-7, "ns": 1e-9}
#: Counts from other years than 1970: s of a step, and the count at the beginning of 1970.
_COUNTED = {
    "days since 1899-12-30 (Excel)": (86_400.0, 25_569.0),
    "days since year 0 (MATLAB)": (86_400.0, 719_529.0),
    "s since 1904 (LabVIEW)": (1.0, 2_082_844_800.0),
    "100 ns since 1601 (FILETIME)": (1e-7, 116_444_736e9),
    "100 ns since year 1 (.NET)": (1e-7, 621_355_968e9),
}
#: A time since a date, as `seconds since 2026-05-04 03:02:01` (CF conventions, section 4.4).
_SINCE = re.compile(r"\S.*\s+since\s+(?P<date>\d.*)")
#: Relative difference up to which a rate that is stated decides for a unit.
_ALIKE = 0.05
#: s that a record without a gap never steps by: a month.
LONGEST_GAP = 30 * 86_400.0


#: Bits of counters of a clock, how often one may begin again in a record, and usual steps that one may pass
#: meanwhile.
COUNTERS, MOST_WRAPS, LONGEST_WRAP = (16, 24, 31, 32), 100_000, 100.0


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


class TimeColumn(NamedTuple):
    """Column of times: the ``values``, shape (n,), of the channel of ``table`` that has a ``role``."""

    table: Table
    role: Role
    values: Values

    @property
    def label(self) -> str:
        """Name for messages."""
        return printable(self.role.use.column, 40)


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """``time`` in s, shape (n,), from ``start`` (ns since 1970, ``None`` where not known) on.

    ``label``: name for messages. ``notes``: how it was understood. ``role``: the column that it is of,
    ``None`` where samples are counted.
    """

    time: Array
    start: int | None
    label: str
    notes: tuple[str, ...] = ()
    role: Role | None = None


def axis_of(clock: ClockRoles, values: Mapping[str, Values], zone: str) -> TimeAxis:
    """Return when a clock's samples were taken, once no other time in the file contradicts it.

    Of several columns the finest counts; without any, samples are counted at the rate that is known.

    Args:
        clock: whose channels they are.
        values: by the channels' names, the oldest first.
        zone: as of ``Choices``.

    Raises:
        InputError: the unit is no time or not known, values are missing, two times are two clocks, or a clock
            was set.
    """
    table, axis = clock.table, clock.axis
    if axis is None:
        count: Array = np.arange(next(iter(values.values())).size, dtype=np.float64)
        if clock.counter is not None:
            count = np.asarray(values[clock.counter.channel.name], dtype=np.float64)
            count = count - count[:1]
        return TimeAxis(count / clock.rate + clock.group.delay, None, "the sample index")
    others = [*clock.others]
    if clock.fraction is None and others:
        steps = {one.name: len(np.unique(values[one.name][:_LOOKED_AT])) for one in (axis, *others)}
        finest = max((axis, *others), key=lambda one: steps[one.name])
        if steps[finest.name] > 1.5 * steps[axis.name] and np.all(np.diff(values[finest.name]) > 0):
            others = [axis, *(one for one in others if one is not finest)]
            axis = finest
    found = read_axis(TimeColumn(table, axis, values[axis.name]), clock.rate)
    if clock.fraction is not None:
        found = with_fraction(found, TimeColumn(table, clock.fraction, values[clock.fraction.name]))
    for other in others:
        found, why = compared(found, TimeColumn(table, other, values[other.name]))
        if why:
            first, second = (f"{printable(one.use.column, 40)} (#{one.use.number})" for one in (axis, other))
            way = shlex.quote(clock.channels.reference(other.source))
            raise InputError(
                f"{table.path}: {first} and {second} are two clocks, {why}: write each channel with its own "
                f"time into its own file; or, if the first holds for both channels, type --exclude {way}"
            )
    at = int(np.argmax(np.diff(found.time))) if found.time.size > 1 else 0
    step = float(found.time[at + 1] - found.time[at]) if found.time.size > 1 else 0.0
    if step > LONGEST_GAP:
        raise InputError(
            f"{table.path}: {table.where(at + 1)}: {found.label} jumps by {step / 86_400.0:,.0f} days: the "
            "clock was set while it recorded, or these are two recordings: import what stands before and "
            "after separately"
        )
    local = axis.use.unit == STAMP and not table.zoned
    found = in_zone(table.path, found, zone, local=local) if zone else found
    return replace(found, role=axis)


def read_axis(column: TimeColumn, rate: float = math.nan) -> TimeAxis:
    """Return the time of samples; a unit that is not known is recognised where only one is plausible.

    ``rate``: Hz, that the file or the user states; NaN without one.

    Raises:
        InputError: the unit is no time or could be several, or values are missing.
    """
    use, path, label = column.role.use, column.table.path, column.label
    if use.unit == STAMP:
        return _dated(column)
    values = finite(path, label, np.asarray(column.values, dtype=np.float64), column.table.where, holes=False)
    values, notes = _continued(label, values)
    if not math.isnan(use.factor):
        since = _SINCE.fullmatch(use.unit)
        moment = moment_of(since["date"].strip()) if since else None
        start = None if moment is None else moment + round(float(values[0]) * use.factor * 1e9)
        values = values if moment is None else values - values[0]
        return TimeAxis(values if use.factor == 1.0 else values * use.factor, start, label, notes)
    if use.unit:
        raise InputError(f"{path}: {label} is in {printable(use.unit, 30)}, which is no time")
    clock = _of_day(values)
    if clock is not None:
        note = f"{label} has no unit: it is a time of day, written HHMMSS"
        return TimeAxis(clock, None, label, (*notes, note))
    found = _plausible(values)
    step = median_step(values) if values.size > 1 else math.nan
    rates = {unit: 1.0 / (step * _SIZES[unit]) for unit in found if unit in _SIZES and step > 0.0}
    if len(found) != 1:
        found = [unit for unit, one in rates.items() if abs(one / rate - 1.0) < _ALIKE] or found
    if len(found) != 1:
        shown = {unit: f" ({one:.4g} Hz)" for unit, one in rates.items()}
        ways = [f"--unit time={unit}{shown.get(unit, '')}" for unit in found]
        counted = "counts its samples, or " if step == 1.0 and np.all(np.diff(values) == 1.0) else ""
        rate_too = ", or leave it out with --exclude and type --rate" if counted else ""
        raise InputError(
            f"{path}: {label} has no unit and {counted}could be in "
            f"{' or '.join(found or list(_SIZES))}: type {', or '.join(ways or ['--unit time=s'])}{rate_too}"
        )
    (only,) = found
    if only in _COUNTED:
        size, zero = _COUNTED[only]
        first = float(values[0])
        start = round((first - zero) * size * 1e6) * 1000  # whole us: float64 holds no more
        seen = "steps and size" if size > 1.0 else "size"
        notes = (*notes, f"{label} has no unit: by its {seen} it counts {only}")
        return TimeAxis((values - first) * size, start, label, notes)
    note = f"{label} has no unit: by its steps and size it is in {only}"
    return TimeAxis(values if only == "s" else values * _SIZES[only], None, label, (*notes, note))


def in_zone(path: Path, found: TimeAxis, zone: str, *, local: bool) -> TimeAxis:
    """Return a time axis whose stamps are those of clocks in a zone, e.g. ``Europe/Berlin``, not UTC.

    ``local``: they are dates that name no zone.

    Raises:
        InputError: they are not, clocks there never show the first one, or were changed until the last.
    """
    if not local or found.start is None:
        raise InputError(
            f"{path}: --zone {zone}: it has no dates without a zone: leave --zone out, or give the time of "
            "the first sample with --start"
        )
    naive = datetime(1970, 1, 1) + timedelta(microseconds=found.start // 1000)
    own, later = (naive.replace(tzinfo=ZoneInfo(zone), fold=fold) for fold in (0, 1))
    moment = own.astimezone(timezone.utc)
    if moment.astimezone(own.tzinfo).replace(tzinfo=None) != naive:
        raise InputError(f"{path}: --zone {zone}: clocks there never show {naive}: they are set forward then")
    last = (moment + timedelta(seconds=float(found.time[-1]))).astimezone(own.tzinfo)
    if last.utcoffset() != own.utcoffset():
        raise InputError(
            f"{path}: --zone {zone}: clocks there change during the record: import what stands before and "
            "after separately"
        )
    twice = " (shown twice that night: the first is taken)" if later.utcoffset() != own.utcoffset() else ""
    note = (
        f"the record begins at {own:%Y-%m-%d %H:%M:%S} in {zone}{twice}, {moment:%Y-%m-%d %H:%M:%S} UTC, by "
        f"{found.label}"
    )
    start = found.start + round((moment - naive.replace(tzinfo=timezone.utc)).total_seconds()) * 10**9
    notes = (one for one in found.notes if not one.startswith("the record begins at"))
    return replace(found, start=start, notes=(*notes, note))


def compared(found: TimeAxis, column: TimeColumn) -> tuple[TimeAxis, str]:
    """Return a time axis with the start that another column of times states, and how both contradict.

    The contradiction is "" where they are one clock, or the column holds no times.
    """
    held = np.asarray(column.values, dtype=np.float64)
    known = held[np.isfinite(held)]
    if known.size < 3 or float(np.min(np.diff(known))) < 0.0 or known[0] == known[-1]:
        return found, ""  # no clock
    if known.size < found.time.size:
        return found, f"{column.label} lacks {found.time.size - known.size} values"
    try:
        second = read_axis(column)
    except InputError:
        return found, ""  # a time without a unit that could be several
    apart = found.time - found.time[0] - (second.time - second.time[0])
    # Columns of one clock may differ by their rounding, or by a part of a period.
    period = float(found.time[-1] - found.time[0]) / max(found.time.size - 1, 1)
    noise = [number_error(time) for time in (found.time, second.time)]
    tick = max(
        float(ticks(time, one).max()) for time, one in zip((found.time, second.time), noise, strict=True)
    )
    drift, allowed = float(np.ptp(apart)), (1.01 * tick if tick > 1.01 * period else JITTER * period)
    # A number since 1970 is a date as well.
    found_start, second_start = (_dated_start(one) for one in (found, second))
    # Dates and times since the start of a logger count from different moments, others from one.
    begun = float(found.time[0] - second.time[0])
    begun += 0.0 if found.start is None or second.start is None else (found.start - second.start) * 1e-9
    if (found_start is None) == (second_start is None) and abs(begun) > allowed:
        return found, f"{abs(begun):.3g} s apart"
    if drift > allowed:
        return found, f"they move apart by {drift:.3g} s"
    if found_start is None and second_start is not None:
        return replace(found, start=second_start - round(1e9 * float(found.time[0]))), ""
    return found, ""


def _dated_start(one: TimeAxis) -> int | None:
    """Return when the first sample of a time axis was taken, ns since 1970; ``None``: not known."""
    first = float(one.time[0])
    if one.start is not None:
        return one.start + round(1e9 * first)
    return round(1e9 * first) if CALENDAR[0] < first < CALENDAR[1] else None


def with_fraction(found: TimeAxis, part: TimeColumn) -> TimeAxis:
    """Return times in whole seconds with the fraction of a second that another column holds."""
    size = part.role.use.factor
    held = np.asarray(part.values, dtype=np.float64)
    whole = np.abs(found.time - np.rint(found.time)) < 1e-6
    fits = np.isfinite(held).all() and float(held.min()) >= 0.0 and float(held.max()) * size < 1.0
    if not (whole.all() and fits and found.time.size > 2):
        return found
    label = f"{found.label} and {part.label}"
    notes = (*found.notes, f"{label} together are the time")
    return TimeAxis(found.time + held * size, found.start, label, notes)


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


def _dated(column: TimeColumn) -> TimeAxis:
    """Return the time of stamps in ns."""
    label = column.label
    whole = np.asarray(column.values, dtype=np.int64)
    if whole.size == 0:
        raise InputError(f"{column.table.path}: 0 samples are too few for a record")
    time = np.empty(whole.size)
    for at in range(0, whole.size, _PIECE):
        time[at : at + _PIECE] = (whole[at : at + _PIECE] - whole[0]) * 1e-9
    if not column.role.source.channel.dated:
        note = f"{label} has no date: the record begins on 2025-01-01, or when --start states"
        return TimeAxis(time, None, label, (note,))
    if whole[0] <= 0:
        return TimeAxis(time, None, label)
    begin = datetime.fromtimestamp(int(whole[0]) // 1_000_000_000, timezone.utc)
    note = f"the record begins at {begin:%Y-%m-%d %H:%M:%S} UTC by {label}"
    return TimeAxis(time, int(whole[0]), label, (note,))


def _continued(label: str, values: Array) -> tuple[Array, tuple[str, ...]]:
    """Return counts of a clock as one line that begins again after its largest number, e.g. of `micros()`.

    Such a step back is, with the range of the counter added, a step forward by some usual steps.
    """
    if values.size < 3 or first_step(values, lambda steps: steps < 0.0) is None:
        return values, ()
    back = np.flatnonzero(np.diff(values) < 0.0)
    if not 0 < back.size <= MOST_WRAPS or np.any(values != np.rint(values)):
        return values, ()
    steps, usual = np.diff(values)[back], median_step(values)
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
    step = median_step(values)
    dated = [
        name
        for name, (size, zero) in _COUNTED.items()
        if CALENDAR[0] < (first - zero) * size < CALENDAR[1]
        and (size <= 1.0 or SHORTEST_USUAL_PERIOD <= step * size <= LONGEST_USUAL_PERIOD)
    ]
    if dated and not calendar:
        return dated
    if calendar:
        return [unit for unit in calendar if step * _SIZES[unit] <= LONGEST_PERIOD] or calendar
    whole = bool(np.all(values[: 1 << 16] == np.rint(values[: 1 << 16])))
    return [
        unit
        for unit, size in _SIZES.items()
        if SHORTEST_USUAL_PERIOD <= step * size <= (LONGEST_PERIOD if unit == "s" else LONGEST_USUAL_PERIOD)
        and (whole or unit != "100ns")
    ]


def _of_day(values: Array) -> Array | None:
    """Return numbers HHMMSS.f as s since midnight, ``None`` where they are none.

    They jump by 40 s at each minute, and are even without that.
    """
    if values.size < 3 or not 0.0 <= float(values.min()) <= float(values.max()) < 240_000.0:
        return None
    steps = np.diff(values)
    if float(steps.max()) < 40.0:
        return None
    minutes, seconds = values // 100.0 % 100.0, values % 100.0
    found = np.asarray(values // 10_000.0 * 3600.0 + minutes * 60.0 + seconds)
    even = np.diff(found)
    usual = float(np.median(even))
    jumps = steps > 40.0
    if minutes.max() >= 60.0 or seconds.max() >= 60.0 or usual <= 0.0 or usual > 1.0:
        return None
    return found if bool(np.all((even[jumps] > 0.0) & (even[jumps] < 3.0 * usual + 1e-3))) else None
