"""Faults of the suite itself: they are reported as such, and their tracebacks are kept."""

from __future__ import annotations

import os
import shlex
import sys
import traceback
from contextlib import suppress
from pathlib import Path

from spool_core.system import private_temporary_folder

#: Environment variable: 1 shows the traceback of each error that becomes one line.
TRACEBACK = "SPOOL_TRACEBACK"
#: Bytes of the log of unexpected errors, chosen to hold a hundred of them; a larger one begins again.
LARGEST_LOG = 1_000_000
#: Modules of the standard library that raise whatever a damaged file brings.
PARSERS = ("bz2", "gzip", "json", "lzma", "tarfile", "tokenize", "xml", "zipfile", "zlib")


def show_traceback(error: BaseException) -> None:
    """Write the traceback of ``error`` to standard error if ``SPOOL_TRACEBACK`` asks for it."""
    if os.environ.get(TRACEBACK, "") not in ("", "0"):
        with suppress(OSError):
            print("".join(traceback.format_exception(error)), end="", file=sys.stderr, flush=True)


def unexpected(error: BaseException) -> str:
    """Return the line for an error that nobody foresaw, a fault of the suite; its traceback goes to a log."""
    show_traceback(error)
    place = traceback.extract_tb(error.__traceback__)[-1:]
    where = "".join(f", {Path(one.filename).name} line {one.lineno}" for one in place)
    said = f"internal error ({type(error).__name__}: {error}{where}): a fault of the suite, not of your input"
    try:
        log = private_temporary_folder("log") / "errors.log"
        mode = "a" if log.exists() and log.stat().st_size < LARGEST_LOG else "w"
        with log.open(mode, encoding="utf-8", errors="backslashreplace") as stream:
            stream.write(f"{shlex.join(sys.argv)}\n{''.join(traceback.format_exception(error))}\n")
    except OSError:
        return f"{said}; set {TRACEBACK}=1 to see its traceback, and report it"
    return f"{said}; report it with the traceback in {log} ({TRACEBACK}=1 shows it)"


def raised_by_library(error: BaseException) -> bool:
    """Return whether a library that reads files raised ``error``, and not code of the suite.

    NumPy and most of the standard library do not count: what they refuse, the suite has given them.
    """
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        root = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if root.startswith("spool"):
            break
        installed = {"site-packages", "dist-packages"} & set(Path(str(frame.f_globals.get("__file__"))).parts)
        if root in PARSERS or (installed and root != "numpy"):
            return True
    return False
