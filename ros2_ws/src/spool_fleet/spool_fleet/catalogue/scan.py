"""Scan of a bag: what the catalogue holds of it; damage is a finding, never an error."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from spool_bag.mcap.metadata import MACHINE, custom_data
from spool_bag.reading.information import BagInformation, ValveSummary, describe
from spool_bag.reading.reader import BagReader
from spool_core.errors import InputError
from spool_core.text import plural

OK, DAMAGED, DUPLICATE = "ok", "damaged", "duplicate"


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


def _alone(folder: Path) -> bool:
    """Return whether the files of ``folder`` are bags of their own: their names do not begin with its own."""
    return not all(file.stem.startswith(folder.name) for file in folder.glob("*.mcap"))


def scan(path: Path) -> Scan:
    """Return what is in the bag at ``path``; what is wrong with it is its status."""
    content = ""
    try:
        content = content_of(path)
        found = describe(path)
        machine = custom_data(path).get(MACHINE, "")
        valves = tuple(_valve(path, one) for one in found.valves if one.first_stamp is not None)
    except InputError as error:
        return Scan(path, content, "", (), DAMAGED, str(error))
    except OSError as error:
        return Scan(path, content, "", (), DAMAGED, f"{path}: cannot be read: {error.strerror}")
    reason = _reason(found)
    if not valves:
        return Scan(path, content, machine, (), DAMAGED, reason or f"{path}: no accelerations in it")
    return Scan(path, content, machine, valves, DAMAGED if reason else OK, reason)


def content_of(path: Path) -> str:
    """Return the SHA-256 of the messages' files of a bag, in order of name.

    Raises:
        OSError: one cannot be read.
    """
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while piece := stream.read(1 << 20):
                digest.update(piece)
    return digest.hexdigest()


def _reason(found: BagInformation) -> str:
    """Return what is damaged, empty where nothing is; a recording that was not finished is none."""
    if found.damages:
        first = found.damages[0]
        more = f" and {len(found.damages) - 1} more places" if len(found.damages) > 1 else ""
        lost = f", about {found.lost_messages} messages lost" if found.lost_messages else ""
        return f"{first.reason} at byte {first.offset}{more}{lost}: `./spool recover` makes a readable bag"
    if found.undecodable:
        topic, count = next(iter(found.undecodable.items()))
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
    return ScannedValve(one.name, one.first_stamp or 0, one.duration, rate, one.lost_blocks, warm)
