"""The terminal: tables and text, and the progress of long work with its time left."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text
from spool_core.text import printable

_silent: ContextVar[bool] = ContextVar("silent", default=False)


def cell(text: object, style: str = "") -> Text:
    """Return ``text`` for a table or a line: as it is, without markup, escapes shown instead of followed."""
    return Text(printable(text), style=style)


def wide_console(width: int, *, markup: bool = True) -> Console:
    """Return standard output; off a terminal its lines are ``width`` wide, so that no name is cut."""
    console = Console(highlight=False, markup=markup)
    return console if console.is_terminal else Console(highlight=False, markup=markup, width=width)


def warn(text: str, console: Console | None = None) -> None:
    """Show a warning on ``console``; default: standard error."""
    (console or Console(stderr=True)).print(
        f"warning: {printable(text)}", style="yellow", markup=False, highlight=False, soft_wrap=True
    )


@contextmanager
def silently() -> Iterator[None]:
    """Show no progress inside: the caller is a program, not a person at a terminal."""
    token = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(token)


@contextmanager
def progress(what: str, total: float | None = None) -> Iterator[Callable[[float], None]]:
    """Show a bar with the time left on a terminal; yields a function that takes what has been done since.

    Silent where standard error is no terminal: what reads it expects errors and warnings only.
    """
    if _silent.get() or not sys.stderr.isatty():
        yield lambda _done: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.advance(task, done)
