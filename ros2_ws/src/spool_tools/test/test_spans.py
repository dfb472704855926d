"""`--since`, `--until` and `--around` on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter, PartLimits
from spool_core.block import Block
from spool_core.cdr import encode_block
from spool_core.errors import InputError
from spool_core.events.event import Event, EventState, Facts, Severity
from spool_core.events.sentences import language_of
from spool_core.node.messages import to_event_message
from spool_core.uncertainty import Quantity, Validity
from spool_report.records.record_sources import span_of
from spool_report.requests import TimeSpan
from spool_tools.cli import main

BAG = Path(__file__).parents[4] / "bags" / "practice_01"


def test_times_count_from_the_records_end_or_are_times(capsys: pytest.CaptureFixture[str]) -> None:
    received = BagReader(BAG).received
    assert received is not None
    _, end = received
    assert span_of(BAG, TimeSpan("10s", "4s")).since == end - 10_000_000_000
    assert span_of(BAG, TimeSpan("10s", "4s")).until == end - 4_000_000_000
    assert span_of(BAG, TimeSpan("2025-01-01T00:00:05")).since == 1_735_689_605_000_000_000
    assert main(["info", str(BAG), "--since", "10s", "--until", "4s"]) == 0
    assert "6.0 s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("since", "until", "around", "message"),
    [
        ("soon", None, None, "write it like 30s, 10m, 6h or 7d"),
        ("4s", "10s", None, "nothing lies between them"),
        (None, None, "resonance", "0 alarms of kind 'resonance' in it; it has: none"),
        (None, None, "resonance:x", "write it like resonance, or resonance:2"),
        ("4s", None, "resonance", "leave --since and --until out"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    since: str | None, until: str | None, around: str | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        span_of(BAG, TimeSpan(since, until, around))


def test_around_an_alarm_are_the_minutes_before_and_after_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Twenty minutes in parts of one, with an alarm in minute 5 and another in minute 12."""
    start, second, kind = 1_700_000_000_000_000_000, 1_000_000_000, "spool_msgs/msg/HealthEvent"

    def alarm(at: int) -> bytes:
        quantity = Quantity("amplification", "1", 4.0, 0.1, Validity.VALID)
        event = Event(
            at, "resonance", EventState.RAISED, Severity.ALARM, "", quantity, code=100,
            facts=Facts.of(quantity, 3.0),
        )  # fmt: skip
        return serialize_message(to_event_message(event, "valve_1", language_of("en")))

    samples = np.zeros(2000, np.float32)
    with BagWriter(tmp_path / "bag", limits=PartLimits(duration=60.0), flush_interval=1e9) as writer:
        blocks = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        events = writer.add_topic("/valve_1/events", kind)
        for number in range(1200):
            at = start + number * second
            writer.write(blocks, at, encode_block(Block(at, number, 0.0005, samples, samples), "valve_1"))
            if number in (300, 720):
                writer.write(events, at + 1, alarm(at), at)
    minute = 60 * second
    for which, begin in (("resonance", 720), ("resonance:2", 300)):
        span = span_of(tmp_path / "bag", TimeSpan(around=which))
        at = start + begin * second
        assert span.since <= at - minute
        assert at + minute <= span.until <= at + 5 * minute
        assert len(BagReader(tmp_path / "bag", span=span).files) < 10
    assert main(["info", str(tmp_path / "bag"), "--around", "resonance"]) == 0
    assert "/valve_1/events" in capsys.readouterr().out
