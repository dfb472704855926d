"""Print the commands with their options, the public Python names and the messages of a repository as JSON."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from typing import Any

import spool
from spool_tools.cli import app
from typer.main import get_command


def commands(group: Any, path: str = "") -> Iterator[tuple[str, list[str]]]:
    context = group.make_context("spool", [], resilient_parsing=True)
    for name in group.list_commands(context):
        one = group.get_command(context, name)
        if hasattr(one, "list_commands"):
            yield from commands(one, f"{path}{name} ")
        else:
            yield (
                f"{path}{name}",
                [
                    word
                    for each in one.params
                    if not getattr(each, "hidden", False)
                    for word in (*each.opts, *each.secondary_opts)
                ],
            )


def names(owner: Any, known: Any, path: str) -> Iterator[tuple[str, list[str]]]:
    for name in sorted(known):
        one = getattr(owner, name) if inspect.ismodule(owner) else inspect.getattr_static(owner, name)
        if not name.startswith("_") and not hasattr(ValueError, name):
            shown = str(inspect.signature(one)) if inspect.isroutine(one) else type(one).__name__
            yield f"{path}.{name}", [shown, *(inspect.getdoc(one) or "").splitlines()]
            yield from names(one, dir(one), f"{path}.{name}") if inspect.isclass(one) else ()


if __name__ == "__main__":
    python = dict(names(spool, spool.__all__, "spool"))
    print(json.dumps({"commands": dict(commands(get_command(app))), "python": python}))
