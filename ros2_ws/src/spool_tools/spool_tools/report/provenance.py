"""Provenance of a report: when, by which version and command, from which records and valve file."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from spool_sim.valve import Valve

from spool_tools.outputs import command_line, suite_version

#: Files of one bag whose checksums are shown at most.
MOST_FILES = 20


def provenance() -> list[tuple[str, str]]:
    """Return label and value of what every report says: date, version, command."""
    now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    rows = [("written", now), ("by", f"spool {suite_version()}")]
    return [*rows, ("command", command_line())] if command_line() else rows


def sources(records: Sequence[Path], valve: Valve | None = None) -> list[tuple[str, str]]:
    """Return label and value for each file of ``records`` with its checksum, and for the valve."""
    rows = [("record", f"{file}, SHA-256 {_checksum(file)}") for path in records for file in _files(path)]
    if valve is not None:
        numbers = f"{valve.moving_mass:g} kg, {valve.spring_stiffness:g} N/m"
        rows.append(("valve", f"{valve.id}: {numbers}, {valve.natural_frequency:.3g} Hz"))
    return rows


def _files(path: Path) -> list[Path]:
    """Return the files that a record consists of."""
    return sorted(path.glob("*.mcap"))[:MOST_FILES] if path.is_dir() else [path]


def _checksum(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(1 << 20):
                digest.update(chunk)
    except OSError as error:
        return f"not known: {error.strerror}"
    return digest.hexdigest()
