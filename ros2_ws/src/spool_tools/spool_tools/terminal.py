"""The terminal: tables and text, and the progress of long work with its time left."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text
from spool_core.text import printable

#: s between lines where there is no terminal.
INTERVAL = 10.0

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


def fail(text: str, code: int = 2) -> int:
    """Say on standard error in one line what is wrong; return the exit code."""
    print("spool: " + printable(" ".join(text.split())), file=sys.stderr)
    return code


@contextmanager
def silently() -> Iterator[None]:
    """Show no progress inside: the caller is a program, not a person at a terminal."""
    token = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(token)


@contextmanager
def progress(
    what: str, total: float | None = None, *, interval: float = INTERVAL
) -> Iterator[Callable[[float], None]]:
    """Show on stderr how far the block is; yields a function that takes what has been done since.

    A bar on a terminal; where there is none, a line every ``interval`` s, so that what ends before is silent.
    """
    if _silent.get():
        yield lambda _done: None
        return
    console = Console(stderr=True)
    if not console.is_terminal:
        lines = _Lines(what, total, interval)
        with lines.told():
            yield lines.advance
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.advance(task, done)


@dataclass(slots=True)
class _Lines:
    """Progress lines about one piece of work, written by a thread of their own."""

    what: str
    total: float | None
    interval: float
    _done: float = field(default=0.0, init=False)
    _begun: float = field(default_factory=time.monotonic, init=False)
    _over: threading.Event = field(default_factory=threading.Event, init=False)

    def advance(self, done: float) -> None:
        """Take what has been done since."""
        self._done += done

    @contextmanager
    def told(self) -> Iterator[None]:
        """Tell while the block runs."""
        thread = threading.Thread(target=self._tell, name="progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            thread.join()

    def _tell(self) -> None:
        while not self._over.wait(self.interval):
            print(self.line(time.monotonic() - self._begun), file=sys.stderr, flush=True)

    def line(self, elapsed: float) -> str:
        """Return what is said ``elapsed`` s after the start."""
        text = f"{self.what}: {elapsed:.0f} s"
        share = min(1.0, self._done / self.total) if self.total else 0.0
        if share > 0.0:
            text += f", {100.0 * share:.0f} % done, about {elapsed * (1.0 / share - 1.0):.0f} s left"
        return text
