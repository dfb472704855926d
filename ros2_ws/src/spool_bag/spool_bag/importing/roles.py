"""Roles of channels: which one is what, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag import BODY, DISPLACEMENT, FORCE, OIL_TEMPERATURE, SPOOL, TIME
from spool_bag.importing.channel_use import ChannelUse
from spool_bag.importing.choices import QUANTITIES, SHORT, Choices, role_of, short, typed
from spool_bag.importing.csv_layout import listed
from spool_bag.importing.table import LOG_TIME, STAMP, Channel, Group, Table
from spool_bag.importing.units import (
    NO_UNIT,
    READINGS,
    WORDS,
    converted,
    factor,
    level_of,
    quantity_of,
    split_header,
)

REQUIRED = {"accelerations": (BODY, SPOOL), "driven": (DISPLACEMENT, FORCE), "imposed": (DISPLACEMENT, FORCE)}
OPTIONAL = {"accelerations": (OIL_TEMPERATURE,), "driven": (), "imposed": ()}
#: Names of a column that counts samples.
COUNTERS = ("sample", "samples", "index", "nr", "no", "n", "count", "number", "abtastwert", "sequence")
#: What may stand in a name that is typed on the command line.
_TYPEABLE = re.compile(r"[^,=#'\"\\$`!:][^,='\"\\$`!]{0,39}")

Array = NDArray[np.floating]

#: Units to type where a file names none.
_UNITS = {"temperature": "degC", "length": "mm", "force": "N"}
#: Sensitivities to type, by what a sensor puts out.
_EXAMPLES = {
    "voltage": "100mV/g", "reading": "50g/FS", "count": "1.25e-6g/count", "current": "1mA/g",
    "charge": "10pC/g",
}  # fmt: skip


#: What a sensor puts out that loggers write in units with and without a prefix.
_PREFIXED = ("voltage", "current", "charge")


@dataclass(frozen=True, slots=True)
class Source:
    """Source of a role: a channel of a group of a file."""

    table: Table
    group: Group
    channel: Channel

    @property
    def clock(self) -> tuple[int, str]:
        """What it shares with the channels that were sampled with it."""
        return id(self.table), self.group.name

    @property
    def label(self) -> str:
        """Name for messages, printable."""
        group = f"{self.group.name}/" if self.group.name else ""
        return printable(f"{group}{self.channel.name}", 80)


def reference(tables: Sequence[Table], source: Source) -> str:
    """Return what ``--columns`` takes to mean just this channel: its name, or the number of its column."""
    file = f"{source.table.path.name}:" if len(tables) > 1 else ""
    group = f"{source.group.name}/" if source.group.name else ""
    channel = source.channel
    sources = sources_of(tables)
    for text in (channel.name, f"{group}{channel.name}", f"{file}{group}{channel.name}"):
        if _TYPEABLE.fullmatch(text) and text.isprintable() and _called(sources, text) == [source]:
            return text
    return next(
        (
            text
            for text in (f"#{channel.number}", f"{group}#{channel.number}")
            if _called(sources, text) == [source]
        ),
        f"{file}{group}#{channel.number}",
    )


def sources_of(tables: Sequence[Table]) -> list[Source]:
    """Return all channels of all files."""
    return [
        Source(table, group, channel)
        for table in tables
        for group in table.groups
        for channel in group.channels
    ]


def exclude(tables: Sequence[Table], names: Sequence[str]) -> None:
    """Leave channels out of ``tables``, by name or number, as ``--exclude`` asks.

    Raises:
        InputError: there is no such channel.
    """
    left: list[Source] = []
    for name in names:
        found = _called(sources_of(tables), name)
        if not found:
            raise InputError(
                f"--exclude: {tables[0].path}: no column {printable(name, 60)}; it has {_held(tables)}"
            )
        left += found
    for table in tables:
        gone = {(one.group.name, one.channel.name) for one in left if one.table is table}
        table.groups = tuple(
            replace(
                group, channels=tuple(one for one in group.channels if (group.name, one.name) not in gone)
            )
            for group in table.groups
        )


def chosen(tables: Sequence[Table], kind: str, asked: Choices) -> dict[str, Source]:
    """Return the source of each role of a record of ``kind``, its time left out.

    Args:
        tables: the files.
        kind: key of ``REQUIRED``.
        asked: the files' own names, topics and axes by role; units that stand over those of the file.

    Raises:
        InputError: a channel is missing or could be several; what to type is said.
    """
    wanted = {role_of(name): own for name, own in asked.columns.items()}
    roles = (*REQUIRED[kind], *OPTIONAL[kind])
    stray = [role for role in wanted if role not in (*roles, TIME)]
    if stray:
        raise InputError(f"--columns: {stray[0]!r} is not one of {', '.join((TIME, *roles))}")
    sources = sources_of(tables)
    found: dict[str, Source] = {}
    for role in roles:
        if role in asked.topics:
            found[role] = _of_topic(tables, sources, *asked.topics[role])
        elif role in wanted:
            found[role] = named(tables, sources, wanted[role], role)
    missing = []
    for role in roles:
        if role not in found:
            source = _recognised(
                tables, sources, role, list(found.values()), asked, required=role in REQUIRED[kind]
            )
            if source is not None:
                found[role] = source
            elif role in REQUIRED[kind]:
                missing.append(role)
    if missing:
        raise _missing(tables, sources, missing, found, asked)
    doubled = [role for role, one in found.items() if list(found.values()).count(one) > 1]
    if doubled:
        free = _candidates(sources, doubled[1:], list(found.values()), asked)
        ways = [typed("--columns", {short(doubled[1]): reference(tables, one)}) for one in free[:2]]
        raise InputError(
            f"{tables[0].path}: {found[doubled[0]].label} is named for {' and '.join(doubled)}: "
            f"name a column for each{', e.g. ' if ways else ''}{', or '.join(ways)}"
        )
    return {role: found[role] for role in roles if role in found}


def time_of(table: Table, group: Group, asked: Choices, taken: Sequence[Source] = ()) -> Channel | None:
    """Return the time axis of a group, ``None`` where it has none.

    Args:
        table, group: where to look.
        asked: the columns that are named, and the rate; where that is given, no column of a doubtful name is
        one.
        taken: channels that are something else.

    Raises:
        InputError: a column that is named is not there.
    """
    if asked.stamps in ("log", "arrival"):
        log = next((one for one in group.channels if one.name == LOG_TIME), None)
        if log is None:
            raise InputError(
                f"{table.path}: --stamps {asked.stamps}: only messages with a header have two times: leave "
                "it out"
            )
        return log
    own = next((own for name, own in asked.columns.items() if SHORT.get(name, name) == TIME), None)
    sources = [Source(table, group, one) for one in group.channels]
    if own is not None:
        source = named([table], sources, own, TIME)
        role = next((one for one in taken if one == source), None)
        if role is not None:
            raise InputError(
                f"{table.path}: {source.label} is named for {TIME} and for another channel: name a column "
                f"for each "
                "with --columns"
            )
        return source.channel
    free = [one.channel for one in sources if one not in taken and not one.channel.role]
    marked = [one for one in free if one.time]
    if marked:
        return marked[0]
    in_time = [one for one in free if quantity_of(one.unit) == "time"]
    fitting = [one for one in free if _is_called(one, TIME) and quantity_of(one.unit) in ("", "time")]
    if asked.rate:
        fitting = [
            one for one in fitting if one in in_time or split_header(one.header)[0].lower() in WORDS["time"]
        ]
    fitting = fitting or (in_time if len(in_time) == 1 else [])
    exact = [one for one in fitting if one.header == TIME] or fitting
    return exact[0] if exact else None  # the others are compared with it


def counter_of(group: Group) -> Channel | None:
    """Return the channel of a group that counts its samples by its name, ``None`` where there is none."""
    return next((one for one in group.channels if _words(one.name) and _words(one.name)[0] in COUNTERS), None)


def named(tables: Sequence[Table], sources: Sequence[Source], own: str, role: str) -> Source:
    """Return the channel called ``own``: its name, ``#3`` by number, ``group/channel``, or ``FILE:channel``.

    Raises:
        InputError: there is none, or it is there several times.
    """
    fitting = _called(sources, own)
    if not fitting:
        numbers = _called(sources, f"#{own}") if own.isdecimal() else []
        hint = (
            f": by number it is {typed('--columns', {short(role): reference(tables, numbers[0])})}"
            if numbers
            else ""
        )
        raise InputError(f"{tables[0].path}: no column {printable(own, 60)}; it has {_held(tables)}{hint}")
    if len(fitting) > 1:
        ways = [typed("--columns", {short(role): reference(tables, one)}) for one in fitting[:2]]
        raise InputError(
            f"{fitting[0].table.path}: column {printable(own, 60)} is there {len(fitting)} times: write "
            f"{', or '.join(ways)}"
        )
    return fitting[0]


def uses_of(sources: Mapping[str, Source], asked: Choices) -> dict[str, ChannelUse]:
    """Return how each channel is converted, by role.

    Raises:
        InputError: units that are missing, unknown, or do not fit, with what to type for all of them.
    """
    uses: dict[str, ChannelUse] = {}
    refused: dict[str, _RefusalError] = {}
    for role, one in sources.items():
        try:
            uses[role] = _use_of(role, one, asked)
        except _RefusalError as error:
            refused[role] = error
    if not refused:
        return uses
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


def use_of_time(path: str, axis: Channel, asked: Choices) -> ChannelUse | None:
    """Return how a time axis is converted to s, ``None`` where the file names no unit of time."""
    unit = asked.units.get(TIME) or axis.unit or ("s" if asked.states_unit(TIME) else "")
    if unit != STAMP and quantity_of(unit) != "time":
        return None
    size = 1.0 if unit == STAMP else factor(unit, "time")
    why = f"--unit time={unit}" if TIME in asked.units else "" if axis.unit else f"--columns {TIME}=..."
    return ChannelUse(TIME, path, axis.header, axis.number, unit, size, why)


def _called(sources: Sequence[Source], own: str) -> list[Source]:
    """Return the channels that are called ``own``: exactly, without their unit, or else by number."""
    for names in (_whole_names, _plain_names, _numbers):
        fitting = [one for one in sources if own.removeprefix(f"{one.table.path.name}:") in names(one)]
        fitting = [one for one in fitting if one.table.path.name == own.partition(":")[0]] or fitting
        if fitting:
            return fitting
    return []


def _whole_names(source: Source) -> set[str]:
    group, channel = source.group.name, source.channel
    own = {channel.name, channel.header}
    return own | {f"{group}/{name}" for name in own} if group else own


def _plain_names(source: Source) -> set[str]:
    own = split_header(source.channel.header)[0]
    return {own, f"{source.group.name}/{own}"}


def _numbers(source: Source) -> set[str]:
    own = f"#{source.channel.number}"
    return {own, f"{source.group.name}/{own}"}


def _of_topic(tables: Sequence[Table], sources: Sequence[Source], topic: str, axis: str) -> Source:
    fitting = [one for one in sources if one.group.name.strip("/") == topic.strip("/")]
    if not fitting:
        held = listed([group.name for table in tables for group in table.groups])
        raise InputError(f"{tables[0].path}: no topic {printable(topic, 60)} of accelerations; it has {held}")
    found = [one for one in fitting if one.channel.name == axis]
    if not found:
        axes = ", ".join(one.channel.name for one in fitting if one.channel.unit != STAMP)
        raise InputError(
            f"{tables[0].path}: {printable(topic, 60)} has no axis {printable(axis, 20)!r}: name one "
            f"of {axes}"
        )
    return found[0]


def _recognised(
    tables: Sequence[Table],
    sources: Sequence[Source],
    role: str,
    taken: Sequence[Source],
    asked: Choices,
    *,
    required: bool,
) -> Source | None:
    """Return the channel that has a role by its name and unit."""
    free = [one for one in sources if one not in taken]
    fitting = [one for one in free if role in (one.channel.role, one.channel.header)]
    called = [one for one in free if _is_called(one.channel, role) and one.channel.unit != STAMP]
    fitting = fitting or [one for one in called if asked.gives(role) or _may_be(one.channel, role)]
    beside = [one for one in fitting if one.group in [other.group for other in taken]]
    if len(fitting) > 1 and len(beside) == 1:
        fitting = beside
    if len(fitting) == 1:
        return fitting[0]
    if fitting and required:
        ways = [typed("--columns", {short(role): reference(tables, one)}) for one in fitting[:2]]
        raise InputError(
            f"{fitting[0].table.path}: {listed([one.label for one in fitting])} could be {role}: say which "
            f"with "
            f"{', or '.join(ways)}"
        )
    if required and len(called) == 1:
        return called[0]  # refused for its unit, by name
    return None


def _missing(
    tables: Sequence[Table],
    sources: Sequence[Source],
    roles: Sequence[str],
    found: Mapping[str, Source],
    asked: Choices,
) -> InputError:
    """Return the error of roles that no channel has, with what to type."""
    files, held = ", ".join(str(table.path) for table in tables), _held(tables)
    free = _candidates(sources, roles, list(found.values()), asked)
    numbered = [one for one in free if one.channel.header.isdecimal()]
    if len(numbered) == len(free) > len(roles) and TIME not in {
        SHORT.get(name, name) for name in asked.columns
    }:
        free = free[1:]  # of a file without names the first column is usually its time
        ways = {"time": reference(tables, numbered[0])} if not asked.rate else {}
    else:
        ways = {}
    if any(one.group.name.startswith("/") for one in sources):
        topics = [f"{one.group.name}:{one.channel.name}" for one in _one_a_topic(free, len(roles))]
        advice = typed("--topic", {short(role): topic for role, topic in zip(roles, topics, strict=False)})
        known = f"{files}: no topic is known to be {', '.join(roles)}; it has {held}"
        return InputError(
            f"{known}: name topic and axis, e.g. {advice}" if len(topics) >= len(roles) else known
        )
    known = f"{files}: no column {', '.join(roles)}; it has {held}"
    if len(free) < len(roles):
        return InputError(f"{known}: no other column can be one: export both accelerations")
    ways |= {short(role): reference(tables, one) for role, one in zip(roles, free, strict=False)}
    return InputError(f"{known}: name columns, e.g. {typed('--columns', ways)}")


def _candidates(
    sources: Sequence[Source], roles: Sequence[str], taken: Sequence[Source], asked: Choices
) -> list[Source]:
    """Return the channels that could have a role: a known unit first, the name of a time last."""
    own = next((own for name, own in asked.columns.items() if SHORT.get(name, name) == TIME), None)
    times = _called(sources, own) if own else []
    free = [
        one
        for one in sources
        if one not in (*taken, *times)
        and not one.channel.time
        and quantity_of(one.channel.unit) != "time"
        and not (_words(one.channel.header) and _words(one.channel.header)[0] in COUNTERS)
        and any(_may_be(one.channel, role) for role in roles)
    ]
    return sorted(free, key=lambda one: (_is_called(one.channel, TIME), not quantity_of(one.channel.unit)))


def _one_a_topic(free: Sequence[Source], count: int) -> list[Source]:
    """Return channels to propose: one of each topic, its z where there is one; several of one topic else."""
    topics = {one.group.name: one for one in free}
    topics |= {one.group.name: one for one in reversed(free) if one.channel.name == "z"}
    return list(topics.values()) if len(topics) >= count else list(free)


def _is_called(channel: Channel, role: str) -> bool:
    words = _words(split_header(channel.header)[0].rpartition("/")[2])
    if not any(_means(word, short(role)) for word in words):
        return False
    others = [one for one in WORDS if one not in (short(role), "time")]
    return role == TIME or not any(_means(word, other) for other in others for word in words)


def _means(word: str, role: str) -> bool:
    """Return whether a word of a header is one of a role's, or holds one in a script without blanks."""
    return word in WORDS[role] or any(
        not one.isascii() and one in word and one > "\u0400" for one in WORDS[role]
    )


def _may_be(channel: Channel, role: str) -> bool:
    """Return whether a channel's unit does not speak against a role."""
    if channel.unit == STAMP:
        return False
    quantity = quantity_of(channel.unit)
    return quantity in {QUANTITIES[role], ""} | (set(READINGS) if role in (BODY, SPOOL) else set())


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[\W_]+", name.lower()) if word]


def _held(tables: Sequence[Table]) -> str:
    held = listed(
        [
            f"{group.name}/{channel.header}" if group.name else channel.header
            for table in tables
            for group in table.groups
            for channel in group.channels
        ]
    )
    unread = [
        f"{printable(name, 40)} ({why})" for table in tables for name, why in list(table.unread.items())[:4]
    ]
    return f"{held}; not read: {'; '.join(unread)}" if unread else held


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
    why = f"--unit {way}={unit}" if role in asked.units else ""
    if why and own and own != unit:
        why += f" instead of the file's {printable(own, 20)}"

    def use(unit: str, size: float, why: str) -> ChannelUse:
        return ChannelUse(role, source.table.path.name, channel.header, channel.number, unit, size, why)

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
        return use(
            unit or scale.reading, size, f"{taken}--scale {way}={scale.text}" + (f", {why}" if why else "")
        )
    if not unit:
        if asked.states_unit(role):
            return use("", 1.0, f"no unit in the file, --columns {role}=... says it")
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
            return use(unit, factor(unit, quantity), why)
        # A unit whose zero is not that of degC has no factor.
        shifted = float(converted(np.zeros(1), unit, quantity)[0]) != 0.0
        return use(unit, float("nan") if shifted else 1.0, why)
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
