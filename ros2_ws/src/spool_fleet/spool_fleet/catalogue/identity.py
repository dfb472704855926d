"""Identity of a bag: machine and valve by metadata, by a pattern of its path, or by a table."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime, timezone
from pathlib import Path

from spool_core.errors import InputError

FIELDS = ("machine", "date", "valve")
#: What is written where nothing tells the machine.
UNKNOWN = "unknown"
#: Days by which the stamps may lie beside the date of a path: time zones, and recordings past midnight.
SAME_DAY = 1.5
#: Characters of a name that tables hold at most.
LONGEST = 100


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of one valve's record; empty where nothing is known, ``day`` ``None`` as well."""

    machine: str = ""
    valve: str = ""
    day: date | None = None


@dataclass(frozen=True, slots=True)
class PathPattern:
    """Pattern of the last parts of a bag's path, such as ``{machine}/{date}/{valve}``; ``*`` is any text."""

    text: str
    _expressions: tuple[re.Pattern[str], ...] = field(init=False)

    def __post_init__(self) -> None:
        """Raises InputError where the pattern is none."""
        named: list[str] = []
        expressions = []
        for part in self.text.strip("/").split("/"):
            expression = ""
            for piece in re.split(r"(\{[^{}]*\}|\*)", part):
                if piece == "*":
                    expression += ".*"
                elif piece.startswith("{"):
                    name = piece[1:-1]
                    if name not in FIELDS or name in named:
                        why = "it stands there twice" if name in named else f"known are {', '.join(FIELDS)}"
                        raise InputError(f"--pattern {self.text}: {{{name}}}: {why}")
                    named.append(name)
                    expression += f"(?P<{name}>.+)"
                else:
                    expression += re.escape(piece)
            expressions.append(re.compile(expression))
        if not named:
            raise InputError(
                f"--pattern {self.text}: no field in it: use e.g. '{{machine}}/{{date}}/{{valve}}'"
            )
        object.__setattr__(self, "_expressions", tuple(expressions))

    def match(self, path: Path) -> Identity | None:
        """Return what the end of ``path`` says, ``None`` where it does not fit the pattern."""
        parts = path.absolute().with_suffix("" if path.suffix == ".mcap" else path.suffix).parts
        if len(parts) <= len(self._expressions):
            return None
        found: dict[str, str] = {}
        for part, expression in zip(parts[-len(self._expressions) :], self._expressions, strict=True):
            matched = expression.fullmatch(part)
            if matched is None:
                return None
            found |= matched.groupdict()
        day = _day(found["date"]) if "date" in found else None
        if "date" in found and day is None:
            return None
        return Identity(found.get("machine", ""), found.get("valve", ""), day)


def _day(text: str) -> date | None:
    """Return the date that begins ``text`` as YYYY-MM-DD or YYYYMMDD (anything may follow), else ``None``."""
    digits = re.match(r"(\d{4})-?(\d{2})-?(\d{2})", text)
    if digits is None:
        return None
    try:
        return date(*(int(one) for one in digits.groups()))
    except ValueError:
        return None


def read_table(path: Path) -> dict[Path, Identity]:
    """Return the identities of a CSV table: columns ``bag``, ``machine``, ``valve`` and, if any, ``date``.

    Raises:
        InputError: unreadable, or a column or a bag's name is missing; the line is named.
    """
    found: dict[Path, Identity] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            missing = {"bag", "machine", "valve"} - set(reader.fieldnames or ())
            if missing:
                raise InputError(
                    f"{path}: no column {', '.join(sorted(missing))}: it needs bag,machine,valve"
                )
            for number, row in enumerate(reader, start=2):
                if not row["bag"]:
                    raise InputError(f"{path}: line {number}: no bag in it")
                day = _day(row.get("date") or "")
                bag = (path.parent / row["bag"]).absolute()
                found[bag] = Identity(row["machine"] or "", row["valve"] or "", day)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a table: {error}") from error
    return found


def joined(preferred: Identity | None, other: Identity) -> Identity:
    """Return ``preferred`` with what it lacks taken from ``other``."""
    first = preferred or Identity()
    return Identity(
        (first.machine or other.machine or UNKNOWN)[:LONGEST],
        (first.valve or other.valve)[:LONGEST],
        first.day or other.day,
    )


def start_of(identity: Identity, stamp: int) -> tuple[int, str]:
    """Return when a record began (ns since 1970, UTC) and what is to be said of it.

    The stamps count, unless they contradict the date of ``identity``, which somebody filed the bag under.
    """
    if identity.day is None:
        return stamp, ""
    filed = datetime(identity.day.year, identity.day.month, identity.day.day, tzinfo=timezone.utc)
    midnight = round(filed.timestamp()) * 1_000_000_000
    if abs((stamp - midnight) / 86_400e9 - 0.5) <= SAME_DAY:
        return stamp, ""
    said = datetime.fromtimestamp(stamp / 1e9, timezone.utc).strftime("%Y-%m-%d")
    return midnight, f"its stamps say {said}, its path {identity.day}: the path's date is taken"


def of_table(table: Mapping[Path, Identity], path: Path) -> Identity | None:
    """Return what ``table`` says of the bag at ``path``."""
    return table.get(path.absolute())
