"""Uses of the channels of files, settled in one pass: what each one becomes, and by which conversion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.text import printable
from spool_core.uncertainty import EMPTY_IS_NULL

from spool_bag import BODY, COMMAND, SPOOL, TACHO, TIME
from spool_bag.importing import roles, units
from spool_bag.importing.choices import QUANTITIES, Choices, short, typed
from spool_bag.importing.roles import Channels, Source
from spool_bag.importing.table import LOG_TIME, STAMP, Group, Table
from spool_bag.importing.units import KEPT, NO_UNIT, READINGS, converted, factor, level_of, quantity_of

#: Units to type where a file names none.
_UNITS = {"temperature": "degC", "length": "mm", "force": "N"}
#: Sensitivities to type, by what a sensor puts out.
_EXAMPLES = {
    "voltage": "100mV/g", "reading": "50g/FS", "count": "1.25e-6g/count", "current": "1mA/g",
    "charge": "10pC/g",
}  # fmt: skip
#: What a sensor puts out that loggers write in units with and without a prefix.
_PREFIXED = ("voltage", "current", "charge")
#: Names of a column of fractions of a second beside whole seconds, and their size in s.
_FRACTIONS = units.meanings(units.VOCABULARY["fractions"])

Array = NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class ChannelUse:
    """Use of a channel: which column became what, and the conversion of its values.

    Attributes:
        role: contract name, e.g. ``body_m_s2``.
        file, column, number: file, name of the column there, its number from 0.
        unit: the values' unit, "" where none is known.
        factor: what values are multiplied by; NaN for temperatures with an offset, and for a time whose
            unit is not known or is no time.
        option: that decides, "" where the file does.
    """

    role: str
    file: str
    column: str
    number: int
    unit: str
    factor: float
    option: str = field(default="", metadata=EMPTY_IS_NULL)

    @classmethod
    def of(cls, source: Source, role: str, unit: str, size: float, option: str = "") -> ChannelUse:
        """Return the use of ``source``."""
        channel = source.channel
        return cls(role, source.table.path.name, channel.header, channel.number, unit, size, option)

    def __str__(self) -> str:
        """Column and conversion, for people."""
        kept = KEPT.get(QUANTITIES[self.role], "any unit").replace("**", "^")
        number = f"column #{self.number} " if self.number >= 0 else "column "
        said = f"{short(self.role)}: {number}'{printable(self.column, 60)}'"
        if self.unit == STAMP:
            said += ", dates or times of day"
        elif self.factor == 1.0:
            said += f" in {kept}"
        elif np.isnan(self.factor):
            said += f", {printable(self.unit, 30)} converted to {kept}"
        else:
            said += f", 1 {printable(self.unit, 30)} = {self.factor:.7g} {kept}"
        return said + (f" ({self.option})" if self.option else "")

    def applied(self, values: Array) -> Array:
        """Return values, shape (n,), in the unit of the role; a row of float32 stays one."""
        if self.factor == 1.0:
            return values
        if np.isnan(self.factor):
            return converted(values.astype(np.float64), self.unit, QUANTITIES[self.role]).astype(values.dtype)
        return (values.astype(np.float64) * self.factor).astype(values.dtype)


@dataclass(frozen=True, slots=True)
class Role:
    """Channel that has a role, and the conversion of its values."""

    source: Source
    use: ChannelUse

    @property
    def name(self) -> str:
        """Name of the channel, by which its table reads it."""
        return self.source.channel.name


@dataclass(frozen=True, slots=True)
class ClockRoles:
    """Roles of the channels of a group, which share one clock.

    ``measured``: by role, what the record keeps. ``axis``: time axis, ``None`` where the group has none.
    ``fraction``: fractions of a second beside it. ``others``: channels that may hold the time as well.
    ``counter``: number of each sample, where a rate is given in place of an axis. ``channels``, ``beside``:
    all of the file, and of the group. ``rate``: Hz, as typed, as the file states it, or as its count and
    duration do; NaN without.
    """

    table: Table
    group: Group
    channels: Channels
    beside: Sequence[Source]
    measured: Mapping[str, Role]
    axis: Role | None
    fraction: Role | None
    others: Sequence[Role]
    counter: Source | None
    rate: float

    @property
    def timing(self) -> list[str]:
        """Names of the channels that state when the samples were taken."""
        timed = [one.name for one in (self.axis, self.fraction, *self.others) if one is not None]
        return timed if self.counter is None else [self.counter.channel.name, *timed]


def assigned(tables: Sequence[Table], kind: str, asked: Choices) -> list[ClockRoles]:
    """Return the roles of all channels of a record of ``kind``: of one clock, or of body's and of spool's.

    Args:
        tables: the files, opened and not read yet.
        kind: key of ``REQUIRED``.
        asked: what the user states, which stands over what the files do.

    Raises:
        InputError: a channel or its unit is missing or ambiguous; the message shows what to type.
    """
    channels = roles.channels_of(tables, asked.exclude)
    measured = _converted(roles.chosen(channels, kind, asked), asked)
    first, second = roles.REQUIRED[kind]
    clock = measured[first].source.clock
    if clock == measured[second].source.clock:
        beside = {role: one for role, one in measured.items() if one.source.clock == clock}
        return [_of_clock(channels, beside, asked)]
    if kind != "accelerations":
        raise InputError(f"{tables[0].path}: displacement and force must be in one file, sampled together")
    return [_of_clock(channels, {role: measured[role]}, asked) for role in (first, second)]


def _of_clock(channels: Channels, measured: Mapping[str, Role], asked: Choices) -> ClockRoles:
    """Return the roles of a group whose channels ``measured`` have theirs already.

    Raises:
        InputError: the time axis that is asked for is missing or has another role, or nothing states when the
            samples were taken.
    """
    taken = [role.source for role in measured.values()]
    table, group = taken[0].table, taken[0].group
    channels = Channels((table,), tuple(one for one in channels.sources if one.table is table))
    beside = [one for one in channels.sources if one.group is group]
    free = [one for one in beside if one not in taken]
    axis = roles.time_axis_of(channels, group, free, asked)
    fraction: Role | None = None
    others: list[Role] = []
    counter = next(filter(roles.counts, beside), None) if axis is None and asked.rate else None
    if axis is not None:
        free = [one for one in free if one is not axis]
        part = next((one for one in free if _fraction(one) in _FRACTIONS), None)
        if part is not None:
            fraction = Role(part, ChannelUse.of(part, TIME, "", _FRACTIONS[_fraction(part)]))
        # The times of sending and of reception of a bag's messages are a choice of the user.
        if all(one.channel.name != LOG_TIME for one in beside):
            times = [one for one in free if one is not part and roles.may_be_time(one)]
            others = [Role(one, _use_of_time(one, Choices())) for one in times]
    timed = None if axis is None else Role(axis, _use_of_time(axis, asked))
    rate = asked.rate or group.rate
    if axis is None and asked.zone:
        raise InputError(f"{table.path}: --zone {asked.zone}: it has no column of times: leave --zone out")
    if axis is None and math.isnan(rate):
        held = ", ".join(printable(one.channel.name, 40) for one in beside[:12])
        raise InputError(
            f"{table.path}: no column {TIME} and no sampling rate in it; it has {held}: "
            + (group.doubt or "name the column of times, or give the rate, e.g. --rate 2000 for 2000 Hz")
        )
    rate = group.count / group.span if math.isnan(rate) else rate
    return ClockRoles(table, group, channels, beside, measured, timed, fraction, others, counter, rate)


def _fraction(source: Source) -> str:
    """Return the last part of a name such as `header.stamp.nsecs`."""
    return source.name.lower().rpartition(".")[2]


def _converted(sources: Mapping[str, Source], asked: Choices) -> dict[str, Role]:
    """Return channels by role with their conversions.

    Raises:
        InputError: units that are missing, unknown, or do not fit, with what to type for all of them.
    """
    found: dict[str, Role] = {}
    refused: dict[str, _RefusalError] = {}
    for role, one in sources.items():
        try:
            found[role] = Role(one, _use_of(role, one, asked))
        except _RefusalError as error:
            refused[role] = error
    if not refused:
        return found
    first = next(iter(refused.values()))
    alike = [
        role for role, error in refused.items() if (error.why, error.advice) == (first.why, first.advice)
    ]
    path = sources[alike[0]].table.path
    names = " and ".join(sources[role].label for role in alike)
    many = len(alike) > 1
    why = first.why.replace(" has ", " have ", 1).replace(" is ", " are ", 1) if many else first.why
    ways = [typed(option, {short(role): value for role in alike}) for option, value in first.advice]
    raise InputError(f"{path}: {names}{why}: {first.hint}{', or '.join(ways)}")


def _use_of_time(source: Source, asked: Choices) -> ChannelUse:
    """Return how a time axis is converted to s; the factor is NaN where no unit of time is stated."""
    channel = source.channel
    if channel.unit == STAMP:
        return ChannelUse.of(source, TIME, STAMP, 1.0)
    unit = asked.units.get(TIME) or channel.unit or ("s" if asked.states_unit(TIME) else "")
    size = factor(unit, "time") if quantity_of(unit) == "time" else float("nan")
    why = f"--unit time={unit}" if TIME in asked.units else "" if channel.unit else f"--columns {TIME}=..."
    return ChannelUse.of(source, TIME, unit, size, why)


class _RefusalError(Exception):
    """Refusal of one channel: why, and what to type for it: alternatives of option and value."""

    def __init__(self, why: str, advice: Sequence[tuple[str, str]], hint: str = "") -> None:
        super().__init__(why)
        self.why, self.advice, self.hint = why, tuple(advice), hint


def _use_of(role: str, source: Source, asked: Choices) -> ChannelUse:
    channel, quantity, way = source.channel, QUANTITIES[role], short(role)
    own = "" if channel.unit.strip().casefold() in NO_UNIT else channel.unit
    unit = asked.units.get(role) or own
    scale = asked.scales.get(role)
    if role in (TACHO, COMMAND):
        pulses = f"--pulses-per-revolution {asked.pulses}" if role == TACHO else ""
        return ChannelUse.of(source, role, "", 1.0, pulses)
    why = f"--unit {way}={unit}" if role in asked.units else ""
    if why and own and own != unit:
        why += f" instead of the file's {printable(own, 20)}"
    if scale is not None:
        if role not in (BODY, SPOOL):
            raise InputError(f"--scale {way}: only accelerations have a sensor's sensitivity: leave it out")
        try:
            size = scale.scale(unit)
        except InputError as error:
            reading = scale.reading.replace("percent_full_scale", "%FS").replace("coulomb", "C")
            raise _RefusalError(f": {error}", [("--unit", reading)], "if it is not, type ") from error
        if not unit and quantity_of(scale.reading) in _PREFIXED:
            base = READINGS[quantity_of(scale.reading)].replace("coulomb", "C")
            raise _RefusalError(
                f" has no unit, and --scale {way}={scale.text} does not state whether it is in {base} or "
                f"m{base}",
                [("--unit", base), ("--unit", f"m{base}")],
                "add the one that holds, ",
            )
        taken = "" if unit else f"no unit in the file, read in {scale.reading}, "
        why = f"{taken}--scale {way}={scale.text}" + (f", {why}" if why else "")
        return ChannelUse.of(source, role, unit or scale.reading, size, why)
    if not unit:
        if asked.states_unit(role):
            return ChannelUse.of(source, role, "", 1.0, f"no unit in the file, --columns {role}=... says it")
        raise _no_unit(quantity)
    found = quantity_of(unit)
    scaling = channel.scaling
    if scaling.doubt and not asked.gives(role) and found == quantity:
        raise _RefusalError(
            f" has whole numbers and {scaling.doubt}",
            [("--scale", f"{scaling.size:.7g}{unit}/count"), ("--unit", unit)],
            "it may still have to be applied: if so, type --unit "
            f"{way}=count and the first of these, else the second: ",
        )
    if found == quantity:
        if quantity != "temperature":
            return ChannelUse.of(source, role, unit, factor(unit, quantity), why)
        # A unit whose zero is not that of degC has no factor.
        shifted = float(converted(np.zeros(1), unit, quantity)[0]) != 0.0
        return ChannelUse.of(source, role, unit, float("nan") if shifted else 1.0, why)
    shown = "shares of full scale (FS)" if unit == "FS" else printable(unit, 30)
    if found in READINGS and quantity == "acceleration":
        raise _RefusalError(
            f" is in {shown}", [("--scale", _EXAMPLES[found])], "give the sensor's sensitivity, e.g. "
        )
    raise _wrong_unit(unit, shown, found, quantity)


def _no_unit(quantity: str) -> _RefusalError:
    if quantity != "acceleration":
        return _RefusalError(" has no unit", [("--unit", _UNITS.get(quantity, "s"))], "state it, e.g. ")
    return _RefusalError(
        " has no unit and could be in g, m/s^2, volts or counts",
        [("--unit", "g"), ("--unit", "m/s^2"), ("--unit", "V"), ("--scale", "1.25e-6g/count")],
        "type ",
    )


def _wrong_unit(unit: str, shown: str, found: str, quantity: str) -> _RefusalError:
    """Return the refusal of a unit that is named, but is not known or measures something else."""
    level = level_of(unit)
    if level and quantity_of(level[0]) == quantity:
        return _RefusalError(
            f" is in {shown}, a statistic ({level[1]}) and not a sample",
            [("--unit", level[0])],
            "export the samples, or if these are instantaneous values type ",
        )
    usual = [
        ("--unit", text) for text in (("g", "m/s^2") if quantity == "acceleration" else (_UNITS[quantity],))
    ]
    if not found:
        return _RefusalError(f" is in {shown}, a unit that is not known", usual, "type the right one, e.g. ")
    return _RefusalError(
        f" is in {shown}, a unit of {found} and not of {quantity}",
        usual[-1:],
        "name another column with --columns, or if the header is wrong type ",
    )
