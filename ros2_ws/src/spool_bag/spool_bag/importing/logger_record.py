"""Record of a data logger: channels in SI units on one time base, whatever file they came from."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import GRAVITY
from spool_core.text import plural, printable

from spool_bag import BODY, SLOW, SPEED, SPOOL, TACHO
from spool_bag.importing.channel_use import ChannelUse, ClockRoles, assigned
from spool_bag.importing.choices import Choices, choices, short, typed
from spool_bag.importing.csv_layout import listed
from spool_bag.importing.formats.format import open_table, read_channels
from spool_bag.importing.mixed_sources import mixed
from spool_bag.importing.roles import REQUIRED, Source
from spool_bag.importing.table import STAMP, Table, Values
from spool_bag.importing.tacho import TachoSpeed, speed_from_pulses
from spool_bag.importing.time_axis import ClockOffset, TimeAxis, axis_of, finite
from spool_bag.importing.time_base import TimeBase, sampled
from spool_bag.importing.two_clocks import Series, TopicTimes, check_one_time, merged

#: Relative deviation of a rate below which it is not stated: stamps do not show the error of their clock,
#: which is 1e-5 to 1e-4 of a quartz.
CLOCKS_OWN = 1e-6
#: m/s^2, some 200 g: hardly any machine shakes a valve like that.
LARGEST_USUAL_RMS = 2000.0
#: ns since 1970 of the year 2000: earlier stamps are those of a clock that was never set.
EARLIEST = 946_684_800_000_000_000
#: Gravity in units in which drivers publish, beyond that of the format, and how far off it a sensor may be.
GRAVITY_IN = {"g": 1.0, "mg": 1000.0, "mm/s^2": 9806.65}
GRAVITY_OFF = 0.07
#: Relative difference of a recorded speed from that of the pulses, beyond which it is a warning.
SPEEDS_OFF = 0.02
#: Rows without a time below the samples.
MOST_FOOTER = 50
#: Relative difference of a duration that is stated from that of the samples, beyond which it is a warning.
SPAN_OFF = 0.02
_PIECE = 1 << 20

Array = NDArray[Any]


@dataclass(slots=True)
class LoggerRecord:
    """Record as arrays of shape (n,).

    Attributes:
        path: the file, the body's where there are two.
        time: s, increases; from ``start`` on where that is known.
        columns: by contract name, in the unit of that name.
        period: s, between samples.
        gaps: index of each first sample after a gap.
        start: ns since 1970 at ``time`` 0, ``None`` where the file does not say.
        warnings, notes: what is not as it should be, and how the file was understood, one line each.
        repairs: counts of what was repaired, by name.
        clocks: how two clocks were brought together, ``None`` for one clock.
        uses: which column became what, and by which conversion.
        rate_std: relative standard deviation of the sampling rate, from the stamps; 0 where it is stated.
    """

    path: Path
    time: NDArray[np.float64]
    columns: dict[str, Array]
    period: float
    gaps: NDArray[np.int64]
    start: int | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    repairs: Mapping[str, int] = field(default_factory=dict)
    clocks: ClockOffset | None = None
    uses: tuple[ChannelUse, ...] = ()
    rate_std: float = 0.0

    @property
    def duration(self) -> float:
        """From the first sample to the end of the last one, s."""
        return float(self.time[-1] - self.time[0]) + self.period


def read_record(
    paths: Path | str | Sequence[Path | str],
    kind: str = "accelerations",
    columns: Mapping[str, str] | None = None,
    *,
    how: Choices | None = None,
    regular: bool = True,
    single: bool = False,
) -> LoggerRecord:
    """Read files of any known format as one record of ``kind`` (a key of ``REQUIRED``).

    Args:
        paths: one file, or two whose channels are on different clocks.
        kind: two accelerations, or displacement and force of a driven or imposed motion.
        columns: the files' own names by contract name, e.g. ``{"time_s": "t"}``.
        how: all choices; ``columns`` are among them.
        regular: with False times may be spaced as they like; the period is then their median step.
        single: accelerations as float32, as a bag holds them.

    Raises:
        InputError: what is wrong, where, and what to type instead.
    """
    files = [Path(one) for one in ([paths] if isinstance(paths, (str, Path)) else paths)]
    asked = how or choices()
    if columns:
        asked = replace(asked, columns=columns)
    tables = [open_table(path) for path in files]
    for table in tables:
        table.dates = asked.dates
    clocks = assigned(tables, kind, asked)
    if len(clocks) == 1:
        record = _of_clock(clocks[0], kind, asked, regular=regular, single=single)
    else:
        sides = [_of_clock(one, kind, asked, regular=True, single=False) for one in clocks]
        record = _together(sides, clocks[0].measured[BODY].source, clocks[1].measured[SPOOL].source, asked)
    if asked.pulses is not None and not any(use.role == TACHO for use in record.uses):
        raise InputError(f"{files[0]}: the tacho must be sampled together with body and spool, on one clock")
    notes = [
        f"{table.path.name}: {note}" if len(tables) > 1 else note for table in tables for note in table.notes
    ]
    record.notes = (*notes, *record.notes, *map(str, record.uses))
    record.warnings = (*(text for table in tables for text in table.warnings), *record.warnings)
    if kind == "accelerations":
        record.warnings = (*record.warnings, *_filtered_apart(clocks), *_doubts(record.columns))
    if record.start is not None and record.start < EARLIEST and any(table.clocks for table in tables):
        text = (
            f"stamps begin at {1e-9 * record.start:.3f} s, as after a start of the machine: they have no date"
        )
        record.warnings = (*record.warnings, f"{text}; type --start to give the record its own")
        record.start = None
    return record


def _of_clock(clock: ClockRoles, kind: str, asked: Choices, *, regular: bool, single: bool) -> LoggerRecord:
    """Return the record of channels that share one clock."""
    table, group, measured = clock.table, clock.group, clock.measured
    values, warnings = _samples_of(clock, kind, asked, single=single)
    axis = axis_of(clock, values, asked.zone)
    found: dict[str, Array] = {}
    for role, one in measured.items():
        numbers = one.use.applied(np.asarray(values[one.name]))
        found[role] = finite(table.path, one.name, numbers, table.where, holes=role in SLOW)
    values.clear()
    rows = [row for role, row in found.items() if role not in SLOW]
    _check_one_source(clock, axis, rows)
    base = sampled(clock, axis, rows, asked.rate, kind, regular=regular)
    if base.kept is not None:
        found = {role: row[base.kept] for role, row in found.items()}
    warnings += base.warnings
    notes, repairs = [*axis.notes], dict(base.repairs)
    if TACHO in found:
        turning = _with_speed(found, base, asked.pulses or 1, f"{table.path}: {measured[TACHO].name}")
        warnings += turning.warnings
        notes.append(str(turning))
        repairs |= turning.repairs
    notes.append(base.note)
    table.account(group.name, "s", group.span, base.time.size * base.period, off=SPAN_OFF)
    channels = [one.source.channel for one in measured.values()]
    notes += [f"{printable(one.header, 40)}: {one.scaling}" for one in channels if one.scaling.applied]
    left = table.settings.unused(one.name for one in channels)
    if left:
        notes.append(f"stated in the file and not used: {listed(left)}")
    timed = [axis.role.use] if axis.role is not None and axis.role.use.unit else []
    return LoggerRecord(
        table.path,
        base.time,
        found,
        base.period,
        base.gaps,
        group.start if axis.start is None else axis.start,
        tuple(warnings),
        tuple(notes),
        repairs,
        uses=(*timed, *(one.use for one in measured.values())),
        rate_std=base.rate_std if base.rate_std > CLOCKS_OWN else 0.0,
    )


def _samples_of(
    clock: ClockRoles, kind: str, asked: Choices, *, single: bool
) -> tuple[dict[str, Values], list[str]]:
    """Return a clock's channels by name without rows that are no samples, the oldest first.

    Also a line about rows that were left out.
    """
    table, axis, measured = clock.table, clock.axis, clock.measured
    small = [one.name for role, one in measured.items() if single and role in (BODY, SPOOL)]
    names = list(dict.fromkeys([*clock.timing, *(one.name for one in measured.values())]))
    values = _read(clock, names, small)
    _check_gravity(clock, asked)
    warnings = [] if axis is None else _without_footer(table, axis.name, values)
    if table.holes_are_gaps or asked.empty_as_gap:
        required = [one.name for role, one in measured.items() if role in REQUIRED[kind]]
        required += [axis.name] if axis is not None else []
        warnings += _without_holes(
            values, required, "that the file marks as invalid" if table.holes_are_gaps else "that are empty"
        )
    times = np.zeros(0) if axis is None else values[axis.name]
    if times.size > 2 and times[-1] < times[0] and bool(np.all(times[1:] <= times[:-1])):
        values = {name: row[::-1] for name, row in values.items()}
        table.notes = (*table.notes, "the newest row stands first: read from the end")
    return values, warnings


def _check_gravity(clock: ClockRoles, asked: Choices) -> None:
    """Check that the gravity that three axes show is in the unit that their format prescribes.

    Raises:
        InputError: it is in another one, and the user states none.
    """
    path, name = clock.table.path, clock.group.name
    shown = clock.table.gravity.get(name, 0.0)
    unit = next((unit for unit, size in GRAVITY_IN.items() if abs(shown / size - 1.0) < GRAVITY_OFF), "")
    open_roles = [role for role in clock.measured if role in (BODY, SPOOL) and not asked.gives(role)]
    if unit and open_roles:
        ways = [typed("--unit", {short(role): one for role in open_roles}) for one in (unit, "m/s^2")]
        raise InputError(
            f"{path}: {printable(name, 60)}: its three axes show {shown:.3g} as gravity: they "
            f"seem to be in {unit}, not in m/s^2 as this message prescribes: type {ways[0]}; or {ways[1]} "
            "if gravity was removed"
        )


def _check_one_source(clock: ClockRoles, axis: TimeAxis, rows: Sequence[Array]) -> None:
    """Check that each channel holds the samples of one sensor.

    Raises:
        InputError: several take turns in it.
    """

    def others() -> dict[str, NDArray[np.float64]]:
        names = [
            one.name
            for one in (source.channel for source in clock.beside)
            if one.name not in clock.timing and one.unit != STAMP and not one.role
        ]
        try:
            held = read_channels(clock.table, clock.group, names, ()) if names else {}
        except InputError:  # a channel that nobody asked for
            held = {}
        return {name: row.astype(np.float64) for name, row in held.items() if row.size == axis.time.size}

    why = mixed(axis.time, rows, others)
    if why:
        raise InputError(
            f"{clock.table.path}: {why}: rows of several sensors, or of several publishers on one topic: "
            "write each sensor into its own column, file or topic"
        )


def _without_footer(table: Table, axis: str, values: dict[str, Values]) -> list[str]:
    """Leave out rows without a time at a file's end, such as statistics, and return a line about them."""
    time = values[axis]
    timed = np.flatnonzero(~np.isnan(time))
    end = int(timed[-1]) + 1 if timed.size else time.size
    left = time.size - end
    if not 0 < left <= MOST_FOOTER:
        return []
    for name, row in values.items():
        values[name] = row[:end]
    return [f"left out at the file's end: {plural(left, 'row')} without a time, from {table.where(end)} on"]


def _without_holes(values: dict[str, Values], required: Sequence[str], what: str) -> list[str]:
    """Leave out the rows without a value in a required channel, and return a line about them."""
    whole = ~np.logical_or.reduce([np.isnan(values[name]) for name in required])
    missing = int(np.count_nonzero(~whole))
    if not missing:
        return []
    every = round(whole.size / max(whole.size - missing, 1))
    if every > 1 and set(np.diff(np.flatnonzero(whole)).tolist()) == {every}:
        what += f", all but every {every}th: what was sampled faster is decimated without a filter, and folds"
    for name, row in values.items():
        values[name] = row[whole]
    return [f"{plural(missing, 'row')} with values {what} {'is' if missing == 1 else 'are'} left out"]


def _filtered_apart(clocks: Sequence[ClockRoles]) -> list[str]:
    """Return a line where another filter or decimation is stated of one acceleration than of the other."""
    stated = {
        short(role): clock.table.settings.filters(one.name)
        for clock in clocks
        for role, one in clock.measured.items()
        if role in (BODY, SPOOL)
    }
    names = sorted({name for own in stated.values() for name in own})
    apart = [name for name in names if len({own.get(name) for own in stated.values()}) > 1]
    if not apart:
        return []
    shown = ", ".join(
        f"{role}: {name} = {own.get(name, 'not stated')}" for name in apart for role, own in stated.items()
    )
    return [
        f"body and spool were filtered or decimated differently ({shown}): the delay between them looks like "
        "friction and drag; record both alike"
    ]


def _with_speed(found: dict[str, Array], base: TimeBase, pulses: int, label: str) -> TachoSpeed:
    """Replace the tacho in ``found`` by the speed of its pulses, and return it."""
    label = printable(label)
    turning = speed_from_pulses(found.pop(TACHO), base.time, base.gaps, pulses, label)
    ratio = float(np.nanmedian(found[SPEED] / turning.rpm)) if SPEED in found else 1.0
    if abs(ratio - 1.0) > SPEEDS_OFF:
        turning.warnings.append(
            f"{label}: its speed is used; {SPEED} is {ratio:.3g} times it: check --pulses-per-revolution"
        )
    found[SPEED] = turning.rpm
    return turning


def _read(clock: ClockRoles, names: Sequence[str], small: Sequence[str]) -> dict[str, Values]:
    """Return channels by name; what is wrong with an optional one alone can be left out."""
    table, group = clock.table, clock.group
    try:
        return read_channels(table, group, names, small)
    except InputError as error:
        for slow in (one for role, one in clock.measured.items() if role in SLOW):
            try:
                read_channels(table, group, [name for name in names if name != slow.name], small)
            except InputError:
                continue
            way = shlex.quote(clock.channels.reference(slow.source))
            raise InputError(f"{error}: correct it, or leave the column out with --exclude {way}") from error
        raise


def _together(sides: Sequence[LoggerRecord], first: Source, second: Source, asked: Choices) -> LoggerRecord:
    """Return one record of body and spool that were sampled by two clocks."""
    body, spool = sides
    if not asked.align:
        raise InputError(
            f"{body.path}: {first.label} and {second.label} are on two clocks, and --align none says "
            "to leave them so: "
            "leave it out, or give one file in which both were sampled together"
        )
    shared = first.table is second.table and first.group.stamped and second.group.stamped
    clocks = [(one.group.name, first.table.clocks.get(one.group.name)) for one in (first, second)]
    times = [TopicTimes(name, *found) for name, found in clocks if found is not None]
    doubts = check_one_time(body.path, *times) if shared and len(times) == 2 else []
    series = [
        Series(str(one.path), one.time, row, one.period, one.gaps, one.start)
        for one, row in ((body, body.columns[BODY]), (spool, spool.columns[SPOOL]))
    ]
    joined = merged(*series, shared_clock=shared)
    named = (("body", body), ("spool", spool))
    repairs = {f"{name}_{side}": count for side, one in named for name, count in one.repairs.items()}
    notes = [f"{side}: {note}" for side, one in named for note in one.notes]
    warnings = [f"{side}: {text}" for side, one in named for text in one.warnings]
    return LoggerRecord(
        body.path,
        joined.time,
        {BODY: joined.body, SPOOL: joined.spool},
        joined.period,
        joined.gaps,
        joined.start,
        (*warnings, *doubts),
        (*notes, joined.note),
        repairs,
        joined.clocks,
        (*body.uses, *spool.uses),
        rate_std=max(one.rate_std for one in sides),
    )


def _doubts(columns: Mapping[str, Array]) -> list[str]:
    """Return what is odd about the size of the accelerations."""
    warnings, size = [], {}
    for name in (BODY, SPOOL):
        row = columns[name]
        pieces = (row[at : at + _PIECE].astype(np.float64) for at in range(0, row.size, _PIECE))
        size[name] = rms = math.sqrt(sum(float(piece @ piece) for piece in pieces) / row.size)
        if rms > LARGEST_USUAL_RMS:
            warnings.append(f"{name} has an rms of {rms:.0f} m/s^2: are these mm/s^2 or raw counts?")
    if min(size.values()) > 0.0:
        ratio = math.log(size[SPOOL] / size[BODY])
        if abs(abs(ratio) - math.log(GRAVITY)) < 0.02:
            smaller = BODY if ratio > 0.0 else SPOOL
            warnings.append(f"body and spool differ by a factor of 9.81: is {smaller} in g instead of m/s^2?")
    return warnings
