"""Events go through their message with every field; those of earlier versions are read too."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

from rclpy.serialization import deserialize_message, serialize_message
from spool_core.events.event import EventState, Facts, Urgency
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import headline
from spool_core.node.messages import from_event_message, to_event_message, to_time
from spool_msgs.msg import HealthEvent

from .test_event_sentences import FACTS, STAMP, event


def test_an_event_comes_back_with_every_field() -> None:
    sent = event()
    message = to_event_message(sent, "valve_1", LANGUAGES["pl"])
    received = deserialize_message(serialize_message(message), HealthEvent)
    assert from_event_message(received) == sent
    assert received.header.frame_id == "valve_1"
    assert received.message == headline(sent, LANGUAGES["pl"])


def test_unknown_stays_unknown() -> None:
    message = to_event_message(event(Facts("silence", "s", 2.0, limit=1.5)), "valve_1", LANGUAGES["en"])
    received = from_event_message(deserialize_message(serialize_message(message), HealthEvent)).facts
    assert math.isnan(received.baseline)
    assert (received.began, received.causes, received.advice) == (0, (), 0)
    assert received.urgency is Urgency.UNKNOWN


def test_an_urgency_of_a_later_version_counts_as_unknown() -> None:
    message = to_event_message(event(), "valve_1", LANGUAGES["en"])
    message.urgency = 77
    assert from_event_message(message) == event(replace(FACTS, urgency=Urgency.UNKNOWN))


def test_a_message_of_an_earlier_version_keeps_its_sentence() -> None:
    whole = to_event_message(event(), "valve_1", LANGUAGES["en"])
    old = SimpleNamespace(
        header=SimpleNamespace(stamp=to_time(STAMP)),
        **{name: getattr(whole, name) for name in ("kind", "cause", "state", "severity", "quantity")},
        message="Coulomb force rose by 0.250 N to 0.350 ± 0.011 N; began about 6.0 s ago",
    )
    found = from_event_message(old)
    assert (found.kind, found.state, found.stamp) == ("friction_drift", EventState.RAISED, STAMP)
    assert headline(found) == "Coulomb force rose by 0.250 N to 0.350 ± 0.011 N"
