"""The real recorder process over DDS: what it hears is in the bag, byte for byte, however it ends."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Temperature
from spool_bag.reader import BagReader
from spool_core.block import Block
from spool_core.node import qos
from spool_core.node.messages import from_block
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate

from .conftest import Process, System

PERIOD = 0.0005
SIZE = 40
START = 1_700_000_000_000_000_000


def block(sequence: int) -> Block:
    """Return a block with distinct contents."""
    noise = np.random.default_rng(sequence).standard_normal((2, SIZE)).astype(np.float32)
    return Block(START + round(sequence * SIZE * PERIOD * 1e9), sequence, PERIOD, noise[0], noise[1])


class Source:
    """Publishes on the test's domain and remembers the CDR of what it published."""

    def __init__(self, system: System) -> None:
        self.system, self.node = system, system.node
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

    def until(self, met: Callable[[], bool]) -> None:
        self.system.until(met, "the recorder did its work")

    def listeners(self, topic: str) -> int:
        return self._publishers[topic].get_subscription_count()

    def heard(self, *topics: str) -> None:
        """Wait until somebody listens to each of ``topics``."""
        self.until(lambda: all(self.listeners(topic) > 0 for topic in topics))


@pytest.fixture(name="source")
def _source(system: System) -> Source:
    return Source(system)


@dataclass
class Recorder:
    """The recorder as a separate process."""

    process: Process
    bag: Path


@pytest.fixture(name="record")
def _record(system: System, tmp_path: Path) -> Callable[..., Recorder]:
    def start(**parameters: object) -> Recorder:
        bag = tmp_path / "bag"
        return Recorder(system.start("recorder", "", output=bag, **parameters), bag)

    return start


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
        source.system.watch(0.002)
    source.publish("/valve_1/oil_temperature", Temperature(temperature=41.5))
    source.until(lambda: all(written(recorder.bag, topic) == len(source.sent[topic]) for topic in wanted))
    source.until(lambda: written(recorder.bag, "/diagnostics") > 0)
    assert recorder.process.end(number) == 0

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
        source.system.watch(0.005)
    source.until(lambda: written(recorder.bag, topic) == 20 and written(recorder.bag, "/valve_2/events") == 1)
    assert recorder.process.end(signal.SIGTERM) == 0
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
    assert recorder.process.end(signal.SIGTERM) == 0


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
    assert recorder.process.end(signal.SIGINT) == 0
    assert "was removed while it was recorded: " in recorder.process.said
    assert "Traceback" not in recorder.process.said
