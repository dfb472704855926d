"""`./spool python`: Python with the packages of the suite."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import typer
from spool_core.errors import InputError

from spool_tools.command import PASSING_ON, Command


def python(context: typer.Context) -> None:
    """Run Python with the suite's packages: a script, a module (-m), code (-c), or an interactive session.

    All arguments go to Python unchanged; it is the interpreter of the suite's own environment.

    Example: ./spool python -m spool_monitor.event_tables docs/alarms.md

    Example: ./spool python my_analysis.py my_record
    """
    arguments = context.args
    script = arguments[0] if arguments else "-"
    if not script.startswith("-") and not Path(script).exists():
        raise InputError(
            f"{script}: no such script; pass a file, -m MODULE, -c CODE, or nothing for a session"
        )
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, *arguments])


COMMAND = Command(
    python,
    place=500,
    line="Python with the suite's packages: ./spool python [SCRIPT|-m MODULE|-c CODE] [arguments]",
    settings=PASSING_ON,
)
