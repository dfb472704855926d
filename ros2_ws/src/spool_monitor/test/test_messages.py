from __future__ import annotations

import math
from array import array
from dataclasses import replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from spool_core.events.event import Event, EventState, Facts, Namur, Severity, Urgency
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import headline
from spool_core.node.managed_node import AUTOSTART
from spool_core.node.messages import nanoseconds
from spool_core.uncertainty import Quantity, Validity
from spool_monitor.alarm import AlarmState, Operator, shelve
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.detectors import Judgement
from spool_monitor.monitor import BaselineState, Health, HealthLevel, Monitor
from spool_monitor.monitor_node import MonitorNode, alarm_status, to_alarm_list, to_health_message
from spool_msgs.msg import Alarm, AlarmList, HealthEvent, ValveHealth


def constants(message: type, prefix: str) -> dict[str, int]:
    """Return the constants of ``message`` that begin with ``prefix``, without it."""
    names = [name for name in dir(type(message)) if name.startswith(prefix)]
    return {name.removeprefix(prefix): getattr(message, name) for name in names}


@pytest.mark.parametrize(
    ("enumeration", "message", "prefix"),
    [
        (HealthLevel, ValveHealth, "LEVEL_"),
        (BaselineState, ValveHealth, "BASELINE_"),
        (EventState, HealthEvent, "STATE_"),
        (Severity, HealthEvent, "SEVERITY_"),
        (Urgency, HealthEvent, "URGENCY_"),
        (AlarmState, Alarm, "STATE_"),
        (Namur, ValveHealth, "NAMUR_"),
    ],
)
def test_numbers_are_those_of_the_message(enumeration: type[IntEnum], message: type, prefix: str) -> None:
    found = constants(message, prefix)
    assert len(found) == len(enumeration)
    assert found == {member.name: int(member) for member in enumeration}


def content(message: Any) -> Any:
    """Return all fields of ``message``, stamps in ns."""
    if hasattr(message, "nanosec"):
        return nanoseconds(message)
    if hasattr(message, "get_fields_and_field_types"):
        return {name: content(getattr(message, name)) for name in message.get_fields_and_field_types()}
    return [content(one) for one in message] if isinstance(message, list | array) else message


def quantity(name: str, unit: str, value: float, deviation: float, validity: int) -> dict[str, Any]:
    return {
        "name": name, "unit": unit, "value": value, "standard_deviation": deviation, "validity": validity,
    }  # fmt: skip


#: Facts with no two alike, and the message of an event that has them.
FACTS = Facts(
    "coulomb_force", "N", 0.35, 0.31, 0.39, 0.12, 0.23, 0.2, 1_500_000_011, ("scale", "offset"), (0.7, 0.3),
    8.64e6, Urgency.IMMEDIATE, 7200.0, 202, "spool", "at_rest",
    (Quantity("speed", "rev/min", 857.0, 9.0, Validity.IMPLAUSIBLE),),
)  # fmt: skip
EVENT = {
    "header": {"stamp": 2_000_000_013, "frame_id": "4weh10_soft"},
    "kind": "sensor_fault", "cause": "scale", "state": 1, "severity": 2,
    "quantity": quantity("gain_change", "1", 0.27, 0.05, 2),
    "source": "sensor_scale", "code": 605,
    "parameter": "coulomb_force", "unit": "N", "value": 0.35, "low": 0.31, "high": 0.39, "baseline": 0.12,
    "change": 0.23, "limit": 0.2, "began": 1_500_000_011, "causes": ["scale", "offset"],
    "probabilities": [0.7, 0.3], "false_alarm_interval": 8.64e6, "urgency": 4, "time_to_limit": 7200.0,
    "advice": 202, "subject": "spool", "note": "at_rest",
    "evidence": [quantity("speed", "rev/min", 857.0, 9.0, 3)],
}  # fmt: skip


def test_each_field_of_an_alarm_has_its_own_value() -> None:
    """Raised six times, acknowledged, shelved: all at different times."""
    store, judged = AlarmStore(), Quantity("gain_change", "1", 0.27, 0.05, Validity.HELD)
    event = Event(
        2_000_000_013, "sensor_fault", EventState.RAISED, Severity.ALARM, "scale", judged, "sensor_scale",
        605, FACTS,
    )  # fmt: skip
    for number in range(-5, 1):
        for state in (EventState.CLEARED, EventState.RAISED):
            store.update(replace(event, state=state, stamp=event.stamp + number * 10**8))
    store.acknowledge("", Operator("Eva", 5_000_000_017, "seen"))
    store.operate("", shelve, Operator("Jan", 8_000_000_019, "cable"), 60.0)
    sent = to_alarm_list(store.shown, 10_000_000_023, "4weh10_soft", LANGUAGES["de"])
    text = headline(event, LANGUAGES["de"])
    assert text != headline(event)
    assert content(deserialize_message(serialize_message(sent), AlarmList)) == {
        "header": {"stamp": 10_000_000_023, "frame_id": "4weh10_soft"},
        "alarms": [
            {
                "header": {"stamp": 8_000_000_019, "frame_id": "4weh10_soft"},
                "name": "sensor_fault/sensor_scale", "kind": "sensor_fault", "cause": "scale", "code": 605,
                "namur": 5, "state": 7, "underlying": 3, "severity": 2, "occurrence": 6,
                "value": 0.27, "unit": "1", "message": text, "event": {**EVENT, "message": text},
                "raised_at": 2_000_000_013, "acknowledged_at": 5_000_000_017, "acknowledged_by": "Eva",
                "comment": "seen", "hidden_by": "Jan", "hidden_at": 8_000_000_019, "hidden_comment": "cable",
                "shelved_until": 68_000_000_019,
            }
        ],
    }  # fmt: skip


def test_each_field_of_health_has_its_own_value() -> None:
    names = ("dominant_frequency", "amplification", "natural_frequency", "viscous_drift", "coulomb_drift")
    numbers = {
        name: Quantity(name, f"unit {place}", 1.5 + place, 0.1 + 0.01 * place, Validity(place % 4))
        for place, name in enumerate(names)
    }
    health = Health(
        1_700_000_000_000_000_001, HealthLevel.ALARM, BaselineState.LEARNING, "resonance, wear",
        ("resonance", "friction_drift"),
        judgements=(("resonance", Judgement.JUDGED), ("friction_drift", Judgement.NOT_EXCITED)),
        namur=Namur.FAILURE, **numbers,
    )  # fmt: skip
    sent = to_health_message(health, "4weh10_soft")
    assert content(deserialize_message(serialize_message(sent), ValveHealth)) == {
        "header": {"stamp": 1_700_000_000_000_000_001, "frame_id": "4weh10_soft"},
        "level": 3, "baseline": 1, "summary": "resonance, wear", "active": ["resonance", "friction_drift"],
        "judgements": ["resonance: judged", "friction_drift: not enough excitation"], "namur": 5,
        **{
            name: quantity(name, f"unit {place}", 1.5 + place, 0.1 + 0.01 * place, place % 4)
            for place, name in enumerate(names)
        },
    }  # fmt: skip


def test_what_is_not_known_stays_so() -> None:
    message = to_health_message(Monitor().health, "valve")
    assert message.level == ValveHealth.LEVEL_UNKNOWN
    assert math.isnan(message.viscous_drift.value)
    assert message.viscous_drift.validity == Validity.UNKNOWN


def test_a_fault_code_is_one_alarm_s_whatever_its_cause() -> None:
    codes = []
    for namespace in ("/valve_1", "/press/left"):
        for cause in ("wear", "oil_contamination"):
            store = AlarmStore()
            quantity = Quantity("change", "N", 0.25)
            store.update(Event(10**9, "friction_drift", EventState.RAISED, Severity.ALARM, cause, quantity))
            codes.append(alarm_status(store.alarms["friction_drift"], namespace).values["fault_code"])
    assert codes == ["valve_1.friction_drift"] * 2 + ["press.left.friction_drift"] * 2


def test_the_readme_lists_the_parameters_with_default_and_unit() -> None:
    text = (Path(__file__).resolve().parent.parent / "README.md").read_text(encoding="utf-8")
    table = text.split("| parameter |")[1].split("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip().strip("`") for cell in line.split("|")[1:4]] for line in table]
    expected = [
        [one.name, str(one.default).lower() if isinstance(one.default, bool) else str(one.default), one.unit]
        for one in (*MonitorNode.PARAMETERS, AUTOSTART)
    ]
    assert sorted(rows) == sorted(expected)
