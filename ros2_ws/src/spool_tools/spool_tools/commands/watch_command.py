"""`./spool watch`: running valves on the terminal, or as a page on this host."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError

from spool_tools.command import Command, LanguageOption

#: Entry point of the function that serves the page: of another package, which a machine may lack.
PAGES = "spool.pages"


def watch(
    valves: Annotated[
        list[str] | None,
        typer.Argument(metavar="[VALVE]...", help="Namespaces of valves; default: all that are heard."),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="As a page, for browsers on this host.")] = False,
    port: Annotated[int, typer.Option(help="Port of the page.", min=1, max=65535)] = 8765,
    operator: Annotated[
        bool, typer.Option("--operator", help="The page may acknowledge and shelve, with a token.")
    ] = False,
    metrics: Annotated[
        bool, typer.Option("--metrics", help="The page serves /metrics for Prometheus.")
    ] = False,
    bags: Annotated[
        Path | None,
        typer.Option(help="Recording, or folder of recordings, that fills the page's waterfalls."),
    ] = None,
    who: Annotated[str, typer.Option(help="Who acknowledges and shelves; default: the user's name.")] = "",
    seconds: Annotated[
        float | None, typer.Option(help="Off a terminal: end after so many seconds.", min=0.0)
    ] = None,
    language: LanguageOption = "",
) -> None:
    """Watch running valves: a table, worst first, their alarms, and keys to acknowledge, shelve and reset.

    Off a terminal a line for each valve every 5 s, and each event at once.

    Example: ./spool watch

    Example: ./spool watch --web --port 8765 --bags recordings
    """
    if web:
        page = next(iter(entry_points(group=PAGES)), None)
        if page is None:
            raise InputError("--web: the package spool_view is not installed here")
        page.load()(port=port, operator=operator, metrics=metrics, names=tuple(valves or ()), bags=bags)
        return
    if operator:
        raise InputError("--operator: is of the page, with --web; on the terminal the keys are there anyway")
    if metrics:
        raise InputError("--metrics: the page serves them: add --web")
    if bags is not None:
        raise InputError("--bags: the page shows them: add --web")
    from spool_tools.operations.watch import watch as run  # noqa: PLC0415 - slow to load

    run(tuple(valves or ()), who, seconds, language)


COMMAND = Command(
    watch, place=155, line="running valves on the terminal, or as a page on this host", live=True
)
