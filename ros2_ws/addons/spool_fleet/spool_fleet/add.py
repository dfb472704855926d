"""Adding bags to a store: folders are searched, and each bag is identified by its content."""

from __future__ import annotations

import csv
import math
import re
from calendar import monthrange
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, timezone
from pathlib import Path

from spool_bag.information import BagInformation, ValveSummary, describe
from spool_bag.metadata import MACHINE, custom_data
from spool_bag.reader import BagReader
from spool_core.errors import InputError
from spool_core.text import plural, printable
from spool_core.uncertainty import as_json
from spool_report.outputs import sha256_of

from spool_fleet.manifest import Entry, Manifest

OK, DAMAGED, DUPLICATE = "ok", "damaged", "duplicate"

FIELDS = ("machine", "date", "valve")
#: What is written where nothing tells the machine.
UNKNOWN = "unknown"
#: Days by which the stamps may lie beside the date of a path: time zones, and recordings past midnight.
SAME_DAY = 1.5
#: Characters of a name that tables hold at most.
LONGEST = 100


@dataclass(frozen=True, slots=True)
class Naming:
    """Naming of bags by a ``pattern`` of their paths or a ``table``; the valve file that describes them."""

    pattern: PathPattern | None = None
    table: Mapping[Path, Identity] = field(default_factory=dict)
    valve_file: str = ""


@dataclass(slots=True)
class Added:
    """What an addition found: numbers of bags, and a line about each that is not as it should be.

    ``redated`` ones are filed under another date than their stamps say, ``left_out`` ones are not filed:
    their paths do not fit the pattern, and nothing else states their machine. ``nameless`` ones are filed
    without a machine.
    """

    new: int = 0
    unchanged: int = 0
    damaged: int = 0
    duplicates: int = 0
    redated: int = 0
    left_out: int = 0
    nameless: int = 0
    told: list[str] = field(default_factory=list)


def found_bags(folders: Sequence[Path]) -> list[Path]:
    """Return the bags in ``folders``, each once, sorted.

    Raises:
        InputError: a folder is missing, or there is no bag in any.
    """
    bags = sorted({bag.absolute() for folder in folders for bag in bags_in(folder)})
    if not bags:
        raise InputError(
            f"{', '.join(map(str, folders))}: no bag in it: a bag is a folder with metadata.yaml, "
            "or an .mcap file"
        )
    return bags


def stamp_of(bag: Path) -> str:
    """Return size and time of modification of the files of ``bag``, by which a change is noticed."""
    files = sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]
    facts = []
    for file in files:
        try:
            status = file.stat()
        except OSError:
            continue
        facts.append(f"{file.name}:{status.st_size}:{status.st_mtime_ns}")
    return ";".join(facts)


def add(
    manifest: Manifest,
    bags: Sequence[Path],
    naming: Naming,
    scans: Callable[[Sequence[Path]], Iterator[Scan]],
    advance: Callable[[float], None] = lambda _: None,
) -> Added:
    """Bring the catalogue up to date with ``bags``.

    Args:
        manifest: the store's.
        bags: absolute paths.
        naming: gives machine and valve.
        scans: scans bags, on whatever executor.
        advance: called with the number of bags that were looked at.
    """
    added = Added()
    changed = []
    for bag in bags:
        if manifest.stamp_of(str(bag)) == stamp_of(bag) and not _renamed(manifest, bag, naming):
            added.unchanged += 1
            advance(1)
        else:
            changed.append(bag)
    # In order of path, so that of two bags with one content always the same is the duplicate.
    waiting: dict[Path, Scan] = {}
    order = changed[::-1]
    for scan in scans(changed):
        waiting[scan.path] = scan
        while order and order[-1] in waiting:
            _take(manifest, waiting.pop(order.pop()), naming, added)
            advance(1)
    return added


@dataclass(frozen=True, slots=True)
class ScannedValve:
    """Record of one valve in a bag: ``start`` in ns since 1970, ``duration`` in s, ``rate`` in Hz, deg C."""

    namespace: str
    start: int
    duration: float
    rate: float
    lost_blocks: int
    oil_temperature: float = math.nan


@dataclass(frozen=True, slots=True)
class Scan:
    """Scan of a bag: SHA-256 of its content, its valves, ``ok`` or ``damaged`` with a reason."""

    path: Path
    content: str
    machine: str
    valves: tuple[ScannedValve, ...]
    status: str
    reason: str = ""


def bags_in(folder: Path) -> Iterator[Path]:
    """Yield the bags in and below ``folder`` (rosbag2 directories and lone ``.mcap`` files), sorted.

    Raises:
        InputError: there is no such folder.
    """
    if folder.is_file() and folder.suffix == ".mcap":
        yield folder
        return
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    if (folder / "metadata.yaml").exists():
        yield folder
        return
    for entry in sorted(folder.iterdir()):
        if entry.is_symlink():
            continue
        if entry.is_dir():
            yield from bags_in(entry)
        elif entry.suffix == ".mcap":
            # A directory without metadata.yaml is a bag as well: a killed recorder leaves one.
            yield entry if _alone(folder) else folder
            if not _alone(folder):
                return


def scan(path: Path) -> Scan:
    """Return what is in the bag at ``path``; what is wrong with it is its status."""
    content = ""
    try:
        content = sha256_of(sorted(path.glob("*.mcap")) if path.is_dir() else [path])
        found = describe(path)
        machine = custom_data(path).get(MACHINE, "")
        valves = tuple(_valve(path, one) for one in found.valves if one.first_stamp_ns is not None)
    except InputError as error:
        return Scan(path, content, "", (), DAMAGED, str(error))
    except OSError as error:
        return Scan(path, content, "", (), DAMAGED, f"{path}: cannot be read: {error.strerror}")
    reason = _reason(found)
    if not valves:
        return Scan(path, content, machine, (), DAMAGED, reason or f"{path}: no accelerations in it")
    return Scan(path, content, machine, valves, DAMAGED if reason else OK, reason)


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of one valve's record; empty where nothing is known, ``day`` ``None`` as well.

    ``days``: length of the period that begins on ``day``, of a month some 30.
    """

    machine: str = ""
    valve: str = ""
    day: date | None = None
    days: int = 1


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
                        why = "the field occurs twice" if name in named else f"known are {', '.join(FIELDS)}"
                        raise InputError(f"--pattern {self.text}: {{{name}}}: {why}")
                    named.append(name)
                    # Beside other text a date begins with its year, so that it is not cut within.
                    held = r"\d{4}.*" if name == "date" and part != piece else ".+"
                    expression += f"(?P<{name}>{held})"
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
        found = self._matched(path)
        return found if isinstance(found, Identity) else None

    def misfit(self, path: Path) -> str:
        """Return why ``path`` does not fit the pattern, "" where it does."""
        found = self._matched(path)
        return "" if isinstance(found, Identity) else found

    def _matched(self, path: Path) -> Identity | str:
        parts = path.absolute().with_suffix("" if path.suffix == ".mcap" else path.suffix).parts
        wanted = self.text.strip("/").split("/")
        if len(parts) <= len(self._expressions):
            return f"the path has fewer than {plural(len(wanted), 'part')}"
        found: dict[str, str] = {}
        own = zip(parts[-len(self._expressions) :], self._expressions, wanted, strict=True)
        for part, expression, text in own:
            matched = expression.fullmatch(part)
            if matched is None:
                return f"{printable(part, 60)!r} is not like {text}"
            found |= matched.groupdict()
        day, days = _period(found["date"]) if "date" in found else (None, 1)
        if "date" in found and day is None:
            shown = printable(found["date"], 60)
            return f"{shown!r} is not a date; dates begin with YYYY-MM-DD or YYYY-MM"
        return Identity(found.get("machine", ""), found.get("valve", ""), day, days)


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
                    raise InputError(f"{path}: line {number}: the column bag is empty; name a bag")
                text = row.get("date") or ""
                day, days = _period(text)
                if text and day is None:
                    raise InputError(
                        f"{path}: line {number}: {printable(text, 40)!r} is not a date: write 2026-01-31"
                    )
                bag = (path.parent / row["bag"]).absolute()
                found[bag] = Identity(row["machine"] or "", row["valve"] or "", day, days)
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
        first.days if first.day else other.days,
    )


def start_of(identity: Identity, stamp: int) -> tuple[int, str]:
    """Return when a record began (ns since 1970, UTC) and what is to be said of it.

    The stamps count, unless they contradict the date of ``identity``, which somebody filed the bag under.
    """
    if identity.day is None:
        return stamp, ""
    filed = datetime(identity.day.year, identity.day.month, identity.day.day, tzinfo=timezone.utc)
    midnight = round(filed.timestamp()) * 1_000_000_000
    half = 0.5 * identity.days
    if abs((stamp - midnight) / 86_400e9 - half) <= SAME_DAY + half - 0.5:
        return stamp, ""
    said = datetime.fromtimestamp(stamp / 1e9, timezone.utc).strftime("%Y-%m-%d")
    shown = f"{identity.day}" if identity.days == 1 else f"{identity.day:%Y-%m}"
    return midnight, f"its stamps give {said}, its path {shown}; the catalogue uses the path's date"


def _renamed(manifest: Manifest, bag: Path, naming: Naming) -> bool:
    """Return whether ``naming`` may call the records of ``bag`` otherwise than the catalogue does."""
    return any(
        (entry.machine, entry.valve_file) != (_named(bag, naming, entry.machine).machine, naming.valve_file)
        for entry in manifest.of(str(bag))
    )


def _named(bag: Path, naming: Naming, machine: str) -> Identity:
    own = naming.table.get(bag.absolute()) or (
        naming.pattern.match(bag) if naming.pattern is not None else None
    )
    return joined(own, Identity(machine))


def _take(manifest: Manifest, scan: Scan, naming: Naming, added: Added) -> None:
    path, stamp = str(scan.path), stamp_of(scan.path)
    named = _named(scan.path, naming, scan.machine)
    pattern = naming.pattern
    misfit = pattern.misfit(scan.path) if pattern is not None else ""
    if pattern is not None and misfit and scan.path.absolute() not in naming.table:
        # Valves of machines that cannot be distinguished would become one.
        left = "" if scan.machine else ": left out, since nothing else states its machine"
        added.told.append(f"{path}: does not fit --pattern {pattern.text}: {misfit}{left}")
        if left:
            manifest.put(path, [])
            added.left_out += 1
            return
    status, reason = scan.status, printable(scan.reason, 300)
    first = manifest.first_with(scan.content, path) if scan.content and status == OK else None
    if first is not None:
        status, reason = DUPLICATE, f"the same content as {first}"
    entries = []
    valves = scan.valves or (ScannedValve("", 0, 0.0, math.nan, 0),)
    for valve in valves:
        start, said = start_of(named, valve.start)
        name = named.valve or valve.namespace
        if named.valve and len(valves) > 1:
            name = f"{named.valve}/{valve.namespace}"
        entries.append(
            Entry(
                path, valve.namespace, scan.content, stamp, named.machine, name, start, valve.duration,
                as_json(valve.rate), valve.lost_blocks, as_json(valve.oil_temperature), status,
                reason or said, naming.valve_file,
            )
        )  # fmt: skip
    manifest.put(path, entries)
    added.new += 1
    added.nameless += named.machine == UNKNOWN
    added.damaged += status == DAMAGED
    added.duplicates += status == DUPLICATE
    if status != OK:
        added.told.append(reason if reason.startswith(path) else f"{path}: {reason}")
    added.redated += any(entry.reason for entry in entries) and status == OK


def _alone(folder: Path) -> bool:
    """Return whether the files of ``folder`` are separate bags: their names do not begin with its own."""
    return not all(file.stem.startswith(folder.name) for file in folder.glob("*.mcap"))


def _reason(found: BagInformation) -> str:
    """Return what is damaged, empty where nothing is; a recording that was not finished is none."""
    if found.damages:
        first = found.damages[0]
        more = f" and {len(found.damages) - 1} more places" if len(found.damages) > 1 else ""
        lost = f", about {found.lost_messages} messages lost" if found.lost_messages else ""
        return f"{first.reason} at byte {first.offset}{more}{lost}: `./spool recover` makes a readable bag"
    if found.undecodable_messages:
        topic, count = next(iter(found.undecodable_messages.items()))
        return f"{topic}: {plural(count, 'message')} left out: the bytes do not fit the type"
    missing = [warning for warning in found.warnings if "more are missing" in warning]
    return missing[0] if missing else ""


def _valve(path: Path, one: ValveSummary) -> ScannedValve:
    warm = math.nan
    if one.temperatures:
        values = [celsius for _, celsius in BagReader(path, skip_damage=True).temperatures(one.name)]
        known = [value for value in values if math.isfinite(value)]
        warm = math.fsum(known) / len(known) if known else math.nan
    rate = one.sample_rate or math.nan
    return ScannedValve(one.name, one.first_stamp_ns or 0, one.duration_s, rate, one.lost_blocks, warm)


def _period(text: str) -> tuple[date | None, int]:
    """Return the date that begins ``text``, anything may follow, and the days of its period.

    Dates are YYYY-MM-DD or YYYYMMDD, months YYYY-MM; ``-`` may be ``_`` or ``.``. ``None`` for all else.
    """
    match = re.match(r"(\d{4})([-_.]?)(\d{2})\2(\d{2})|(\d{4})[-_.](\d{2})(?![-_.]?\d)", text)
    if match is None:
        return None, 1
    try:
        if match[1]:
            return date(int(match[1]), int(match[3]), int(match[4])), 1
        year, month = int(match[5]), int(match[6])
        return date(year, month, 1), monthrange(year, month)[1]
    except ValueError:
        return None, 1
