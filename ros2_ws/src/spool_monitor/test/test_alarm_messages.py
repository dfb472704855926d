from __future__ import annotations

from enum import IntEnum

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import headline
from spool_core.node.messages import from_event_message
from spool_core.uncertainty import Quantity
from spool_monitor.alarm import AlarmState, Operator
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.event import Event, EventState, Facts, Namur, Severity
from spool_monitor.monitor_node import alarm_status, to_alarm_list
from spool_msgs.msg import Alarm, AlarmList, ValveHealth

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("enumeration", "message", "prefix"), [(AlarmState, Alarm, "STATE_"), (Namur, ValveHealth, "NAMUR_")]
)
def test_numbers_are_those_of_the_message(enumeration: type[IntEnum], message: type, prefix: str) -> None:
    found = {
        name.removeprefix(prefix): getattr(message, name)
        for name in dir(type(message))
        if name.startswith(prefix)
    }
    assert found == {member.name: int(member) for member in enumeration}


def test_alarms_go_through_their_message_in_their_order() -> None:
    book = AlarmStore()
    for number, kind in enumerate(("resonance", "friction_drift"), 1):
        quantity = Quantity("change", "N", 0.25)
        source = "coulomb_force" if kind == "friction_drift" else ""
        event = Event(
            number * SECOND,
            kind,
            EventState.RAISED,
            Severity.ALARM,
            "wear" if source else "",
            quantity,
            source,
            facts=Facts("coulomb_force", "N", 0.35, baseline=0.1, change=0.25, limit=0.2),
        )
        book.update(event)
    book.acknowledge("resonance", Operator("Eva", 9 * SECOND + 5, "seen"))
    book.shelve("friction_drift", Operator("Eva", 9 * SECOND), 60.0)
    sent = to_alarm_list(book.shown, 10 * SECOND, "4weh10_soft", LANGUAGES["de"])
    message = deserialize_message(serialize_message(sent), AlarmList)
    assert (message.header.frame_id, message.header.stamp.sec) == ("4weh10_soft", 10)
    first, second = message.alarms
    assert (first.name, first.state, first.code) == ("resonance", Alarm.STATE_ACKNOWLEDGED, 100)
    assert (first.acknowledged_by, first.comment, first.acknowledged_at.sec) == ("Eva", "seen", 9)
    assert first.namur == ValveHealth.NAMUR_OUT_OF_SPECIFICATION
    assert (second.name, second.cause, second.code) == ("friction_drift/coulomb_force", "wear", 201)
    assert (second.state, second.underlying) == (Alarm.STATE_SHELVED, Alarm.STATE_UNACKNOWLEDGED)
    assert (second.shelved_until.sec, second.raised_at.sec, second.occurrence) == (69, 2, 1)
    assert (second.value, second.unit, second.severity) == (0.25, "N", Severity.ALARM)
    assert first.header.stamp.nanosec == 5
    assert second.event.limit == 0.2
    said = headline(from_event_message(second.event), LANGUAGES["de"])
    assert second.message == second.event.message == said


def test_a_fault_code_is_one_alarm_s_whatever_its_cause() -> None:
    codes = []
    for namespace in ("/valve_1", "/press/left"):
        for cause in ("wear", "oil_contamination"):
            store = AlarmStore()
            quantity = Quantity("change", "N", 0.25)
            store.update(Event(SECOND, "friction_drift", EventState.RAISED, Severity.ALARM, cause, quantity))
            codes.append(alarm_status(store.alarms["friction_drift"], namespace).values["fault_code"])
    assert codes == ["valve_1.friction_drift"] * 2 + ["press.left.friction_drift"] * 2
