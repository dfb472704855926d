"""Span of a record that a user asks for: since and until a time, or around an alarm."""

from __future__ import annotations

import re
import time
from datetime import datetime, timezone
from pathlib import Path

from spool_bag.reading.reader import BagReader
from spool_bag.reading.span import ALWAYS, Span
from spool_core.errors import InputError
from spool_core.text.printable import printable

from .table_record import is_table

#: s before and after an alarm, as a snapshot of it keeps.
AROUND = 60.0
_UNITS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}
_RAISED = 1


def span_of(path: Path, since: str | None, until: str | None, around: str | None) -> Span:
    """Return the span that ``--since``, ``--until`` and ``--around`` ask of the record at ``path``.

    Raises:
        InputError: one is written otherwise, there is no such alarm, or the record is no bag.
    """
    if since is None and until is None and around is None:
        return Span()
    if is_table(path):
        raise InputError(
            f"{path}: --since, --until and --around choose of a recording: import the file first"
        )
    reader = BagReader(path, skip_damage=True)
    if around is not None:
        if since is not None or until is not None:
            raise InputError("--around: leave --since and --until out")
        return _around(reader, around)
    received = reader.received
    end = received[1] if received is not None else time.time_ns()
    begin = -ALWAYS if since is None else _moment("--since", since, end)
    stop = ALWAYS if until is None else _moment("--until", until, end)
    if begin >= stop:
        raise InputError(f"--since {since}, --until {until}: nothing lies between them")
    return Span(begin, stop)


def _moment(option: str, text: str, end: int) -> int:
    """Return the time (ns since 1970) that is meant: ISO 8601, or how long before the record's ``end``."""
    match = re.fullmatch(r"-?(\d+(?:\.\d+)?)\s*(s|min|m|h|d|w)", text.strip())
    if match:
        return end - round(float(match[1]) * _UNITS[match[2]] * 1e9)
    try:
        moment = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
        zoned = moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)
        return round(zoned.timestamp() * 1e6) * 1000
    except (ValueError, OverflowError):
        raise InputError(
            f"{option} {printable(text, 40)!r}: write it like 30s, 10m, 6h or 7d before the record's "
            "end, or like "
            "2025-01-31T12:00:00 (UTC)"
        ) from None


def _around(reader: BagReader, text: str) -> Span:
    """Return the minutes around the newest alarm of a kind, or with ``KIND:2`` the second newest."""
    kind, _, number = text.partition(":")
    if number and not (number.isascii() and number.isdigit() and 0 < int(number) < 10**6):
        raise InputError(f"--around {printable(text, 40)!r}: write it like resonance, or resonance:2")
    stamps: list[int] = []
    kinds: set[str] = set()
    for topic in reader.topics:
        if topic.rpartition("/")[2] != "events":
            continue
        for event in reader.messages(topic):
            if getattr(event, "state", None) != _RAISED:
                continue
            kinds.add(event.kind)
            if kind in (event.kind, "alarm"):
                stamps.append(event.header.stamp.sec * 1_000_000_000 + event.header.stamp.nanosec)
    place = int(number or 1)
    if len(stamps) < place:
        held = ", ".join(sorted(printable(one, 40) for one in kinds)) or "none"
        raise InputError(
            f"{reader.path}: {len(stamps)} alarms of kind {printable(kind, 40)!r} in it; it has: {held}"
        )
    stamp = sorted(stamps)[-place]
    half = round(AROUND * 1e9)
    return Span(stamp - half, stamp + half)
