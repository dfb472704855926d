"""Rows of the terminal view: what is shown of a valve and of an alarm, as text without markup."""

from __future__ import annotations

from datetime import datetime

from rich.text import Text
from spool_core.uncertainty import with_interval
from spool_monitor.alarms.alarm import AlarmState
from spool_msgs.msg import Alarm, Quantity

from .condition import SEVERITIES, shown_condition
from .heard import HeardValve

VALVE_COLUMNS = ("valve", "health", "shakes at", "natural", "stiffness", "viscous", "Coulomb", "says")
ALARM_COLUMNS = ("alarm", "state", "severity", "since", "by", "says")
#: States in which an alarm waits for an operator.
WAITING = (
    AlarmState.UNACKNOWLEDGED,
    AlarmState.RETURNED_UNACKNOWLEDGED,
    AlarmState.LATCHED_UNACKNOWLEDGED,
)


def valve_row(valve: HeardValve, now: float) -> tuple[Text, ...]:
    """Return the cells of ``VALVE_COLUMNS`` for ``valve`` at ``now`` (s, monotonic)."""
    condition = shown_condition(valve, now)
    state = Text(f"{condition.mark} {condition.word}", style=condition.style)
    health, estimate = valve.health, valve.estimate
    values = {} if estimate is None else {one.name: one for one in estimate.parameters}
    shakes = None if health is None else health.dominant_frequency
    cells = (
        _frequency(shakes),
        _quantity(None if estimate is None else estimate.natural_frequency),
        _quantity(values.get("spring_stiffness")),
        _quantity(values.get("viscous_coefficient")),
        _quantity(values.get("coulomb_force")),
        "" if health is None else health.summary,
    )
    return (Text(valve.name), state, *(Text(cell) for cell in cells))


def alarm_row(alarm: Alarm) -> tuple[Text, ...]:
    """Return the cells of ``ALARM_COLUMNS`` for ``alarm``."""
    state = AlarmState(alarm.state)
    waits = state in WAITING
    cause = f" ({alarm.cause.replace('_', ' ')})" if alarm.cause else ""
    raised = datetime.fromtimestamp(alarm.raised_at.sec).strftime("%d %b %H:%M:%S")
    return (
        Text(f"{alarm.code} {alarm.name.replace('_', ' ')}{cause}"),
        Text(state.name.lower().replace("_", " "), style="bold red" if waits else ""),
        Text(SEVERITIES.get(alarm.severity, "")),
        Text(raised if alarm.raised_at.sec else ""),
        Text(alarm.acknowledged_by),
        Text(alarm.message),
    )


def shown_alarms(valve: HeardValve | None) -> list[Alarm]:
    """Return the alarms of ``valve`` that are not normal, those that wait first."""
    listed = [] if valve is None or valve.alarms is None else list(valve.alarms.alarms)
    return [one for one in listed if one.state not in (AlarmState.NORMAL, Alarm.STATE_UNKNOWN)]


def line_of(valve: HeardValve, now: float) -> str:
    """Return the row of ``valve`` as a line, for where there is no terminal."""
    return "  ".join(cell.plain for cell in valve_row(valve, now))


def _frequency(quantity: Quantity | None) -> str:
    known = quantity is not None and quantity.validity == Quantity.VALIDITY_VALID
    return f"{quantity.value:.1f} Hz" if known and quantity is not None else "no line"


def _quantity(quantity: Quantity | None) -> str:
    if quantity is None or quantity.validity == Quantity.VALIDITY_UNKNOWN:
        return "not known"
    held = " held" if quantity.validity == Quantity.VALIDITY_HELD else ""
    unit = quantity.unit.replace(" s", "\u00b7s")
    return f"{with_interval(quantity.value, quantity.standard_deviation, unit)}{held}"
