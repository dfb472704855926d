"""Terminal output for people: warnings and lines with nothing in them that steers the terminal."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.text import Text
from spool_core.text.printable import printable


def cell(text: object, style: str = "") -> Text:
    """Return ``text`` for a table or a line: as it is, without markup, escapes shown instead of followed."""
    return Text(printable(text), style=style)


def warn(text: str) -> None:
    """Show a warning on standard error."""
    Console(stderr=True).print(
        f"warning: {printable(text)}", style="yellow", markup=False, highlight=False, soft_wrap=True
    )


def fail(text: str, code: int = 2) -> int:
    """Say on standard error in one line what is wrong; return the exit code."""
    print("spool: " + printable(" ".join(text.split())), file=sys.stderr)
    return code
