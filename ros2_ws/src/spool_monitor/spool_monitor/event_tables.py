"""Tables of the event kinds for docs/alarms.md; ``python -m spool_monitor.event_tables docs/alarms.md``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from pathlib import Path

from spool_core.events.language import ENGLISH

from spool_monitor.detectors import KINDS
from spool_monitor.detectors.unknowable import TABLE


def number_table() -> str:
    """Return numbers, status after NE 107 and latch of every kind and cause, in Markdown."""
    rows = []
    for kind in KINDS.values():
        # The status of a cause where it is not the kind's.
        causes = ", ".join(
            f"{cause.code} `{cause.name}`" + (f" ({cause.namur.letter})" if cause.namur else "")
            for cause in kind.causes
        )
        notes = "; ".join(part for part in (causes, "latches" if kind.latching else "") if part)
        rows.append((f"`{kind.name}`", kind.code, kind.namur.letter, notes))
    return _table(("kind", "number", "status", "causes"), rows)


def meaning_table() -> str:
    """Return what every kind and cause means on the machine and what to do, in Markdown."""
    names = ((kind, [one.name for one in kind.causes] or [""]) for kind in KINDS.values())
    codes = (kind.cause(name).code for kind, listed in names for name in listed)
    rows = ((code, *ENGLISH.event(code)) for code in codes)
    return _table(("number", "title", "what it means", "what to do"), rows)


def unknowable_table() -> str:
    """Return which fault keeps which other from being judged, and why, in Markdown."""
    rows = (
        (", ".join(f"`{one}`" for one in row.by), ", ".join(f"`{one}`" for one in row.what), row.why)
        for row in TABLE
    )
    return _table(("while this is active", "these are not judged", "why"), rows)


def _table(header: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    lines = [header, ("---",) * len(header), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def main(page: Path) -> None:
    """Bring the tables of ``page`` up to date."""
    text = page.read_text(encoding="utf-8")
    for table in (number_table(), meaning_table(), unknowable_table()):
        old = re.search(rf"{re.escape(table.splitlines()[0])}\n(\|.*\n)+", text)
        if old is not None:
            text = text.replace(old[0], table)
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
