"""`./spool param`: limits and other parameters of a running valve's nodes."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools.command import Command, RunningValve

app = typer.Typer(
    no_args_is_help=True,
    help="Show and change the limits of a running monitor, or parameters of another node of the valve.\n\n"
    "Example: ./spool param list valve_1",
)

NodeName = Annotated[str, typer.Option("--node", help="Node of the valve, e.g. estimator.")]


@app.command("list")
def list_(valve: RunningValve, node: NodeName = "monitor") -> None:
    """List the parameters with value, unit, range and meaning.

    Example: ./spool param list valve_1
    """
    from spool_tools.operations.service_client import list_parameters  # noqa: PLC0415 - slow to load

    list_parameters(valve, node)


@app.command()
def get(
    valve: RunningValve,
    name: Annotated[str, typer.Argument(metavar="NAME", help="Parameter, e.g. coulomb_change.")],
    node: NodeName = "monitor",
) -> None:
    """Print the value of one parameter.

    Example: ./spool param get valve_1 coulomb_change
    """
    from spool_tools.operations.service_client import list_parameters  # noqa: PLC0415 - slow to load

    list_parameters(valve, node, name)


@app.command("set")
def set_(
    valve: RunningValve,
    changes: Annotated[
        list[str], typer.Argument(metavar="NAME=VALUE...", help="New values; all of them are taken, or none.")
    ],
    node: NodeName = "monitor",
) -> None:
    """Change parameters of the running node, until it ends; exit 2 if the node refuses.

    Example: ./spool param set valve_1 coulomb_change=0.2
    """
    from spool_tools.operations.service_client import set_parameters  # noqa: PLC0415 - slow to load

    set_parameters(valve, node, changes)


COMMAND = Command(app, place=220, line="limits of a running monitor: list, get, set", live=True)
