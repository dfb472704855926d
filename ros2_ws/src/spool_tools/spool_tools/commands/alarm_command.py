"""`./spool alarm`: the alarms of a running valve, and what an operator does about them."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from spool_tools.command import Command, CommentOption, LanguageOption, RunningValve, WhoOption, in_range

app = typer.Typer(
    no_args_is_help=True,
    help="Show the alarms of a running valve, and say what is done about them.\n\n"
    "Example: ./spool alarm list valve_1",
)

Name = Annotated[
    str,
    typer.Argument(
        metavar="[ALARM]", help="Alarm name or kind; default: every alarm that the action applies to."
    ),
]
Back = Annotated[bool, typer.Option("--back", help="Undo.")]


@app.command("list")
def list_(
    valve: RunningValve,
    every: Annotated[bool, typer.Option("--all", help="Include alarms in the normal state.")] = False,
    details: Annotated[bool, typer.Option("--details", help="Show everything known of each alarm.")] = False,
    language: LanguageOption = "",
) -> None:
    """List the alarms of a running valve; exit 1 where one waits for an operator.

    Example: ./spool alarm list valve_1

    Example: ./spool alarm list valve_1 --details --language de
    """
    from spool_tools.operations.service_client import show_alarms  # noqa: PLC0415 - slow to load

    raise typer.Exit(show_alarms(valve, every=every, details=details, language=language))


@app.command()
def acknowledge(
    valve: RunningValve, alarm: Name = "", who: WhoOption = "", comment: CommentOption = ""
) -> None:
    """Acknowledge an alarm.

    Example: ./spool alarm acknowledge valve_1 resonance --comment "speed reduced"
    """
    _ask(valve, "acknowledge_alarm", alarm=alarm, who=who, comment=comment)


@app.command()
def shelve(
    valve: RunningValve,
    alarm: Name = "",
    minutes: Annotated[
        float,
        typer.Option(
            help="How long, a week at most; 0: until the condition is over.", callback=in_range(0.0, 10080.0)
        ),
    ] = 30.0,
    back: Back = False,
    who: WhoOption = "",
    comment: CommentOption = "",
) -> None:
    """Shelve an alarm for a limited time.

    Example: ./spool alarm shelve valve_1 resonance --minutes 30
    """
    duration = 60.0 * minutes
    _ask(valve, "shelve_alarm", alarm=alarm, who=who, comment=comment, shelved=not back, duration=duration)


@app.command()
def suppress(
    valve: RunningValve,
    alarm: Name = "",
    maintenance: Annotated[bool, typer.Option("--maintenance", help="Take it out of service.")] = False,
    back: Back = False,
    who: WhoOption = "",
    comment: CommentOption = "",
) -> None:
    """Suppress an alarm that the plant's state makes meaningless, or for maintenance.

    Example: ./spool alarm suppress valve_1 --maintenance --comment "pump is changed"
    """
    from spool_msgs.srv import SuppressAlarm  # noqa: PLC0415 - slow to load

    way = SuppressAlarm.Request.OUT_OF_SERVICE if maintenance else SuppressAlarm.Request.BY_DESIGN
    _ask(valve, "suppress_alarm", alarm=alarm, who=who, comment=comment, suppressed=not back, way=way)


@app.command()
def reset(valve: RunningValve, alarm: Name = "", who: WhoOption = "", comment: CommentOption = "") -> None:
    """Reset latched alarms that have cleared and are acknowledged.

    Example: ./spool alarm reset valve_1 stuck_spool
    """
    _ask(valve, "reset_alarms", alarm=alarm, who=who, comment=comment)


def _ask(valve: str, service: str, **fields: Any) -> None:
    from spool_tools.operations.service_client import ask  # noqa: PLC0415 - slow to load

    ask(valve, service, **fields)


COMMAND = Command(app, place=160, line="an operator's part: acknowledge, shelve, reset", live=True)
