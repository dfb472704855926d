"""Text for people: plurals, suggestions for misspelt words, and what a terminal can print."""

from __future__ import annotations

import contextlib
import difflib
import io
import os
import re
import sys
from collections.abc import Iterable
from pathlib import PurePath
from typing import Any

#: Least similarity of a name that is suggested: difflib's own default.
SIMILAR = 0.6
_UNITS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}


class _NamedOutput(io.FileIO):
    """Standard output whose errors name it."""

    def write(self, data: Any, /) -> int:
        """Write ``data``.

        Raises:
            OSError: with the file that standard output leads to.
        """
        try:
            return super().write(data)
        except OSError as error:
            file = ""
            with contextlib.suppress(OSError):
                file = f" ({os.readlink('/proc/self/fd/1')})"
            error.filename = f"standard output{file}"
            raise


def plural(count: int, thing: str) -> str:
    """Return e.g. ``1 valve`` or ``20 valves``."""
    return f"{count} {thing}" + ("" if count == 1 else "s")


def seconds_of(text: str) -> float | None:
    """Return the seconds of a length of time like ``30s``, ``10m``, ``6h``, ``7d`` or ``2w``.

    ``None`` where ``text`` is something else.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|min|m|h|d|w)", text.strip())
    return float(match[1]) * _UNITS[match[2]] if match else None


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean NAME?"`` for the known name nearest to ``given``, empty where none is near.

    Upper and lower case, ``-`` for ``_`` and the folder and ending of a path make no difference.
    """
    by_form = {_form(name): name for name in known}
    for form in (_form(given), _form(PurePath(given).stem)):
        near = difflib.get_close_matches(form, by_form, n=1, cutoff=SIMILAR)
        if near:
            return f"; did you mean {by_form[near[0]]}?"
    return ""


def printable(text: object, longest: int = 2000) -> str:
    """Return ``text`` with every character that is not printable (Unicode) written as its escape.

    Args:
        text: of any origin.
        longest: characters kept; what is longer ends in ``...``.
    """
    whole = str(text)
    cut = whole if len(whole) <= longest else whole[: longest - 3] + "..."
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape", "surrogatepass").decode("ascii")
        for one in cut
    )


def keep_standard_streams() -> None:
    """Open ``/dev/null`` in place of closed standard streams; print ``?`` for what theirs cannot encode.

    The next file that is opened would get their number, and what libraries print would go into it.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # The lowest free number is given, which is this one.
            os.open(os.devnull, os.O_RDONLY if descriptor == 0 else os.O_WRONLY)
            os.set_inheritable(descriptor, True)  # what is started needs its streams as well
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if type(sys.stdout) is io.TextIOWrapper and sys.stdout.fileno() == 1:
        by_line = sys.stdout.isatty() or sys.stdout.write_through
        sys.stdout = io.TextIOWrapper(
            io.BufferedWriter(_NamedOutput(1, "w", closefd=False)), sys.stdout.encoding, "replace",
            line_buffering=by_line,
        )  # fmt: skip


def drop_output() -> None:
    """Discard the rest of the output: the reader (``| head``) has ended."""
    null = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(null, stream.fileno())
    os.close(null)


def _form(name: str) -> str:
    return name.lower().replace("-", "_").replace(" ", "_")
