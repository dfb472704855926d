from __future__ import annotations

import math
from dataclasses import fields
from enum import IntEnum
from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from spool_core.events.event import EventState, Severity, Urgency
from spool_core.node.managed_node import AUTOSTART
from spool_core.uncertainty import Quantity, Validity
from spool_monitor.detectors import Judgement
from spool_monitor.monitor import BaselineState, Health, HealthLevel, Monitor
from spool_monitor.monitor_node import MonitorNode, to_health_message
from spool_msgs.msg import HealthEvent, ValveHealth


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
    ],
)
def test_numbers_are_those_of_the_message(enumeration: type[IntEnum], message: type, prefix: str) -> None:
    found = constants(message, prefix)
    assert len(found) == len(enumeration)
    assert found == {member.name: int(member) for member in enumeration}


def test_health_goes_through_its_message_with_every_field() -> None:
    quantities = {
        name: Quantity(name, "1", float(number), 0.1, Validity.VALID)
        for number, name in enumerate(
            ("dominant_frequency", "amplification", "natural_frequency", "viscous_drift", "coulomb_drift")
        )
    }
    health = Health(
        stamp=1_700_000_000_000_000_001,
        level=HealthLevel.WARNING,
        baseline=BaselineState.FROZEN,
        summary="resonance",
        active=("resonance", "friction_drift"),
        judgements=(("resonance", Judgement.JUDGED), ("friction_drift", Judgement.NOT_EXCITED)),
        **quantities,
    )
    message = deserialize_message(serialize_message(to_health_message(health, "valve")), ValveHealth)
    assert message.level == ValveHealth.LEVEL_WARNING
    assert message.baseline == ValveHealth.BASELINE_FROZEN
    assert (message.summary, list(message.active)) == ("resonance", ["resonance", "friction_drift"])
    assert list(message.judgements) == ["resonance: judged", "friction_drift: not enough excitation"]
    for name, quantity in quantities.items():
        assert getattr(message, name).value == quantity.value
        assert getattr(message, name).name == name
    assert set(ValveHealth.get_fields_and_field_types()) == {
        "header",
        *(field.name for field in fields(Health) if field.name != "stamp"),
    }


def test_what_is_not_known_stays_so() -> None:
    message = to_health_message(Monitor().health, "valve")
    assert message.level == ValveHealth.LEVEL_UNKNOWN
    assert math.isnan(message.viscous_drift.value)
    assert message.viscous_drift.validity == Validity.UNKNOWN


def test_the_readme_lists_the_parameters_with_default_and_unit() -> None:
    text = (Path(__file__).resolve().parent.parent / "README.md").read_text(encoding="utf-8")
    table = text.split("| parameter |")[1].split("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip().strip("`") for cell in line.split("|")[1:4]] for line in table]
    expected = [
        [one.name, str(one.default).lower() if isinstance(one.default, bool) else str(one.default), one.unit]
        for one in (*MonitorNode.PARAMETERS, AUTOSTART)
    ]
    assert sorted(rows) == sorted(expected)
