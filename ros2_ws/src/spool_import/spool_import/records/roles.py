"""Roles of channels: which one is time, body, spool, oil temperature, displacement or force."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from spool_bag.tables.column_names import BODY, DISPLACEMENT, FORCE, OIL_TEMPERATURE, SPOOL, TIME
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.csv_text.dialect import listed
from spool_import.tables.table import STAMP, Channel, Group, Table
from spool_import.units.header import split_header
from spool_import.units.units import quantity_of

REQUIRED = {
    "accelerations": (BODY, SPOOL),
    "driven": (DISPLACEMENT, FORCE),
    "imposed": (DISPLACEMENT, FORCE),
}
OPTIONAL = {"accelerations": (OIL_TEMPERATURE,), "driven": (), "imposed": ()}
#: What each role measures; accelerations may come as readings of a sensor, by its sensitivity.
QUANTITIES = {
    TIME: "time",
    BODY: "acceleration",
    SPOOL: "acceleration",
    OIL_TEMPERATURE: "temperature",
    DISPLACEMENT: "length",
    FORCE: "force",
}
#: Short names of the roles, as ``--unit`` and ``--scale`` take them.
SHORT = {
    "time": TIME,
    "body": BODY,
    "spool": SPOOL,
    "oil": OIL_TEMPERATURE,
    "displacement": DISPLACEMENT,
    "force": FORCE,
}
_WORDS = {
    TIME: (
        "time",
        "t",
        "zeit",
        "zeitstempel",
        "timestamp",
        "messzeit",
        "temps",
        "datetime",
        "stamp",
        "uhrzeit",
    ),
    BODY: ("body", "housing", "gehäuse", "gehaeuse", "gehause", "ventilgehäuse", "valvebody"),
    SPOOL: ("spool", "schieber", "steuerschieber", "kolben", "steuerkolben", "valvespool"),
    OIL_TEMPERATURE: ("oil", "öl", "oel", "öltemperatur", "oeltemperatur"),
    DISPLACEMENT: ("displacement", "weg", "position", "stroke", "verschiebung"),
    FORCE: ("force", "kraft"),
}
#: Names of a column that counts samples.
COUNTERS = ("sample", "samples", "index", "nr", "no", "n", "count", "number", "abtastwert")


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


def role_of(name: str) -> str:
    """Return the role that is asked for as ``name``, a contract name or a short one.

    Raises:
        InputError: there is no such.
    """
    role = SHORT.get(name, name)
    if role not in QUANTITIES:
        known = ", ".join(QUANTITIES)
        raise InputError(f"--columns: {printable(name, 40)!r} is not one of {known}")
    return role


def chosen(
    tables: Sequence[Table],
    kind: str,
    columns: Mapping[str, str] | None = None,
    topics: Mapping[str, tuple[str, str]] | None = None,
) -> dict[str, Source]:
    """Return the source of each role of a record of ``kind``, its time left out.

    Args:
        tables: the files.
        kind: key of ``REQUIRED``.
        columns: the files' own names by role.
        topics: topic and axis by role, of bags.

    Raises:
        InputError: a channel is missing or could be several; what to type is said.
    """
    wanted = {role_of(name): own for name, own in (columns or {}).items()}
    roles = (*REQUIRED[kind], *OPTIONAL[kind])
    stray = [role for role in wanted if role not in (*roles, TIME)]
    if stray:
        raise InputError(f"--columns: {stray[0]!r} is not one of {', '.join((TIME, *roles))}")
    sources = [
        Source(table, group, channel)
        for table in tables
        for group in table.groups
        for channel in group.channels
    ]
    found: dict[str, Source] = {}
    for role in roles:
        if topics and role in topics:
            found[role] = _of_topic(tables, sources, *topics[role])
        elif role in wanted:
            found[role] = named(tables, sources, wanted[role], role)
    missing = []
    for role in roles:
        if role not in found:
            taken = [one.group for one in found.values()]
            source = _recognised(tables, sources, role, taken, required=role in REQUIRED[kind])
            if source is not None:
                found[role] = source
            elif role in REQUIRED[kind]:
                missing.append(role)
    if missing:
        raise _missing(tables, sources, missing)
    doubled = {one.label for one in found.values() if sum(one == other for other in found.values()) > 1}
    if doubled:
        raise InputError(
            f"{tables[0].path}: {doubled.pop()} is taken for two channels: name each with --columns"
        )
    return found


def time_of(table: Table, group: Group, columns: Mapping[str, str] | None) -> Channel | None:
    """Return the time axis of a group, ``None`` where it has none.

    Raises:
        InputError: a column that is named is not there, or several could be it.
    """
    own = next((own for name, own in (columns or {}).items() if SHORT.get(name, name) == TIME), None)
    if own is not None:
        text = _without_file(table, own)
        same = [one for one in group.channels if text in _names(group, one)]
        if same:
            return same[0]
        raise InputError(f"{table.path}: no column {printable(own, 60)}; it has {_held([table])}")
    marked = [one for one in group.channels if one.time]
    if marked:
        return marked[0]
    fitting = [
        one
        for one in group.channels
        if _is_called(one, TIME) and quantity_of(one.unit) in ("", "time") and not one.role
    ]
    exact = [one for one in fitting if one.name == TIME] or fitting
    if len(exact) > 1 and len({one.name for one in exact}) == 1:
        raise InputError(f"{table.path}: column {printable(exact[0].name, 40)} is there {len(exact)} times")
    if len(exact) > 1:
        raise InputError(
            f"{table.path}: {listed([one.name for one in exact])} could be the time: name it with "
            f"--columns {TIME}=NAME"
        )
    return exact[0] if exact else None


def counter_of(group: Group) -> Channel | None:
    """Return the channel of a group that counts its samples by its name, ``None`` where there is none."""
    return next((one for one in group.channels if _words(one.name) and _words(one.name)[0] in COUNTERS), None)


def named(tables: Sequence[Table], sources: Sequence[Source], own: str, role: str) -> Source:
    """Return the channel called ``own``: as the file has it, ``group/channel``, or ``FILE:channel``.

    Raises:
        InputError: there is none, or it is there several times.
    """
    fitting = [one for one in sources if _without_file(one.table, own) in _names(one.group, one.channel)]
    fitting = [one for one in fitting if one.table.path.name == own.partition(":")[0]] or fitting
    if not fitting:
        raise InputError(f"{tables[0].path}: no column {printable(own, 60)}; it has {_held(tables)}")
    if len(fitting) > 1:
        one = fitting[0]
        way = f"{one.table.path.name}:{own}" if len(tables) > 1 else f"{one.group.name or 'GROUP'}/{own}"
        raise InputError(
            f"{one.table.path}: column {printable(own, 60)} is there {len(fitting)} times: write "
            f"--columns {role}={printable(way, 80)}"
        )
    return fitting[0]


def _of_topic(tables: Sequence[Table], sources: Sequence[Source], topic: str, axis: str) -> Source:
    fitting = [one for one in sources if one.group.name.strip("/") == topic.strip("/")]
    if not fitting:
        held = listed([group.name for table in tables for group in table.groups])
        raise InputError(f"{tables[0].path}: no topic {printable(topic, 60)} of accelerations; it has {held}")
    found = [one for one in fitting if one.channel.name == axis]
    if not found:
        axes = ", ".join(one.channel.name for one in fitting if not one.channel.time)
        raise InputError(
            f"{tables[0].path}: {printable(topic, 60)} has no axis {printable(axis, 20)!r}: name one "
            f"of {axes}"
        )
    return found[0]


def _recognised(
    tables: Sequence[Table], sources: Sequence[Source], role: str, taken: Sequence[Group], *, required: bool
) -> Source | None:
    """Return the channel that has a role by its name and unit."""
    fitting = [one for one in sources if role in (one.channel.role, one.channel.name)]
    fitting = fitting or [
        one for one in sources if _is_called(one.channel, role) and _may_be(one.channel, role)
    ]
    beside = [one for one in fitting if one.group in taken]
    if len(fitting) > 1 and len(beside) == 1:
        fitting = beside
    if len(fitting) == 1:
        return fitting[0]
    if fitting and required:
        one = fitting[0]
        if len({each.label for each in fitting}) == 1 and len(tables) == 1:
            raise InputError(f"{one.table.path}: column {one.label} is there {len(fitting)} times")
        way = f"{one.table.path.name}:{one.channel.name}" if len(tables) > 1 else one.label
        raise InputError(
            f"{one.table.path}: {listed([each.label for each in fitting])} could be {role}: say which with "
            f"--columns {role}={printable(way, 80)}"
        )
    return None


def _missing(tables: Sequence[Table], sources: Sequence[Source], roles: Sequence[str]) -> InputError:
    """Return the error of roles that no channel has, with what to type."""
    files, held = ", ".join(str(table.path) for table in tables), _held(tables)
    if any(one.group.name.startswith("/") for one in sources):
        short = next(name for name, role in SHORT.items() if role == roles[0])
        return InputError(
            f"{files}: no topic is known to be {', '.join(roles)}; it has {held}: name topic and axis with "
            f"--topic {short}=/TOPIC:z"
        )
    return InputError(
        f"{files}: no column {', '.join(roles)}; it has {held}: map names with --columns {roles[0]}=NAME"
    )


def _names(group: Group, channel: Channel) -> set[str]:
    """Return what a channel may be called by."""
    plain = split_header(channel.name)[0]
    own = {channel.name, plain}
    return own | {f"{group.name}/{name}" for name in own} if group.name else own


def _without_file(table: Table, own: str) -> str:
    return own.removeprefix(f"{table.path.name}:")


def _is_called(channel: Channel, role: str) -> bool:
    words = _words(split_header(channel.name)[0].rpartition("/")[2])
    if not any(word in _WORDS[role] for word in words):
        return False
    return role == TIME or not any(
        word in others for other, others in _WORDS.items() if other not in (role, TIME) for word in words
    )


def _may_be(channel: Channel, role: str) -> bool:
    """Return whether a channel's unit does not speak against a role."""
    if channel.unit == STAMP:
        return False
    quantity = quantity_of(channel.unit)
    allowed = {QUANTITIES[role], ""} | ({"voltage", "reading"} if role in (BODY, SPOOL) else set())
    return quantity in allowed


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[\W_]+", name.lower()) if word]


def _held(tables: Sequence[Table]) -> str:
    return listed(
        [
            f"{group.name}/{channel.name}" if group.name else channel.name
            for table in tables
            for group in table.groups
            for channel in group.channels
        ]
    )
