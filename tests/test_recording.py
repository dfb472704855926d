"""The real recorder process over DDS: what it hears is in the bag, byte for byte, however it ends."""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mcap.reader import make_reader
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Temperature
from spool_bag.reader import BagReader
from spool_bag.verification import recover, verify
from spool_core.block import Block
from spool_core.node import qos
from spool_core.node.messages import from_block
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, ValveDescription
from spool_tools.operations.node_processes import find_executable

from .forks import server

PERIOD = 0.0005
SIZE = 40
START = 1_700_000_000_000_000_000


def block(sequence: int, *, size: int = SIZE) -> Block:
    """Return a block with distinct contents."""
    noise = np.random.default_rng(sequence).standard_normal((2, size)).astype(np.float32)
    return Block(START + round(sequence * size * PERIOD * 1e9), sequence, PERIOD, noise[0], noise[1])


class Source:
    """Publishes on the test's domain and remembers the CDR of what it published."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("source", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.sent: dict[str, list[bytes]] = {}
        self._publishers: dict[str, object] = {}

    def offer(self, topic: str, kind: type, profile: object) -> object:
        publisher = self.node.create_publisher(kind, topic, profile)
        self._publishers[topic] = publisher
        self.sent[topic] = []
        return publisher

    def publish(self, topic: str, message: object) -> None:
        # The same message serialised twice differs in its padding, so the bytes themselves are sent.
        data = bytes(serialize_message(message))
        self._publishers[topic].publish(data)
        self.sent[topic].append(data)

    def until(self, met: Callable[[], bool], *, timeout: float = 180.0) -> None:
        end = time.monotonic() + timeout
        while not met():
            assert time.monotonic() < end, "waited in vain"
            self.executor.spin_once(timeout_sec=0.05)

    def listeners(self, topic: str) -> int:
        return self._publishers[topic].get_subscription_count()

    def heard(self, *topics: str) -> None:
        """Wait until somebody listens to each of ``topics``."""
        self.until(lambda: all(self.listeners(topic) > 0 for topic in topics))

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(name="source")
def _source(domain_id: int) -> Iterator[Source]:
    source = Source(domain_id)
    yield source
    source.close()


class Recorder:
    """The recorder as a separate process."""

    def __init__(self, domain: int, folder: Path, **parameters: object) -> None:
        self.bag = folder / "bag"
        self._log = folder / "recorder.log"
        given = {"output": self.bag, **parameters}.items()
        arguments = [part for name, value in given for part in ("-p", f"{name}:={value}")]
        with self._log.open("wb") as log:
            self.process = server().start(
                [str(find_executable("spool_bag", "recorder")), "--ros-args", *arguments],
                folder=folder,
                environment={**os.environ, "ROS_DOMAIN_ID": str(domain)},
                output=log,
            )

    @property
    def said(self) -> str:
        return self._log.read_text()

    def end(self, number: int) -> int:
        self.process.send_signal(number)
        return self.process.wait(timeout=180)


@pytest.fixture(name="record")
def _record(domain_id: int, tmp_path: Path) -> Iterator[Callable[..., Recorder]]:
    running: list[Recorder] = []

    def start(**parameters: object) -> Recorder:
        running.append(Recorder(domain_id, tmp_path, **parameters))
        return running[-1]

    yield start
    for recorder in running:
        recorder.end(signal.SIGKILL)


def stored(bag: Path, topic: str) -> list[bytes]:
    return [record.data for _, record in BagReader(bag).records(topic)]


def written(bag: Path, topic: str) -> int:
    """Return how many messages of ``topic`` are on the disk by now."""
    try:
        return len(stored(bag, topic))
    except ValueError:
        return 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_recording_is_complete(
    source: Source, record: Callable[..., Recorder], number: int
) -> None:
    for valve in ("valve_1", "valve_2"):
        source.offer(f"/{valve}/acceleration", AccelerationBlock, qos.samples_offered(50))
        source.offer(f"/{valve}/events", HealthEvent, qos.state(depth=10))
    source.offer("/valve_1/oil_temperature", Temperature, qos.samples_wanted())
    source.offer("/elsewhere/oil_temperature", Temperature, qos.samples_offered(1))
    for valve in ("valve_1", "valve_2"):
        event = HealthEvent(kind="resonance", message=f"of {valve}, before the recorder came")
        source.publish(f"/{valve}/events", event)
    recorder = record()
    wanted = [topic for topic in source.sent if not topic.startswith("/elsewhere")]
    source.heard(*wanted)
    for sequence in range(100):
        for offset, valve in enumerate(("valve_1", "valve_2")):
            sample = block(sequence + 1000 * offset)
            source.publish(f"/{valve}/acceleration", from_block(sample, valve))
        source.executor.spin_once(timeout_sec=0.002)
    source.publish("/valve_1/oil_temperature", Temperature(temperature=41.5))
    source.until(lambda: all(written(recorder.bag, topic) == len(source.sent[topic]) for topic in wanted))
    source.until(lambda: written(recorder.bag, "/diagnostics") > 0)
    assert recorder.end(number) == 0

    reader = BagReader(recorder.bag)
    assert reader.closed
    assert reader.warnings == []
    assert reader.valves == ["valve_1", "valve_2"]
    assert "/elsewhere/oil_temperature" not in reader.topics
    assert reader.topics["/diagnostics"].messages > 0
    for topic in wanted:
        got, sent = stored(recorder.bag, topic), source.sent[topic]
        assert len(got) == len(sent)
        for received, original in zip(got, sent, strict=True):
            # DDS carries whole words: up to three zeros follow what was sent.
            assert received[: len(original)] == original
            assert received[len(original) :] in (b"", b"\0", b"\0\0", b"\0\0\0")
    with AnyReader([recorder.bag]) as other:
        assert other.message_count == sum(topic.messages for topic in reader.topics.values())
        qos_of = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in other.connections}
        assert qos_of["/valve_1/events"] == "TRANSIENT_LOCAL"
        assert qos_of["/valve_1/acceleration"] == "VOLATILE"
    with (recorder.bag / "bag_0.mcap").open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(topic.messages for topic in reader.topics.values())


def test_no_block_is_lost_where_a_part_ends(source: Source, record: Callable[..., Recorder]) -> None:
    blocks, latched = "/valve_1/acceleration", "/valve_1/valve"
    source.offer(blocks, AccelerationBlock, qos.samples_offered(50))
    source.offer(latched, ValveDescription, qos.state())
    recorder = record(max_part_duration=1.0)
    source.heard(blocks)
    source.heard(latched)
    source.publish(latched, ValveDescription())
    sequence = 0

    def six_parts() -> bool:
        nonlocal sequence
        source.publish(blocks, from_block(block(sequence), "valve_1"))
        sequence += 1
        return len(list(recorder.bag.glob("*.mcap"))) == 6

    source.until(six_parts)
    assert recorder.end(signal.SIGINT) == 0
    assert [one.sequence for one in BagReader(recorder.bag).blocks("valve_1")] == list(range(sequence))
    assert len(stored(recorder.bag, latched)) == 1
    for number in range(5):
        part = recorder.bag / f"bag_{number}.mcap"
        reader = BagReader(part)
        assert reader.closed
        # The first part may end before the message is there; from the second on it is repeated.
        assert number == 0 or reader.topics[latched].messages == 1
        with AnyReader([part]) as other:
            assert other.message_count == sum(topic.messages for topic in reader.topics.values())
    assert verify(recorder.bag).wrong == []


def test_a_killed_recording_keeps_what_was_flushed(
    source: Source, record: Callable[..., Recorder], tmp_path: Path
) -> None:
    topic = "/valve_1/acceleration"
    source.offer(topic, AccelerationBlock, qos.samples_offered(50))
    recorder = record()
    source.heard(topic)

    def recorded() -> list[int]:
        reader = BagReader(recorder.bag)
        return [block.sequence for block in reader.blocks("valve_1")] if reader.valves else []

    for sequence in range(100):
        source.publish(topic, from_block(block(sequence), "valve_1"))
    # Far from a full chunk: it is closed by its age.
    source.until(lambda: len(recorded()) == 100)
    recorder.end(signal.SIGKILL)

    reader = BagReader(recorder.bag)
    assert not reader.closed
    assert any("not finished" in warning for warning in reader.warnings)
    assert recorded() == list(range(100))
    result = recover(recorder.bag, tmp_path / "repaired")
    assert result.messages[topic] == 100
    assert BagReader(tmp_path / "repaired").closed


def test_named_valves_are_heard_from_their_first_block(
    source: Source, record: Callable[..., Recorder]
) -> None:
    recorder = record(valves="[valve_2]")
    source.until(recorder.bag.exists)
    topic = "/valve_2/acceleration"
    # Best effort is less than the recorder asked for before anybody offered anything.
    source.offer(topic, AccelerationBlock, qos.samples_wanted())
    source.offer("/valve_1/acceleration", AccelerationBlock, qos.samples_offered(50))
    source.offer("/valve_2/events", HealthEvent, qos.state(depth=10))
    source.publish("/valve_2/events", HealthEvent(kind="resonance", message="before anybody was met"))
    source.heard(topic)
    for sequence in range(20):
        source.publish(topic, from_block(block(sequence), "valve_2"))
        source.publish("/valve_1/acceleration", from_block(block(sequence), "valve_1"))
        source.executor.spin_once(timeout_sec=0.005)
    source.until(lambda: written(recorder.bag, topic) == 20 and written(recorder.bag, "/valve_2/events") == 1)
    assert recorder.end(signal.SIGTERM) == 0
    assert BagReader(recorder.bag).valves == ["valve_2"]


def test_a_publisher_that_takes_the_place_of_another_is_heard_though_it_offers_less(
    source: Source, record: Callable[..., Recorder]
) -> None:
    topic = "/valve_1/acceleration"
    first = source.offer(topic, AccelerationBlock, qos.samples_offered(50))
    recorder = record()
    source.heard(topic)
    source.publish(topic, from_block(block(0), "valve_1"))
    source.until(lambda: written(recorder.bag, topic) == 1)
    # Between two looks of the recorder: it sees as many publishers as before.
    source.node.destroy_publisher(first)
    source.offer(topic, AccelerationBlock, qos.samples_wanted())
    source.heard(topic)
    source.publish(topic, from_block(block(1), "valve_1"))
    source.until(lambda: written(recorder.bag, topic) == 2)
    assert recorder.end(signal.SIGTERM) == 0


def test_inactive_means_silent_and_each_activation_has_its_bag(
    source: Source, record: Callable[..., Recorder]
) -> None:
    topic = "/valve_1/acceleration"
    source.offer(topic, AccelerationBlock, qos.samples_offered(50))
    recorder = record()
    source.heard(topic)
    client = source.node.create_client(ChangeState, "/recorder/change_state")
    source.until(client.service_is_ready)

    def change(transition: int) -> None:
        done = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        source.until(done.done)
        assert done.result().success

    source.publish(topic, from_block(block(0), "valve_1"))
    source.until(lambda: written(recorder.bag, topic) == 1)
    change(Transition.TRANSITION_DEACTIVATE)
    assert BagReader(recorder.bag).closed
    source.until(lambda: source.listeners(topic) == 0)
    source.publish(topic, from_block(block(1), "valve_1"))
    change(Transition.TRANSITION_ACTIVATE)
    source.heard(topic)
    source.publish(topic, from_block(block(2), "valve_1"))
    second = recorder.bag.with_name("bag_1")
    source.until(lambda: written(second, topic) == 1)
    assert recorder.end(signal.SIGINT) == 0
    assert [item.sequence for item in BagReader(recorder.bag).blocks("valve_1")] == [0]
    assert [item.sequence for item in BagReader(second).blocks("valve_1")] == [2]
    assert BagReader(second).closed


def test_an_existing_bag_is_refused(record: Callable[..., Recorder], tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    recorder = record()
    assert recorder.process.wait(timeout=180) == 2
    assert "exists already" in recorder.said
    assert "Traceback" not in recorder.said


def test_a_removed_recording_is_begun_anew_with_what_is_latched(
    source: Source, record: Callable[..., Recorder]
) -> None:
    blocks, latched = "/valve_1/acceleration", "/valve_1/estimate"
    source.offer(blocks, AccelerationBlock, qos.samples_offered(50))
    source.offer(latched, ModelEstimate, qos.state())
    recorder = record()
    source.heard(blocks, latched)
    source.publish(latched, ModelEstimate())
    source.publish(blocks, from_block(block(0), "valve_1"))
    source.until(lambda: written(recorder.bag, blocks) == 1)
    # At once, while the recorder writes into it.
    shutil.rmtree(recorder.bag.rename(recorder.bag.with_name("removed")))
    other = recorder.bag
    source.until(lambda: written(other, latched) == 1)
    source.heard(blocks)
    source.publish(blocks, from_block(block(1), "valve_1"))
    source.until(lambda: written(other, blocks) == 1)
    assert recorder.end(signal.SIGINT) == 0
    assert "was removed while it was recorded: " in recorder.said
    assert "Traceback" not in recorder.said
