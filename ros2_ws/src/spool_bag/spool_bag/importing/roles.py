"""Roles of channels: which one is what, by the user, its format, its name and its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag import BODY, DISPLACEMENT, FORCE, SLOW, SPOOL, TACHO, TIME
from spool_bag.importing.choices import QUANTITIES, Choices, role_of, short, typed
from spool_bag.importing.csv_layout import listed
from spool_bag.importing.table import LOG_TIME, STAMP, Channel, Group, Table
from spool_bag.importing.units import READINGS, WORDS, quantity_of, split_header

REQUIRED = {"accelerations": (BODY, SPOOL), "driven": (DISPLACEMENT, FORCE), "imposed": (DISPLACEMENT, FORCE)}
OPTIONAL = {"accelerations": SLOW, "driven": (), "imposed": ()}
#: Names of a column that counts samples.
COUNTERS = ("sample", "samples", "index", "nr", "no", "n", "count", "number", "abtastwert", "sequence")
#: What may stand in a name that is typed on the command line.
_TYPEABLE = re.compile(r"[^,=#'\"\\$`!:][^,='\"\\$`!]{0,39}")


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Channel with its group and file, its header and unit parsed once.

    ``name``: header without its unit. ``words``: of the last part of that name, in small letters.
    ``quantity``: what the unit measures, "" where that is not known.
    """

    table: Table
    group: Group
    channel: Channel
    name: str
    words: list[str]
    quantity: str

    @property
    def clock(self) -> tuple[int, str]:
        """What it shares with the channels that were sampled with it."""
        return id(self.table), self.group.name

    @property
    def label(self) -> str:
        """Name for messages, printable."""
        group = f"{self.group.name}/" if self.group.name else ""
        return printable(f"{group}{self.channel.name}", 80)


@dataclass(frozen=True, slots=True)
class Channels:
    """Channels of files, by which names and messages refer to them."""

    tables: tuple[Table, ...]
    sources: tuple[Source, ...]

    def called(self, own: str, group: Group | None = None) -> list[Source]:
        """Return the channels called ``own``, here or in a group: exactly, without unit, or by number."""
        for kind in range(3):
            fitting = [
                one
                for one in self.sources
                if group in (None, one.group)
                and own.removeprefix(f"{one.table.path.name}:") in _names(one)[kind]
            ]
            fitting = [one for one in fitting if one.table.path.name == own.partition(":")[0]] or fitting
            if fitting:
                return fitting
        return []

    def reference(self, source: Source) -> str:
        """Return what ``--columns`` takes to mean just this channel: its name, or its column's number."""
        file = f"{source.table.path.name}:" if len(self.tables) > 1 else ""
        group = f"{source.group.name}/" if source.group.name else ""
        channel = source.channel
        for text in (channel.name, f"{group}{channel.name}", f"{file}{group}{channel.name}"):
            if _TYPEABLE.fullmatch(text) and text.isprintable() and self.called(text) == [source]:
                return text
        numbers = (f"#{channel.number}", f"{group}#{channel.number}")
        return next(
            (text for text in numbers if self.called(text) == [source]), f"{file}{group}#{channel.number}"
        )

    def proposed(self, role: str, fitting: Sequence[Source]) -> str:
        """Return the options that name one of ``fitting`` for ``role``."""
        return ", or ".join(typed("--columns", {short(role): self.reference(one)}) for one in fitting[:2])

    def named(self, own: str, role: str, group: Group | None = None) -> Source:
        """Return the channel called ``own``: its name, ``#3`` by number, ``group/channel``, ``FILE:channel``.

        Raises:
            InputError: there is none, or it is there several times.
        """
        fitting = self.called(own, group)
        if not fitting:
            numbers = self.called(f"#{own}", group) if own.isdecimal() else []
            hint = f": by number it is {self.proposed(role, numbers[:1])}" if numbers else ""
            raise InputError(
                f"{self.tables[0].path}: no column {printable(own, 60)}; it has {self.listed()}{hint}"
            )
        if len(fitting) > 1:
            raise InputError(
                f"{fitting[0].table.path}: column {printable(own, 60)} is there {len(fitting)} times: write "
                f"{self.proposed(role, fitting)}"
            )
        return fitting[0]

    def listed(self) -> str:
        """Return their names for a message, and those of columns that are no channels."""
        names = [(one.group.name, one.channel.header) for one in self.sources]
        held = listed([f"{group}/{header}" if group else header for group, header in names])
        unread = [
            f"{printable(name, 40)} ({why})"
            for table in self.tables
            for name, why in list(table.unread.items())[:4]
        ]
        return f"{held}; not read: {'; '.join(unread)}" if unread else held


def channels_of(tables: Sequence[Table], excluded: Sequence[str]) -> Channels:
    """Return the channels of files without those that ``--exclude`` names.

    Raises:
        InputError: there is no such channel.
    """
    sources = []
    for table in tables:
        for group in table.groups:
            for one in group.channels:
                name = split_header(one.header)[0]
                words = _words(name.rpartition("/")[2])
                sources.append(Source(table, group, one, name, words, quantity_of(one.unit)))
    every = Channels(tuple(tables), tuple(sources))
    for own in excluded:
        left = every.called(own)
        if not left:
            raise InputError(
                f"--exclude: {tables[0].path}: no column {printable(own, 60)}; it has {every.listed()}"
            )
        sources = [one for one in sources if one not in left]
    return Channels(every.tables, tuple(sources))


def chosen(channels: Channels, kind: str, asked: Choices) -> dict[str, Source]:
    """Return the source of each role of a record of ``kind`` (a key of ``REQUIRED``), its time left out.

    Raises:
        InputError: a channel is missing or ambiguous; the message shows what to type.
    """
    wanted = {role_of(name): own for name, own in asked.columns.items()}
    roles = (*REQUIRED[kind], *OPTIONAL[kind])
    stray = [role for role in wanted if role not in (*roles, TIME)]
    if stray:
        raise InputError(f"--columns: {stray[0]!r} is not one of {', '.join((TIME, *roles))}")
    if TACHO in wanted and asked.pulses is None:
        raise InputError("--columns: a tacho needs its pulses: add --pulses-per-revolution, e.g. 60")
    roles = tuple(role for role in roles if role != TACHO or asked.pulses is not None)
    found: dict[str, Source] = {}
    for role in roles:
        if role in asked.topics:
            found[role] = _of_topic(channels, *asked.topics[role])
        elif role in wanted:
            found[role] = channels.named(wanted[role], role)
    missing = []
    for role in roles:
        if role not in found:
            source = _recognised(channels, role, list(found.values()), asked, required=role in REQUIRED[kind])
            if source is not None:
                found[role] = source
            elif role in (*REQUIRED[kind], TACHO):
                missing.append(role)
    if missing:
        raise _missing(channels, missing, found, asked)
    doubled = [role for role, one in found.items() if list(found.values()).count(one) > 1]
    if doubled:
        ways = channels.proposed(doubled[1], _candidates(channels, doubled[1:], list(found.values()), asked))
        raise InputError(
            f"{channels.tables[0].path}: {found[doubled[0]].label} is named for {' and '.join(doubled)}: "
            f"name a column for each{', e.g. ' if ways else ''}{ways}"
        )
    return {role: found[role] for role in roles if role in found}


def time_axis_of(channels: Channels, group: Group, free: Sequence[Source], asked: Choices) -> Source | None:
    """Return the time axis of a group among its ``free`` channels, ``None`` where it has none.

    ``channels`` are those of its file. With a rate no column of a doubtful name is a time axis.

    Raises:
        InputError: a column that is named is not there, or has another role.
    """
    path = channels.tables[0].path
    if asked.stamps in ("log", "arrival"):
        log = next(
            (one for one in channels.sources if one.group is group and one.channel.name == LOG_TIME), None
        )
        if log is None:
            raise InputError(
                f"{path}: --stamps {asked.stamps}: only messages with a header have two times: leave it out"
            )
        return log
    own = asked.column_of(TIME)
    if own is not None:
        source = channels.named(own, TIME, group)
        if source not in free:
            raise InputError(
                f"{path}: {source.label} is named for {TIME} and for another channel: name a column for each "
                "with --columns"
            )
        return source
    free = [one for one in free if not one.channel.role]
    marked = [one for one in free if one.channel.time]
    if marked:
        return marked[0]
    in_time = [one for one in free if one.quantity == "time"]
    fitting = [one for one in free if _is_called(one, TIME) and one.quantity in ("", "time")]
    if asked.rate:
        fitting = [one for one in fitting if one in in_time or one.name.lower() in WORDS["time"]]
    fitting = fitting or (in_time if len(in_time) == 1 else [])
    exact = [one for one in fitting if one.channel.header == TIME] or fitting
    return exact[0] if exact else None  # the others are compared with it


def _of_topic(channels: Channels, topic: str, axis: str) -> Source:
    path = channels.tables[0].path
    fitting = [one for one in channels.sources if one.group.name.strip("/") == topic.strip("/")]
    if not fitting:
        held = listed([group.name for table in channels.tables for group in table.groups])
        raise InputError(f"{path}: no topic {printable(topic, 60)} of accelerations; it has {held}")
    found = [one for one in fitting if one.channel.name == axis]
    if not found:
        axes = ", ".join(one.channel.name for one in fitting if one.channel.unit != STAMP)
        raise InputError(
            f"{path}: {printable(topic, 60)} has no axis {printable(axis, 20)!r}: name one of {axes}"
        )
    return found[0]


def _recognised(
    channels: Channels, role: str, taken: Sequence[Source], asked: Choices, *, required: bool
) -> Source | None:
    """Return the channel that has a role by its name and unit."""
    free = [one for one in channels.sources if one not in taken and (role == TACHO or one.name != TACHO)]
    fitting = [one for one in free if role in (one.channel.role, one.channel.header, one.name)]
    called = [one for one in free if _is_called(one, role) and one.channel.unit != STAMP]
    fitting = fitting or [one for one in called if asked.gives(role) or _may_be(one, role)]
    beside = [one for one in fitting if one.group in [other.group for other in taken]]
    if len(fitting) > 1 and len(beside) == 1:
        fitting = beside
    if len(fitting) == 1:
        return fitting[0]
    if fitting and required:
        raise InputError(
            f"{fitting[0].table.path}: {listed([one.label for one in fitting])} could be {role}: choose one "
            f"with {channels.proposed(role, fitting)}"
        )
    if required and len(called) == 1:
        return called[0]  # refused for its unit, by name
    return None


def _missing(
    channels: Channels, roles: Sequence[str], found: Mapping[str, Source], asked: Choices
) -> InputError:
    """Return the error of roles that no channel has, with what to type."""
    files, held = ", ".join(str(table.path) for table in channels.tables), channels.listed()
    free = _candidates(channels, roles, list(found.values()), asked)
    numbered = [one for one in free if one.channel.header.isdecimal()]
    ways = {}
    if len(numbered) == len(free) > len(roles) and asked.column_of(TIME) is None:
        free = free[1:]  # of a file without names the first column is usually its time
        ways = {} if asked.rate else {"time": channels.reference(numbered[0])}
    if any(one.group.name.startswith("/") for one in channels.sources):
        # One of each topic, its z where there is one; several of one topic else.
        by_topic = {one.group.name: one for one in free}
        by_topic |= {one.group.name: one for one in reversed(free) if one.channel.name == "z"}
        proposed = list(by_topic.values()) if len(by_topic) >= len(roles) else free
        topics = [f"{one.group.name}:{one.channel.name}" for one in proposed]
        advice = typed("--topic", {short(role): topic for role, topic in zip(roles, topics, strict=False)})
        known = f"{files}: no topic is known to be {', '.join(roles)}; it has {held}"
        return InputError(
            f"{known}: name topic and axis, e.g. {advice}" if len(topics) >= len(roles) else known
        )
    known = f"{files}: no column {', '.join(roles)}; it has {held}"
    if len(free) < len(roles):
        return InputError(f"{known}: no other column can be one: export both accelerations")
    ways |= {short(role): channels.reference(one) for role, one in zip(roles, free, strict=False)}
    return InputError(f"{known}: name columns, e.g. {typed('--columns', ways)}")


def _candidates(
    channels: Channels, roles: Sequence[str], taken: Sequence[Source], asked: Choices
) -> list[Source]:
    """Return the channels that could have a role: a known unit first, the name of a time last."""
    own = asked.column_of(TIME)
    times = channels.called(own) if own else []
    free = [
        one
        for one in channels.sources
        if one not in (*taken, *times)
        and not one.channel.time
        and one.quantity != "time"
        and not counts(one)
        and any(_may_be(one, role) for role in roles)
    ]
    return sorted(free, key=lambda one: (_is_called(one, TIME), not one.quantity))


def _is_called(source: Source, role: str) -> bool:
    if not any(_means(word, short(role)) for word in source.words):
        return False
    others = [one for one in WORDS if one not in (short(role), "time")]
    return role == TIME or not any(_means(word, other) for other in others for word in source.words)


def _means(word: str, role: str) -> bool:
    """Return whether a word of a header is one of a role's, or holds one in a script without blanks."""
    return word in WORDS[role] or any(
        not one.isascii() and one in word and one > "\u0400" for one in WORDS[role]
    )


def _may_be(source: Source, role: str) -> bool:
    """Return whether a channel's unit does not speak against a role."""
    if source.channel.unit == STAMP:
        return False
    readings = set(READINGS) if role in (BODY, SPOOL) else set()
    return source.quantity in {QUANTITIES[role], ""} | readings


def may_be_time(source: Source) -> bool:
    """Return whether a channel may hold a time: by format, unit or name (`T2`, `Time_1`)."""
    channel = source.channel
    if channel.role:
        return False
    called = any(word.rstrip("0123456789") in WORDS["time"] for word in source.words)
    return channel.time or source.quantity == "time" or (called and not channel.unit)


def counts(source: Source) -> bool:
    """Return whether a channel counts its samples, by its name."""
    return _words(source.channel.header)[:1] in ([one] for one in COUNTERS)


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[\W_]+", name.lower()) if word]


def _names(source: Source) -> tuple[set[str], ...]:
    """Return the names of a channel: as the file has it, without the unit, by the number of its column."""
    group, channel = source.group.name, source.channel
    names = {channel.name, channel.header}, {source.name}, {f"#{channel.number}"}
    return tuple(own | {f"{group}/{name}" for name in own} for own in names)
