from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from spool_bag.information import describe
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.reader import BagReader
from spool_bag.recorder import Recorded
from spool_bag.snapshot import (
    HEALTH_EVENT,
    MOST_BYTES,
    MOST_WAITING,
    REQUESTED,
    Snapshot,
    SnapshotKeeper,
    SnapshotWriter,
)
from spool_bag.writer import BagWriter, PartLimits
from spool_core.block import Block
from spool_core.cdr import encode_block
from spool_core.events.event import Event, EventState, Severity
from spool_core.events.language import ENGLISH
from spool_core.node.messages import to_event_message
from spool_core.uncertainty import Quantity, Validity

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
SAMPLES = np.zeros(40, np.float32)
RAISED, CLEARED = 1, 2
WARNING, ALARM = 1, 2
VALVE = "/valve_1"


def block(number: int, valve: str = VALVE) -> Recorded:
    """Return the block that began ``number`` fiftieths of a second after the start."""
    stamp = START + number * SECOND // 50
    data = encode_block(Block(stamp, number, 0.0005, SAMPLES, SAMPLES), valve)
    return Recorded(f"{valve}/acceleration", ACCELERATION_BLOCK, stamp + 1_000_000, stamp, data)


def event(
    seconds: float, *, severity: int = ALARM, state: int = RAISED, valve: str = VALVE, received: float = 0.0
) -> Recorded:
    stamp = START + round(seconds * SECOND)
    quantity = Quantity("amplification", "1", 4.0, 0.1, Validity.VALID)
    found = Event(stamp, "resonance", EventState(state), Severity(severity), "", quantity, code=100)
    data = bytes(serialize_message(to_event_message(found, valve, ENGLISH)))
    at = START + round((received or seconds) * SECOND) + 2_000_000
    return Recorded(f"{valve}/events", HEALTH_EVENT, at, stamp, data)


def run(keeper: SnapshotKeeper, seconds: float, *others: Recorded) -> list[Snapshot]:
    """Feed blocks for so long, and ``others`` when they are received; return what became complete."""
    blocks = [block(number) for number in range(round(seconds * 50))]
    done: list[Snapshot] = []
    for message in sorted([*blocks, *others], key=lambda one: one.received):
        keeper.take(message)
        done += keeper.due(message.received)
    return done


def span(snapshot: Snapshot) -> tuple[float, float]:
    blocks = [one.published for one in snapshot.messages if one.kind == ACCELERATION_BLOCK]
    return (blocks[0] - START) / SECOND, (blocks[-1] - START) / SECOND


def test_an_alarm_keeps_the_time_before_and_after() -> None:
    (snapshot,) = run(SnapshotKeeper(3.0, 2.0), 20.0, event(10.0))
    first, last = span(snapshot)
    assert first == pytest.approx(7.0, abs=0.03)
    assert last == pytest.approx(12.0, abs=0.03)
    assert sum(one.kind == HEALTH_EVENT for one in snapshot.messages) == 1


@pytest.mark.parametrize("late", [1.0, 2.5])
def test_the_time_after_an_alarm_begins_when_the_alarm_is_heard(late: float) -> None:
    """The monitor judges windows: its event is stamped with their end and comes later."""
    (snapshot,) = run(SnapshotKeeper(3.0, 2.0), 20.0, event(10.0, received=10.0 + late))
    assert span(snapshot) == pytest.approx((7.0 + late, 12.0 + late), abs=0.03)


def test_warnings_and_ends_keep_nothing() -> None:
    others = [event(5.0, severity=WARNING), event(6.0, state=CLEARED)]
    assert run(SnapshotKeeper(3.0, 2.0), 20.0, *others) == []


def test_old_events_that_a_late_recorder_hears_keep_nothing() -> None:
    others = [event(-50.0, received=0.001), event(-50.0, received=10.0)]
    assert run(SnapshotKeeper(3.0, 2.0), 20.0, *others) == []


def test_a_valve_keeps_its_own_data_only() -> None:
    keeper = SnapshotKeeper(3.0, 2.0)
    other = [block(number, "/valve_10") for number in range(500)]
    (snapshot,) = run(keeper, 10.0, event(5.0), *other)
    assert {one.topic for one in snapshot.messages} == {"/valve_1/acceleration", "/valve_1/events"}


def test_two_alarms_each_keep_their_time() -> None:
    one, two = run(SnapshotKeeper(3.0, 2.0), 20.0, event(10.0), event(11.0))
    assert span(one)[1] == pytest.approx(12.0, abs=0.03)
    assert span(two)[1] == pytest.approx(13.0, abs=0.03)


def test_more_alarms_than_can_wait_are_counted() -> None:
    keeper = SnapshotKeeper(3.0, 2.0)
    alarms = [event(10.0 + 0.1 * number) for number in range(MOST_WAITING + 3)]
    assert len(run(keeper, 20.0, *alarms)) == MOST_WAITING
    assert keeper.refused == 3


def test_a_snapshot_that_is_asked_for_keeps_the_time_before_and_after() -> None:
    keeper = SnapshotKeeper(3.0, 2.0)
    assert keeper.ask(VALVE, START) == "no data of this valve is recorded"
    for number in range(500):
        keeper.take(block(number))
    now = START + 10 * SECOND
    assert keeper.ask(VALVE, now) == ""
    for number in range(500, 1000):
        keeper.take(block(number))
    (snapshot,) = keeper.due(now + 5 * SECOND)
    assert (snapshot.event, snapshot.valve) == (REQUESTED, VALVE)
    assert span(snapshot) == pytest.approx((7.0, 12.0), abs=0.05)


def test_no_more_snapshots_are_begun_than_can_wait() -> None:
    keeper = SnapshotKeeper(3.0, 2.0)
    keeper.take(block(0))
    assert [keeper.ask(VALVE, START) for _ in range(MOST_WAITING)] == [""] * MOST_WAITING
    assert keeper.ask(VALVE, START) == f"{MOST_WAITING} snapshots of this valve are in progress"


def test_memory_is_bounded_by_time_and_by_size() -> None:
    keeper = SnapshotKeeper(3.0, 2.0)
    run(keeper, 20.0)
    assert keeper.held == pytest.approx(150 * len(block(0).data), rel=0.03)
    large = bytes(MOST_BYTES // 3)
    for number in range(9):
        stamp = START + 20 * SECOND + number
        keeper.take(Recorded(f"{VALVE}/picture", "x/msg/Y", stamp, stamp, large))
        assert keeper.held <= MOST_BYTES


def test_a_clock_set_back_does_not_keep_a_snapshot_open() -> None:
    keeper = SnapshotKeeper(3.0, 60.0)
    assert run(keeper, 6.0, event(5.0)) == []
    assert len(keeper.due(START - 1000 * SECOND)) == 1


def test_what_is_no_event_is_left_alone() -> None:
    keeper = SnapshotKeeper(3.0, 2.0)
    good = event(5.0)
    broken = Recorded(good.topic, good.kind, good.received, good.published, good.data[:30])
    assert run(keeper, 10.0, broken) == []


@pytest.mark.parametrize(
    ("topic", "kind"), [("/valve_1/events_copy", HEALTH_EVENT), ("/valve_1/events", "other_msgs/msg/Alarm")]
)
def test_only_events_of_their_type_on_the_events_topic_begin_a_snapshot(topic: str, kind: str) -> None:
    alarm = event(5.0)
    other = Recorded(topic, kind, alarm.received, alarm.published, alarm.data)
    assert run(SnapshotKeeper(3.0, 2.0), 10.0, other) == []


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[SnapshotWriter]:
    made = SnapshotWriter(SnapshotKeeper(3.0, 2.0), tmp_path / "snapshots", logging.getLogger("test"))
    yield made
    made.close()


def test_it_is_a_bag_that_says_which_valve_it_was(writer: SnapshotWriter, tmp_path: Path) -> None:
    """What was latched before the ring began stands at the beginning of the bag."""
    description = event(0.5, state=CLEARED, received=0.5)  # latched too, and long out of the ring
    for message in sorted(
        [description, event(10.0), *(block(number) for number in range(1000))], key=lambda one: one.received
    ):
        writer.keeper.take(message)
        writer.watch(message.received, 100)
    writer.close()
    (path,) = (tmp_path / "snapshots").iterdir()
    assert path.name == "valve_1_resonance_20231114T221330Z"
    reader = BagReader(path)
    blocks = list(reader.blocks("valve_1"))
    assert (blocks[0].stamp - START) / SECOND == pytest.approx(7.0, abs=0.03)
    assert [one.sequence for one in blocks] == list(range(blocks[0].sequence, blocks[-1].sequence + 1))
    assert len(list(reader.messages("/valve_1/events"))) == 2
    information = describe(path)
    assert information.duration_s == pytest.approx(5.0, abs=0.1)
    assert writer.written == 1


def test_what_waits_is_written_when_the_recorder_ends(writer: SnapshotWriter, tmp_path: Path) -> None:
    for message in [*(block(number) for number in range(250)), event(4.9)]:
        writer.keeper.take(message)
    writer.close()
    (path,) = (tmp_path / "snapshots").iterdir()
    assert len(list(BagReader(path).blocks("valve_1"))) > 100


def test_of_more_than_allowed_the_oldest_go(
    writer: SnapshotWriter, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        for message in sorted(
            [*(block(number) for number in range(2000)), *(event(10.0 + 5 * number) for number in range(4))],
            key=lambda one: one.received,
        ):
            writer.keeper.take(message)
            writer.watch(message.received, 2)
        writer.close()
    kept = sorted(path.name[-7:] for path in (tmp_path / "snapshots").iterdir())
    assert kept == ["221340Z", "221345Z"]
    assert sum("is removed: snapshot_limit" in record.message for record in caplog.records) == 2


def test_what_is_no_snapshot_never_goes_for_one(writer: SnapshotWriter, tmp_path: Path) -> None:
    """A recording in parts, even one that is named like a snapshot, and any other folder."""
    folder = tmp_path / "snapshots"
    names = ["press_4", "valve_1_resonance_20200101T000000Z"]
    for name in names:
        recording = BagWriter(folder / name, limits=PartLimits())
        recording.write(recording.add_topic("/valve_1/text", "std_msgs/msg/String"), 1, b"\0\1\0\0\1\0\0\0\0")
        recording.close()
    (folder / "other_thing_20200101T000000Z").mkdir()
    for message in [*(block(number) for number in range(250)), event(4.9)]:
        writer.keeper.take(message)
    writer.watch(START + 100 * SECOND, 1)
    writer.close()
    assert {path.name for path in folder.iterdir()} > {*names, "other_thing_20200101T000000Z"}
    assert writer.written == 1


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    writer = SnapshotWriter(SnapshotKeeper(3.0, 2.0), tmp_path / "file", logging.getLogger("test"))
    for message in [*(block(number) for number in range(250)), event(4.9)]:
        writer.keeper.take(message)
    writer.close()
    assert writer.written == 0
    assert "snapshot of /valve_1 resonance" in caplog.text
