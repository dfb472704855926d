"""`./spool alarm`: the alarms of a running valve, and what an operator does about them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from spool_core.errors import InputError
from spool_core.text import seconds_of
from spool_report.requests import LanguageOption, in_range, option

from spool_tools import command as cli

app = typer.Typer(
    no_args_is_help=True,
    help="Show the alarms of a valve and their history, and act on them.\n\n"
    "Example: ./spool alarm list valve_1",
)

Name = Annotated[
    str,
    typer.Argument(
        metavar="[ALARM]", help="Alarm name or kind; default: every alarm that the action applies to."
    ),
]
SomeValve = Annotated[
    str | None, typer.Argument(metavar="[VALVE]", help="Namespace of the valve; default: all valves.")
]
SinceAgo = Annotated[
    str | None, option("How long ago, e.g. 6h, 7d, or a time (UTC); default: all.", "--since")
]
Back = Annotated[bool, option("Undo the shelving or suppression.", "--back")]


@app.command("list")
def list_(
    valve: cli.RunningValve,
    every: Annotated[bool, option("Include alarms in the normal state.", "--all")] = False,
    details: Annotated[bool, option("Show everything known of each alarm.", "--details")] = False,
    language: LanguageOption = "",
) -> None:
    """List the alarms of a running valve; exit 1 if an alarm waits for an operator.

    Example: ./spool alarm list valve_1

    Example: ./spool alarm list valve_1 --details --language de
    """
    from spool_tools.operations.service_client import show_alarms  # noqa: PLC0415 - slow to load

    raise typer.Exit(show_alarms(valve, every=every, details=details, language=language))


@app.command()
def acknowledge(
    valve: cli.RunningValve, alarm: Name = "", who: cli.WhoOption = "", comment: cli.CommentOption = ""
) -> None:
    """Acknowledge an alarm.

    Example: ./spool alarm acknowledge valve_1 resonance --comment "speed reduced"
    """
    _ask(valve, "acknowledge_alarm", alarm=alarm, who=who, comment=comment)


@app.command()
def shelve(
    valve: cli.RunningValve,
    alarm: Name = "",
    minutes: Annotated[
        float,
        option("How long, a week at most; 0: until the condition is over.", callback=in_range(0.0, 10080.0)),
    ] = 30.0,
    back: Back = False,
    who: cli.WhoOption = "",
    comment: cli.CommentOption = "",
) -> None:
    """Shelve an alarm for a limited time.

    Example: ./spool alarm shelve valve_1 resonance --minutes 30
    """
    duration = 60.0 * minutes
    _ask(valve, "shelve_alarm", alarm=alarm, who=who, comment=comment, shelved=not back, duration=duration)


@app.command()
def suppress(
    valve: cli.RunningValve,
    alarm: Name = "",
    maintenance: Annotated[bool, option("Set the alarm out of service.", "--maintenance")] = False,
    for_: Annotated[
        str | None, option("Take the alarm out of service for this time, e.g. 2h.", "--for")
    ] = None,
    back: Back = False,
    who: cli.WhoOption = "",
    comment: cli.CommentOption = "",
) -> None:
    """Suppress an alarm by design (plant state), or take it out of service (maintenance).

    Example: ./spool alarm suppress valve_1 --for 2h --comment "pump replacement"

    Example: ./spool alarm suppress valve_1 --maintenance --back
    """
    from spool_msgs.srv import SuppressAlarm  # noqa: PLC0415 - slow to load

    duration = 0.0 if for_ is None else seconds_of(for_)
    if duration is None or (for_ is not None and (back or duration <= 0.0)):
        raise InputError(f"--for {for_}: write a time like 30m, 2h or 7d, and leave --back out")
    out = maintenance or for_ is not None
    way = SuppressAlarm.Request.OUT_OF_SERVICE if out else SuppressAlarm.Request.BY_DESIGN
    fields = {"suppressed": not back, "way": way, "duration": duration}
    _ask(valve, "suppress_alarm", alarm=alarm, who=who, comment=comment, **fields)


@app.command()
def reset(
    valve: cli.RunningValve, alarm: Name = "", who: cli.WhoOption = "", comment: cli.CommentOption = ""
) -> None:
    """Reset latched alarms that have cleared and are acknowledged.

    Example: ./spool alarm reset valve_1 stuck_spool
    """
    _ask(valve, "reset_alarms", alarm=alarm, who=who, comment=comment)


@app.command()
def history(
    valve: SomeValve = None,
    since: SinceAgo = None,
    search: Annotated[str, option("Words that an entry must hold: text, number, person, alarm.")] = "",
    csv: Annotated[Path | None, option("Write CSV; - for standard output.")] = None,
    state_folder: cli.StateFolder = None,
    language: LanguageOption = "",
    _force: cli.Force = False,
) -> None:
    """Show the journal of alarm events and operator actions.

    Example: ./spool alarm history valve_1 --since 7d --search "resonance"
    """
    from spool_tools.operations.alarm_journal import show_history  # noqa: PLC0415 - slow to load

    show_history(valve, state_folder, since, search, csv, language)


@app.command()
def statistics(
    valve: SomeValve = None,
    since: SinceAgo = None,
    limit: Annotated[
        list[str] | None, option("Limit of the site, e.g. per_day=300; repeatable; default: ISA-18.2.")
    ] = None,
    state_folder: cli.StateFolder = None,
    json: cli.JsonFile = None,
    _force: cli.Force = False,
) -> None:
    """Show the ISA-18.2 alarm statistics; exit 1 if a figure exceeds its limit.

    Example: ./spool alarm statistics --since 30d
    """
    from spool_tools.operations.alarm_journal import show_statistics  # noqa: PLC0415 - slow to load

    raise typer.Exit(show_statistics(valve, state_folder, since, limit or [], json))


def _ask(valve: str, service: str, **fields: Any) -> None:
    from spool_tools.operations.service_client import ask  # noqa: PLC0415 - slow to load

    ask(valve, service, **fields)


COMMAND = cli.Command(
    app,
    place=210,
    line="an operator's part: acknowledge, shelve, reset",
    live=True,
    offline=("history", "statistics"),
)
