"""Choices of a user for an import, as they stand on the command line."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag import BODY, COMMAND, DISPLACEMENT, FORCE, OIL_TEMPERATURE, SPEED, SPOOL, TACHO, TIME
from spool_bag.importing.units import READINGS, Sensitivity, quantity_of

#: What each role measures; accelerations may come as readings of a sensor, by its sensitivity.
QUANTITIES = {
    TIME: "time",
    BODY: "acceleration",
    SPOOL: "acceleration",
    OIL_TEMPERATURE: "temperature",
    SPEED: "frequency",
    TACHO: "pulses",
    COMMAND: "pulses",
    DISPLACEMENT: "length",
    FORCE: "force",
}
#: Short names of the roles, as ``--unit`` and ``--scale`` take them.
SHORT = {
    "time": TIME,
    "body": BODY,
    "spool": SPOOL,
    "oil": OIL_TEMPERATURE,
    "speed": SPEED,
    "tacho": TACHO,
    "command": COMMAND,
    "displacement": DISPLACEMENT,
    "force": FORCE,
}

#: Times of a bag's messages: of the header, or of the reception by the recorder (``log`` and ``arrival``).
STAMPS = ("header", "log", "arrival")

#: Text of an option, or several where it was given several times.
Given = str | Sequence[str] | None


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices for an import, each by role.

    ``columns``: the file's own names, by role as given. ``units``: units that stand over those of the file.
    ``scales``: sensitivities. ``topics``: topic and axis. ``rate``: Hz, of samples without a time.
    ``align``: whether two clocks may be brought together. ``exclude``: columns to leave out.
    ``stamps``: which time of a bag's messages counts, one of ``STAMPS``; ``None``: that of the header.
    ``dates``: order of day, month and year in dates like 05/04/2026 or 26/05/04: ``dmy``, ``mdy`` or ``ymd``.
    ``empty_as_gap``: whether a row without a value in a channel is a gap in all of them.
    ``pulses``: of a tacho per revolution; without them such a channel is not read.
    ``zone``: in which stamps are that name none, e.g. ``Europe/Berlin``; "": UTC.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, Sensitivity] = field(default_factory=dict)
    topics: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    rate: float | None = None
    align: bool = True
    exclude: tuple[str, ...] = ()
    stamps: str | None = None
    dates: str = ""
    empty_as_gap: bool = False
    pulses: int | None = None
    zone: str = ""

    def __post_init__(self) -> None:
        """Raises InputError where a choice is none of those that there are."""
        if self.rate is not None and not 0.0 < self.rate < 1e7:
            raise InputError(f"--rate {self.rate:g}: give samples a second, above 0")
        if self.pulses is not None and not 1 <= self.pulses <= 10_000:
            raise InputError(f"--pulses-per-revolution {self.pulses}: give a number from 1 to 10000")
        if self.stamps is not None and self.stamps not in STAMPS:
            raise InputError(
                f"--stamps {printable(self.stamps, 20)!r}: write {', '.join(STAMPS[:-1])} or {STAMPS[-1]}"
            )
        if self.dates not in ("", "dmy", "mdy", "ymd"):
            raise InputError(f"--dates {printable(self.dates, 20)!r}: write dmy, mdy or ymd")
        try:
            _ = ZoneInfo(self.zone or "UTC")
        except (ZoneInfoNotFoundError, ValueError, OSError) as error:
            raise InputError(
                f"--zone {printable(self.zone, 40)!r}: write a region and city, Europe/Berlin"
            ) from error

    def states_unit(self, role: str) -> bool:
        """Return whether ``--columns`` names a column by the role with its unit, e.g. ``body_m_s2``."""
        return role in self.columns

    def column_of(self, role: str) -> str | None:
        """Return what ``--columns`` names for a role, by its contract name or its short one."""
        return next((own for name, own in self.columns.items() if SHORT.get(name, name) == role), None)

    def gives(self, role: str) -> bool:
        """Return whether a unit or a sensitivity was given for a role, whatever the file says."""
        return role in self.units or role in self.scales


def choices(
    columns: Given = None,
    unit: Given = None,
    scale: Given = None,
    topic: Given = None,
    align: str = "auto",
    exclude: Given = None,
    **plain: Any,
) -> Choices:
    """Return what the options of the same names say; ``plain`` are those that stay as they are.

    Raises:
        InputError: one is not written as it should be.
    """
    units = {role_of(name, "--unit"): text for name, text in pairs("--unit", unit, "body=g,spool=g").items()}
    for role, text in units.items():
        _check_unit(role, text)
    scales = {}
    for name, text in pairs("--scale", scale, "body=100mV/g,spool=100mV/g").items():
        try:
            scales[role_of(name, "--scale")] = Sensitivity(text)
        except InputError as error:
            raise InputError(f"--scale: {error}") from error
    if align not in ("auto", "none"):
        raise InputError(f"--align {printable(align, 20)!r}: write auto or none")
    topics = {}
    for name, text in pairs("--topic", topic, "body=/imu_1:z,spool=/imu_2:z").items():
        path, mark, axis = text.rpartition(":")
        if not (mark and path and axis):
            raise InputError(f"--topic {printable(text, 60)!r}: write it like body=/imu_1:z,spool=/imu_2:z")
        topics[role_of(name, "--topic")] = (path, axis)
    left_out = tuple(name.strip() for text in _texts(exclude) for name in text.split(",") if name.strip())
    return Choices(
        columns_of(columns) or {}, units, scales, topics, align=align == "auto", exclude=left_out, **plain
    )


def role_of(name: str, option: str = "--columns") -> str:
    """Return the role that is asked for as ``name``, a contract name or a short one.

    Raises:
        InputError: there is no such.
    """
    role = SHORT.get(name, name)
    if role not in QUANTITIES:
        raise InputError(f"{option}: {printable(name, 40)!r} is not one of {', '.join(QUANTITIES)}")
    return role


def short(role: str) -> str:
    """Return the short name of a role, as options take it."""
    return next(name for name, full in SHORT.items() if full == role)


def typed(option: str, pairs: Mapping[str, str]) -> str:
    """Return an option as it can be typed in a shell."""
    text = ",".join(f"{name}={value}" for name, value in pairs.items())
    return f"{option} {text if re.fullmatch(r'[-A-Za-z0-9_@%+=:,./^#]+', text) else shlex.quote(text)}"


def columns_of(columns: Given) -> dict[str, str] | None:
    """Return a file's own names by contract name from ``--columns``, ``None`` without it.

    Raises:
        InputError: not written as ``name=own,name=own``.
    """
    return pairs("--columns", columns, "time_s=t,body_m_s2=ch1,spool_m_s2=ch2, or body=#1 by number") or None


def pairs(option: str, given: Given, example: str) -> dict[str, str]:
    """Return the pairs of ``name=value,name=value``; a comma ends a value only in front of another name.

    Raises:
        InputError: it is written otherwise.
    """
    found: dict[str, str] = {}
    for text in _texts(given):
        for pair in re.split(r",(?=\s*[A-Za-z]\w*\s*=)", text):
            name, mark, value = pair.partition("=")
            if not (name.strip() and mark and value.strip()) or value.strip() != value.strip(", "):
                raise InputError(f"{option} {printable(text, 100)!r}: write it like {example}")
            found[name.strip()] = value.strip()
    return found


def _texts(given: Given) -> list[str]:
    return [] if given is None else [given] if isinstance(given, str) else list(given)


def _check_unit(role: str, text: str) -> None:
    """Raises InputError where a unit is not known or does not fit its role."""
    quantity, wanted = quantity_of(text), QUANTITIES[role]
    if not quantity:
        raise InputError(
            f"--unit {printable(text, 30)!r}: not a unit that is known: e.g. g, m/s^2, mm/s^2, mV, ms"
        )
    if quantity != wanted and not (role in (BODY, SPOOL) and quantity in READINGS):
        raise InputError(
            f"--unit {printable(text, 30)!r}: {role} is measured in a unit of {wanted}, not of {quantity}"
        )
