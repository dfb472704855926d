"""A bag in which an earlier version recorded events stays readable."""

from __future__ import annotations

from pathlib import Path

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from spool_bag.information import describe
from spool_bag.reader import BagReader
from spool_core.events.event import EventState, Severity, Urgency
from spool_core.events.sentences import described, headline
from spool_core.node.messages import from_event_message

NAME = "spool_msgs/msg/HealthEvent"
#: `HealthEvent` before it had fields for parameter, limit, causes and the others.
EARLIER = """\
uint8 STATE_UNKNOWN = 0
uint8 STATE_RAISED = 1
uint8 STATE_CLEARED = 2
uint8 SEVERITY_UNKNOWN = 0
uint8 SEVERITY_WARNING = 1
uint8 SEVERITY_ALARM = 2
std_msgs/Header header
string kind
string cause
uint8 state
uint8 severity
Quantity quantity
string message
string source
uint16 code
"""
QUANTITY = """\
string name
string unit
float64 value
float64 standard_deviation
uint8 validity
"""
SENTENCE = (
    "Coulomb force rose by 0.250 N to 0.350 ± 0.011 N, baseline 0.100 ± 0.008 N (± 95 %); began about 6.0 s "
    "ago; most likely cause: oil contamination, share 0.87; what to do: take an oil sample"
)


def test_events_of_an_earlier_version_are_read_with_their_sentence(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(QUANTITY, "spool_msgs/msg/Quantity"))
    store.register(get_types_from_msg(EARLIER, NAME))
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000, nanosec=5)
    event = types[NAME](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="4weh10_soft"),
        kind="friction_drift", cause="oil_contamination", state=1, severity=2,
        quantity=types["spool_msgs/msg/Quantity"](
            name="coulomb_force_change", unit="N", value=0.25, standard_deviation=0.007, validity=1
        ),
        message=SENTENCE, source="", code=202,
    )  # fmt: skip
    bag = tmp_path / "earlier"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/valve_1/events", NAME, typestore=store)
        writer.write(connection, 1_700_000_000_000_000_005, store.serialize_cdr(event, NAME))
    assert [(one.name, one.messages) for one in describe(bag).topics] == [("/valve_1/events", 1)]
    (message,) = BagReader(bag).messages("/valve_1/events")
    found = from_event_message(message)
    assert (found.kind, found.cause, found.code) == ("friction_drift", "oil_contamination", 202)
    assert (found.state, found.severity) == (EventState.RAISED, Severity.ALARM)
    assert (found.quantity.value, found.facts.urgency) == (0.25, Urgency.UNKNOWN)
    assert headline(found) == SENTENCE.partition("; ")[0]
    assert SENTENCE in described(found)
