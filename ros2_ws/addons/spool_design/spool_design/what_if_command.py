"""`./spool what-if`: the response of a valve under changed conditions."""

from __future__ import annotations

from rich.console import Console
from spool_report.outputs import write_file, write_json
from spool_report.terminal import warn
from spool_tools import command as cli

from spool_design.requests import WhatIfRequest


def what_if(
    request: WhatIfRequest,
    json: cli.JsonFile = None,
    report: cli.ReportFile = None,
    _force: cli.Force = False,
) -> None:
    """Predict the response of a valve with other springs, oil, mass or mount, and compare it with today.

    Example: ./spool what-if --valve 4weh10_soft --spring-stiffness 5846 --speed-range 600:2400 --order 1,2

    Example: ./spool what-if --valve 4weh10_soft --model coulomb --mount-frequency 6 --mount-damping 0.1
    """
    from spool_design.what_if import print_what_if  # noqa: PLC0415 - slow to load
    from spool_design.what_if import what_if as predict  # noqa: PLC0415 - slow to load

    found = predict(request)
    for note in found.notes:
        warn(note)
    print_what_if(found, Console())
    if json is not None:
        write_json(json, found)
    if report is not None:
        from spool_design.what_if_page import what_if_page  # noqa: PLC0415 - matplotlib is needed here only

        write_file(report, what_if_page(found), "--report")
        print(f"{report}: pictures and tables")


COMMAND = cli.Command(what_if, place=410, line="response with other springs, oil, mass or mount")
