"""`./spool doctor --live`: what the running nodes say, and how near this machine is to its limits."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools.command import Command


def doctor(
    live: Annotated[bool, typer.Option("--live", help="Check the running nodes and their limits, too.")],
    seconds: Annotated[float, typer.Option(help="How long they are listened to.", min=1.0, max=600.0)] = 3.0,
) -> None:
    """Report problems of machine and installation; with --live, of the running nodes too.

    Exit code 1 if there is a problem.

    Example: ./spool doctor --live --seconds 10
    """
    del live
    from pathlib import Path  # noqa: PLC0415

    from spool_tools.operations import machine_findings, node_findings  # noqa: PLC0415

    before = machine_findings.udp_counts(Path("/proc/net/snmp").read_text(encoding="ascii"))
    heard = node_findings.listen(seconds)
    found = [*node_findings.node_findings(heard), *machine_findings.load_findings(before)]
    raise typer.Exit(machine_findings.print_findings(found))


COMMAND = Command(
    doctor, place=20, line="problems of this machine or installation and their remedies; --live: of the nodes"
)
