"""Where a record comes from: a bag or a table, the stretch that is asked for, and the valve it holds."""

from __future__ import annotations

import math
import re
import time
from collections import deque
from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
from itertools import islice
from pathlib import Path

from spool_bag.blocks import ALWAYS, Item, Span
from spool_bag.importing.bag_import import BLOCK_DURATION, start_of, stream_of
from spool_bag.importing.choices import Choices
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_bag.information import BagInformation, summarise
from spool_bag.metadata import is_bag_file, typestore
from spool_bag.reader import BagReader
from spool_core.block import Block
from spool_core.cdr import Reading
from spool_core.errors import InputError
from spool_core.text import printable, seconds_of
from spool_report.requests import EVER, TimeSpan
from spool_sim.valve import Valve, components_of, components_text, valve_from_mapping

#: s before and after an alarm, as a snapshot of it keeps.
AROUND = 60.0
_RAISED = 1

VALVE_DESCRIPTION = "spool_msgs/msg/ValveDescription"

_NUMBERS = tuple(name for name in Valve.model_fields if name not in ("id", "oil", "components"))


def split_name(text: str) -> tuple[str, str]:
    """Return namespace and file of ``NAME=FILE``; the name is empty where there is only a file."""
    name, mark, file = text.partition("=")
    if not mark or Path(text).exists():
        return "", text
    return name.strip().strip("/"), file.strip()


def is_table(path: Path) -> bool:
    """Return whether ``path`` is a file to be read as a table: any but a bag or a description."""
    if path.is_dir() or is_bag_file(path) or path.suffix.lower() in (".yaml", ".yml"):
        return False
    return path.is_file() or bool(path.suffix)


def record_of_table(
    path: Path,
    kind: str = "accelerations",
    columns: Mapping[str, str] | None = None,
    *,
    how: Choices | None = None,
    regular: bool = True,
) -> LoggerRecord:
    """Return the record in a file; of accelerations, what only `import` takes is refused with that.

    Args:
        path: of the file.
        kind: of the record.
        columns: the file's own names by contract name.
        how: units, rate and columns to leave out, where the command has these options.
        regular: whether the time between samples has to be even.

    Raises:
        InputError: as :func:`spool_bag.importing.logger_record.read_record`.
    """
    try:
        return read_record(path, kind, columns, how=how, regular=regular)
    except InputError as error:
        others = "topic|empty-as-gap" + ("" if how else "|unit|scale|rate")
        if kind == "accelerations" and re.search(rf"--({others})\b", str(error)):
            raise InputError(
                f"{error}; these are options of ./spool import {path} --out record_bag, which makes a bag "
                f"of it"
            ) from error
        raise


def span_of(path: Path, when: TimeSpan) -> Span:
    """Return the span that ``when`` asks of the record at ``path``.

    Raises:
        InputError: one is written otherwise, there is no such alarm, or the record is no bag.
    """
    if when == EVER:
        return Span()
    since, until, around = when.since, when.until, when.around
    if is_table(path):
        raise InputError(
            f"{path}: --since, --until and --around choose of a recording: import the file first"
        )
    reader = BagReader(path, skip_damage=True)
    if around is not None:
        if since is not None or until is not None:
            raise InputError("--around: leave --since and --until out")
        # The minutes around the newest alarm of a kind, or with KIND:2 the second newest.
        kind, _, number = around.partition(":")
        if number and not (number.isascii() and number.isdigit() and 0 < int(number) < 10**6):
            raise InputError(f"--around {printable(around, 40)!r}: write it like resonance, or resonance:2")
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
    received = reader.received
    end = received[1] if received is not None else time.time_ns()
    begin = -ALWAYS if since is None else _moment("--since", since, end)
    stop = ALWAYS if until is None else _moment("--until", until, end)
    if begin >= stop:
        raise InputError(f"--since {since}, --until {until}: nothing lies between them")
    return Span(begin, stop)


class TableSource:
    """Record in a logger's file, with what of :class:`spool_bag.reader.BagReader` a replay needs.

    Attributes:
        path: the file.
        valves: its only valve has the name that `import` gives by default.
        warnings: what is not as it should be, one line each.

    Raises:
        InputError: the file is no record.
    """

    def __init__(self, path: Path, columns: Mapping[str, str] | None = None) -> None:
        self.path = path
        self.valves = ["valve_1"]
        self.record = record_of_table(path, columns=columns)
        self.warnings = list(self.record.warnings)
        self._start = start_of(self.record)

    @property
    def count(self) -> int:
        """Number of blocks, about."""
        return math.ceil(self.record.time.size * self.record.period / BLOCK_DURATION)

    def describe(self) -> BagInformation:
        """Return what is in the file, as of a bag; it has no topics."""
        valve = summarise(self.valves[0], self.stream(self.valves[0]))
        return BagInformation(
            self.path,
            self.path.stat().st_size,
            closed=True,
            duration_s=valve.duration_s,
            first_stamp_ns=valve.first_stamp_ns,
            valves=(valve,),
            warnings=tuple(self.warnings),
        )

    def stream(self, valve: str) -> Iterator[Block | Reading]:
        """Yield blocks, and before them slow readings, as `import` writes them."""
        assert valve in self.valves
        yield from stream_of(self.record, self._start)

    def runs(self, valve: str) -> Iterator[Item]:
        """Yield what ``stream`` yields, as a bag's reader does."""
        yield from self.stream(valve)


def encode_valve(valve: Valve, stamp: int) -> bytes:
    """Return the CDR of ``valve``'s description, published at ``stamp`` (ns)."""
    types = typestore().types
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    message = types[VALVE_DESCRIPTION](
        header=types["std_msgs/msg/Header"](stamp=time, frame_id=valve.id),
        oil=valve.oil or "",
        components=components_text(valve),
        **{name: valve.given.get(name, math.nan) for name in _NUMBERS},
    )
    return bytes(typestore().serialize_cdr(message, VALVE_DESCRIPTION))


def recorded_valve(reader: BagReader, name: str) -> Valve | None:
    """Return the last description of valve ``name`` in the bag, ``None`` without any."""
    topic = f"/{name}/valve"
    if topic not in reader.topics:
        return None
    # The last one counts; behind it the bag is not read.
    kept = deque(islice(reader.messages(topic), reader.topics[topic].messages), maxlen=1)
    if (last := next(iter(kept), None)) is None:
        return None
    numbers = {key: getattr(last, key) for key in _NUMBERS}
    mapping = {key: value for key, value in numbers.items() if not math.isnan(value)}
    where = f"{reader.path}: {topic}"
    # Bags of earlier versions have no components.
    mapping["components"] = components_of(getattr(last, "components", ""), where)
    return valve_from_mapping({"id": last.header.frame_id, "oil": last.oil or None, **mapping}, where)


def iso_time(text: str) -> datetime:
    """Return the time that ``text`` says in ISO 8601, UTC where it names no zone.

    Raises:
        ValueError: it says none.
    """
    time = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    return time if time.tzinfo else time.replace(tzinfo=timezone.utc)


def _moment(option: str, text: str, end: int) -> int:
    """Return the time (ns since 1970) that is meant: ISO 8601, or how long before the record's ``end``."""
    before = seconds_of(text.strip().removeprefix("-"))
    if before is not None:
        return end - round(before * 1e9)
    try:
        return round(iso_time(text).timestamp() * 1e6) * 1000
    except (ValueError, OverflowError):
        raise InputError(
            f"{option} {printable(text, 40)!r}: write it like 30s, 10m, 6h or 7d before the record's end, or "
            "like 2025-01-31T12:00:00 (UTC)"
        ) from None
