"""A message of an alarm in which no two values are alike."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time
from spool_core.events.event import Event, EventState, Facts, Severity, Urgency
from spool_core.events.language import ENGLISH
from spool_core.node.messages import to_event_message
from spool_core.uncertainty import Quantity, Validity
from spool_msgs.msg import Alarm, ValveHealth

#: s since 1970, of which each stamp of the alarm lies some seconds more.
EPOCH = 1_790_000_000


@pytest.fixture
def distinct_alarm() -> Alarm:
    """Return an acknowledged alarm on the shelf."""
    facts = Facts(
        "coulomb_force", "N", 0.71, 0.62, 0.83, 0.51, 0.20, 0.66, (EPOCH + 1) * 10**9, ("wear", "unknown"),
        (0.7, 0.25), 3.6e6, Urgency.SOON, 8.64e4, 201, "spool", "a remark",
    )  # fmt: skip
    judged = Quantity("coulomb_force", "N", 0.72, 0.05, Validity.VALID)
    event = Event(
        (EPOCH + 2) * 10**9, "friction_drift", EventState.RAISED, Severity.ALARM, "wear", judged,
        "coulomb_force", 205, facts,
    )  # fmt: skip
    one = Alarm(
        name="friction_drift/coulomb_force", kind="friction_drift", cause="wear", code=201,
        namur=ValveHealth.NAMUR_FAILURE, state=Alarm.STATE_SHELVED, underlying=Alarm.STATE_ACKNOWLEDGED,
        severity=1, occurrence=5, value=0.73, unit="N", event=to_event_message(event, "press 7", ENGLISH),
        raised_at=Time(sec=EPOCH + 3), acknowledged_at=Time(sec=EPOCH + 4), acknowledged_by="Eva",
        comment="wait for the part", shelved_until=Time(sec=EPOCH + 100_000_006),
    )  # fmt: skip
    one.header.stamp = Time(sec=EPOCH + 5, nanosec=250_000_000)
    one.message = one.event.message
    return one
