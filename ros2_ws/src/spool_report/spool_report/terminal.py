"""The terminal: tables and text, and the progress of long work with its time left."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from rich import progress as bars
from rich import table as rich_table
from rich.console import Console
from rich.text import Text
from spool_core.kernels.kernel_files import COMPILING, KernelCache
from spool_core.text import printable
from spool_core.uncertainty import number

#: Share of the work from which the time left is shown.
LEAST_DONE = 0.1

_silent: ContextVar[bool] = ContextVar("silent", default=False)


def cell(text: object, style: str = "") -> Text:
    """Return ``text`` for a table or a line: as it is, without markup, escapes shown instead of followed."""
    return Text(printable(text), style=style)


@cache
def captions(page: str) -> Any:
    """Return how to read the tables and pictures of a ``page``, by their names."""
    from spool_core.files import load_yaml  # noqa: PLC0415 - YAML, which most commands do not need

    texts = Path(__file__).with_name("templates") / "captions.yaml"
    return load_yaml(texts.read_text("utf-8"))[page]


def spoken(name: str) -> str:
    """Return the ``name`` of a model, an effect or a parameter for people, e.g. ``coulomb force``."""
    return name.replace("_", " ")


@dataclass(frozen=True, slots=True)
class Table:
    """Table of a result: the terminal and the page show the same.

    Attributes:
        columns: names.
        rows: cells in the order of the columns; the last ones may be missing.
        numbers: columns of numbers, which stand to the right and are not broken.
        title: heading on a page.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    numbers: Collection[str] = ()
    title: str = ""

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, object]]) -> Table:
        """Return the table of ``rows`` that name their cells alike."""
        return cls(list(rows[0]), [list(row.values()) for row in rows])

    def show(self, console: Console, *, header: bool = True) -> None:
        """Show the table, nothing without rows. What is too wide goes on in the next line."""
        shown = rich_table.Table(box=None, pad_edge=False, show_header=header)
        for name in self.columns:
            if name in self.numbers:
                shown.add_column(name, justify="right", no_wrap=True)
            else:
                shown.add_column(name, overflow="fold")
        for row in self.rows:
            shown.add_row(*(cell(number(one) if isinstance(one, float) else one) for one in row))
        if self.rows:
            console.print(shown)


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
def progress(
    what: str, total: float | None = None, *, steady: bool = True, at_most: bool = False
) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal; yields a function that takes what has been done since.

    Silent where standard error is no terminal: what reads it expects errors and warnings only. While kernels
    compile, which a first start does, the bar says so.

    Args:
        what: work that is done.
        total: all of it, in the unit of what is done; unknown without.
        steady: whether equal parts take equal times, so that the time left can be known.
        at_most: the work may end long before ``total``, which the time left then states.
    """
    if _silent.get() or not sys.stderr.isatty():
        yield lambda _done: None
        return
    left = [TimeLeft(at_most=at_most)] if total is not None and steady else [bars.TimeElapsedColumn()]
    columns = (bars.TextColumn("{task.description}"), bars.BarColumn(), bars.TaskProgressColumn(), *left)
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        compiling = 0

        def watch(change: int) -> None:
            nonlocal compiling
            compiling += change
            bar.update(task, description=f"{what}: {COMPILING}" if compiling > 0 else what)
            if not compiling:  # the time that it took is none of the work's
                bar.update(task, begun=bar.tasks[0].completed, since=bar.tasks[0].elapsed)

        before, KernelCache.watch = KernelCache.watch, watch
        try:
            yield lambda done: bar.advance(task, done)
        finally:
            KernelCache.watch = before


class TimeLeft(bars.ProgressColumn):
    """Time left, from the rate so far; empty while too little is done to know it."""

    def __init__(self, *, at_most: bool = False) -> None:
        """Show the time as that ``at_most``, not as that expected."""
        super().__init__()
        self._about = "at most" if at_most else "about"

    def render(self, task: bars.Task) -> Text:
        """Return the time, e.g. ``about 40 s left``."""
        done = task.completed - task.fields.get("begun", 0.0)
        if not task.total or task.elapsed is None or done < LEAST_DONE * task.total:
            return Text("")
        seconds = task.elapsed - task.fields.get("since", 0.0)
        left = seconds * max(0.0, task.total - task.completed) / done
        text = f"{left:.0f} s left" if left < 120.0 else f"{left / 60.0:.0f} min left"
        return Text(f"{self._about} {text}")
