"""`./spool doctor --live`: what the running nodes say, and how near this machine is to its limits."""

from __future__ import annotations

from typing import Annotated

import typer

from spool_tools.command import Command


def doctor(
    live: Annotated[bool, typer.Option("--live", help="Ask the running nodes and look at what limits them.")],
    seconds: Annotated[float, typer.Option(help="How long they are listened to.", min=1.0, max=600.0)] = 3.0,
) -> None:
    """Say what is wrong with machine and installation; with --live, what limits the nodes that run now.

    Exit code 1 where there is a problem.

    Example: ./spool doctor --live --seconds 10
    """
    del live
    from pathlib import Path  # noqa: PLC0415

    from spool_tools.operations import machine_findings as findings  # noqa: PLC0415

    before = findings.udp_counts(Path("/proc/net/snmp").read_text(encoding="ascii"))
    heard = findings.listen(seconds)
    found = [*findings.node_findings(heard), *findings.machine_findings(findings.ros_domain(), before)]
    for one in found:
        print(f"{one.level:8} {one.text}", flush=True)
    raise typer.Exit(int(any(one.level == "problem" for one in found)))


COMMAND = Command(
    doctor,
    place=1000,
    line="what is wrong with this machine or installation, and what to do; --live: the nodes",
)
