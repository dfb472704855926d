"""`./spool watch`: running valves on the terminal, or as a page on this host."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError
from spool_report.requests import LanguageOption

from spool_tools.command import Command

#: Entry point of the function that serves the page: of another package, which a machine may lack.
PAGES = "spool.pages"


def watch(
    valves: Annotated[
        list[str] | None,
        typer.Argument(metavar="[VALVE]...", help="Namespaces of valves; default: all running valves."),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve a page for browsers on this host.")] = False,
    port: Annotated[int, typer.Option(help="Port of the page.", min=1, max=65535)] = 8765,
    operator: Annotated[
        bool, typer.Option("--operator", help="Allow the page to acknowledge and shelve, with a token.")
    ] = False,
    operators: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="With --operator: folder of ./spool secure --opcua, whose operators sign in by name and "
            "password.",
        ),
    ] = None,
    metrics: Annotated[
        bool, typer.Option("--metrics", help="Serve /metrics for Prometheus on the page's port.")
    ] = False,
    seconds: Annotated[float | None, typer.Option(help="End after this many seconds.", min=0.0)] = None,
    language: LanguageOption = "",
) -> None:
    """Watch running valves: a table, worst first, and their alarms. Operate them with ./spool alarm.

    Without a terminal: one line per valve every 5 s, and each event immediately.

    Example: ./spool watch

    Example: ./spool watch --web --port 8765 --operator
    """
    if web:
        page = next(iter(entry_points(group=PAGES)), None)
        if page is None:
            raise InputError("--web: the package spool_view is not installed here")
        if operators is not None and not operator:
            raise InputError("--operators: add --operator")
        page.load()(
            port=port, operator=operator, metrics=metrics, names=tuple(valves or ()), operators=operators
        )
        return
    if operator or operators is not None:
        raise InputError("--operator: is of the page: add --web; on the terminal use ./spool alarm")
    if metrics:
        raise InputError("--metrics: the page serves them: add --web")
    from spool_tools.operations.live_run import watch as run  # noqa: PLC0415 - slow to load

    run(tuple(valves or ()), seconds, language)


COMMAND = Command(
    watch, place=205, line="running valves on the terminal, or as a page on this host", live=True
)
