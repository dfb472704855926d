"""Addition of bags to the catalogue; what is damaged or there twice is told, never fatal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from spool_core.errors import InputError
from spool_core.text import printable

from .identity import Identity, PathPattern, joined, of_table, start_of
from .manifest import Entry, Manifest
from .scan import DAMAGED, DUPLICATE, OK, Scan, ScannedValve, bags_in


@dataclass(frozen=True, slots=True)
class Naming:
    """Naming of bags by a ``pattern`` of their paths or a ``table``; the valve file that describes them."""

    pattern: PathPattern | None = None
    table: Mapping[Path, Identity] = field(default_factory=dict)
    valve_file: str = ""


@dataclass(slots=True)
class Added:
    """What an addition found: numbers of bags, and a line about each that is not as it should be.

    ``redated`` ones are filed under another date than their stamps say.
    """

    new: int = 0
    unchanged: int = 0
    damaged: int = 0
    duplicates: int = 0
    redated: int = 0
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
        advance: is told the number of bags that were looked at.
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
    order = iter(changed)
    expected = next(order, None)
    for scan in scans(changed):
        waiting[scan.path] = scan
        while expected is not None and expected in waiting:
            _take(manifest, waiting.pop(expected), naming, added)
            advance(1)
            expected = next(order, None)
    return added


def _renamed(manifest: Manifest, bag: Path, naming: Naming) -> bool:
    """Return whether ``naming`` may call the records of ``bag`` otherwise than the catalogue does."""
    return any(
        (entry.machine, entry.valve_file) != (_named(bag, naming, entry.machine).machine, naming.valve_file)
        for entry in manifest.of(str(bag))
    )


def _named(bag: Path, naming: Naming, machine: str) -> Identity:
    own = of_table(naming.table, bag) or (naming.pattern.match(bag) if naming.pattern is not None else None)
    return joined(own, Identity(machine))


def _take(manifest: Manifest, scan: Scan, naming: Naming, added: Added) -> None:
    path, stamp = str(scan.path), stamp_of(scan.path)
    named = _named(scan.path, naming, scan.machine)
    status, reason = scan.status, printable(scan.reason, 300)
    first = manifest.first_with(scan.content, path) if scan.content and status == OK else None
    if first is not None:
        status, reason = DUPLICATE, f"the same content as {first}"
    outside = naming.pattern is not None and naming.pattern.match(scan.path) is None
    if outside and of_table(naming.table, scan.path) is None:
        added.told.append(f"{path}: does not fit --pattern {naming.pattern.text if naming.pattern else ''}")
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
                _known(valve.rate), valve.lost_blocks, _known(valve.oil_temperature), status,
                reason or said, naming.valve_file,
            )
        )  # fmt: skip
    manifest.put(path, entries)
    added.new += 1
    if status == DAMAGED:
        added.damaged += 1
    added.duplicates += status == DUPLICATE
    if status != OK:
        added.told.append(reason if reason.startswith(path) else f"{path}: {reason}")
    added.redated += any(entry.reason for entry in entries) and status == OK


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
