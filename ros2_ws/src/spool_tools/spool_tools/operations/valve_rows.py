"""Running valves, their alarms and events as rows and lines of a terminal."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime

from rich.console import Group
from rich.table import Table
from rich.text import Text
from spool_core.events.language import Language
from spool_core.events.sentences import details, headline
from spool_core.node.messages import from_event_message
from spool_core.uncertainty import LEGEND, with_interval
from spool_monitor import listener
from spool_monitor.shown import PUT_ASIDE, STATES, ShownValve, in_order, shown
from spool_msgs.msg import Alarm, HealthEvent, ModelEstimate, Quantity

SEVERITIES = {HealthEvent.SEVERITY_WARNING: "warning", HealthEvent.SEVERITY_ALARM: "ALARM"}

_LOOKS = {
    listener.ALARM: ("ALARM", "\u25b2", "bold red"),
    listener.NO_WORD: ("NO WORD", "\u00d7", "bold magenta"),
    listener.STALE: ("STALE", "\u00d7", "bold magenta"),
    listener.WARNING: ("WARNING", "\u25c6", "bold yellow"),
    PUT_ASIDE: ("PUT ASIDE", "\u25cb", "cyan"),
    listener.UNKNOWN: ("UNKNOWN", "?", "bold"),
    listener.LEARNING: ("LEARNING", "\u2026", "cyan"),
    listener.AT_REST: ("AT REST", "\u2013", "cyan"),
    listener.GOOD: ("OK", "\u25cf", "bold green"),
}


@dataclass(frozen=True, slots=True)
class Shown:
    """State as a terminal shows it."""

    word: str
    mark: str
    style: str


SHOWN = {name: Shown(*_LOOKS[name]) for name in STATES}

VALVE_COLUMNS = ("valve", "health", "shakes at", "natural", "stiffness", "viscous", "Coulomb", "says")
ALARM_COLUMNS = ("alarm", "state", "severity", "since", "by", "says")


def valve_row(valve: listener.HeardValve, found: ShownValve) -> tuple[Text, ...]:
    """Return the cells of ``VALVE_COLUMNS`` for ``valve``, of which ``found`` is shown."""
    condition = SHOWN[found.state]
    state = Text(f"{condition.mark} {condition.word}", style=condition.style)
    health = valve.health
    shakes = None if health is None else health.dominant_frequency
    cells = (
        f"{shakes.value:.1f} Hz" if shakes and shakes.validity == Quantity.VALIDITY_VALID else "no line",
        *estimate_cells(valve.estimate),
        "" if health is None else health.summary,
    )
    return (Text(valve.name), state, *(Text(cell) for cell in cells))


def estimate_cells(estimate: ModelEstimate | None) -> Iterator[str]:
    """Yield natural frequency, stiffness, viscous coefficient and Coulomb force with their intervals."""
    values = {} if estimate is None else {one.name: one for one in estimate.parameters}
    names = ("spring_stiffness", "viscous_coefficient", "coulomb_force")
    natural = None if estimate is None else estimate.natural_frequency
    for one in (natural, *map(values.get, names)):
        if one is None or one.validity == Quantity.VALIDITY_UNKNOWN:
            yield "not known"
            continue
        held = " held" if one.validity == Quantity.VALIDITY_HELD else ""
        unit = one.unit.replace(" s", "\u00b7s")
        yield f"{with_interval(one.value, one.standard_deviation, unit)}{held}"


def alarm_row(alarm: Alarm, language: Language) -> tuple[Text, ...]:
    """Return the cells of ``ALARM_COLUMNS`` for ``alarm``."""
    from spool_monitor.alarm import AlarmState  # noqa: PLC0415 - SciPy, which off a terminal nobody needs

    state = AlarmState(alarm.state)
    waits = state in listener.WAITING
    raised = datetime.fromtimestamp(alarm.raised_at.sec).strftime("%d %b %H:%M:%S")
    return (
        Text(f"{alarm.code} {alarm.name.replace('_', ' ')}"),
        Text(state.name.lower().replace("_", " "), style="bold red" if waits else ""),
        Text(SEVERITIES.get(alarm.severity, "")),
        Text(raised if alarm.raised_at.sec else ""),
        Text(alarm.hidden_by or alarm.acknowledged_by),
        Text(alarm_headline(alarm, language)),
    )


def alarm_headline(alarm: Alarm, language: Language) -> str:
    """Return the headline of the alarm's last event; empty before the first."""
    return headline(from_event_message(alarm.event), language) if alarm.message else ""


def alarm_details(alarm: Alarm, language: Language) -> list[str]:
    """Return the details of the alarm's last event, a line each."""
    return [str(one) for one in details(from_event_message(alarm.event), language)] if alarm.message else []


def event_line(event: HealthEvent, language: Language) -> str:
    """Return an event as one line: its severity where it was raised, and its headline."""
    raised = event.state == HealthEvent.STATE_RAISED
    said = headline(from_event_message(event), language)
    return f"{SEVERITIES.get(event.severity, 'event')}: {said}" if raised else said


def lines_of(valves: Mapping[str, listener.HeardValve]) -> list[str]:
    """Return the row of each valve as a line, for where there is no terminal."""
    now, unix_time = time.monotonic(), time.time()
    rows = (valve_row(valves[name], shown(valves[name], now, unix_time)) for name in sorted(valves))
    return ["  ".join(cell.plain for cell in row) for row in rows]


def picture(valves: Mapping[str, listener.HeardValve], language: Language, *above: str) -> Group:
    """Return lines ``above``, the valves, worst first, and below them their alarms in the same order."""
    now, unix_time = time.monotonic(), time.time()
    found = in_order(shown(one, now, unix_time) for one in valves.values())
    table, alarms = Table(*VALVE_COLUMNS), Table("valve", *ALARM_COLUMNS)
    for valve in found:
        table.add_row(*valve_row(valves[valve.name], valve))
        for alarm in valve.alarms:
            alarms.add_row(valve.name, *alarm_row(alarm, language))
    nobody = "no valve is heard yet: is a monitor running, with the same ROS_DOMAIN_ID?"
    return Group(*above, table, alarms, LEGEND if found else nobody)
