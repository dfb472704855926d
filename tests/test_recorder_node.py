"""Each parameter of the recorder's node changes what lies on the disk; each value that it reports is true."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Temperature
from spool_bag import recorder, recorder_node, recording
from spool_bag.metadata import ACCELERATION_BLOCK, custom_data
from spool_bag.reader import BagReader
from spool_bag.recorder_node import RecorderNode
from spool_bag.recording import LARGEST_QUEUE, Recording, RecordingState
from spool_bag.verification import make_keys, verify
from spool_bag.writer import BagWriter, PartLimits
from spool_core.block import Block
from spool_core.cdr import Command, encode_block
from spool_core.node.diagnostics import Level
from spool_core.node.messages import to_time
from spool_msgs.msg import AccelerationBlock, AccelerationBlocks, HealthEvent, ValveHealth
from std_msgs.msg import Float64

from .clocked import START, Clocked, Domains, clocked

SECOND = 1_000_000_000
KINDS = {
    "acceleration": AccelerationBlock, "events": HealthEvent, "oil_temperature": Temperature,
    "health": ValveHealth,
}  # fmt: skip


def block(sequence: int, samples: int = 40) -> bytes:
    """Return a block of a second of noise."""
    noise = np.random.default_rng(sequence).standard_normal((2, samples)).astype(np.float32)
    made = Block(START + sequence * SECOND, sequence, 1.0 / samples, noise[0], noise[1])
    return bytes(encode_block(made, "valve"))


def alarm(second: int) -> HealthEvent:
    found = HealthEvent(kind="resonance", code=100, state=1, severity=HealthEvent.SEVERITY_ALARM)
    found.header.stamp = to_time(START + second * SECOND)
    return found


class Live:
    """Recorder that runs, and the topics of two valves; ``taken``: how much it took, by topic."""

    def __init__(self, nodes: Clocked, taken: Counter[str]) -> None:
        self.nodes, self.taken = nodes, taken
        self.publish = {
            f"/{valve}/{name}": nodes.offer(kind, f"/{valve}/{name}", latched=name in ("events", "health"))
            for valve in ("valve_1", "valve_2")
            for name, kind in KINDS.items()
        }

    def send(self, topic: str, second: float, *messages: Any) -> None:
        """Let the recorder receive ``messages`` at that second."""
        self.nodes.now = START + round(second * SECOND)
        self.nodes.turn()
        wanted = self.taken[topic] + len(messages)
        for one in messages:
            self.publish[topic](one)
        self.nodes.until(lambda: self.taken[topic] >= wanted, f"{topic} is heard")

    def until(self, met: Callable[[], Any], what: str) -> None:
        self.nodes.until(met, what)

    def says(self, level: Level, task: str = "recording") -> bool:
        return bool(self.nodes.status(task).level == level.value)


Record: TypeAlias = Callable[..., AbstractContextManager[Live]]


@pytest.fixture(scope="module", name="record")
def _record(claim_domain: Domains) -> Iterator[Record]:
    """Return what starts a recorder, whose thinning and reports do not wait for their periods."""
    taken, put, look = Counter[str](), Recording.put, recording.Thinning.look

    @contextlib.contextmanager
    def record(output: Path, **parameters: Any) -> Iterator[Live]:
        taken.clear()
        with clocked(claim_domain, "recorders") as nodes:
            live = Live(nodes, taken)
            nodes.start(RecorderNode, output=str(output), **parameters)
            yield live

    def puts(self: Recording, message: Any) -> None:
        put(self, message)
        taken[message.topic] += 1

    def looks(self: recording.Thinning, writer: BagWriter) -> None:
        look(self, writer)
        taken["looks"] += 1

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Recording, "put", puts)
        patch.setattr(recording.Thinning, "look", looks)
        patch.setattr(recording, "THINNING_LOOK", 0.0)
        patch.setattr(recording, "LOOK", 0.02)
        patch.setattr(recorder_node, "DIAGNOSTICS_PERIOD", 0.05)
        yield record


def in_parts(record: Record, folder: Path) -> dict[str, Any]:
    """Return what parameters made of a minute of one valve, with a snapshot."""
    private, public = make_keys(folder)
    (folder / "press").mkdir()
    bag = folder / "press_1"
    third, last = (bag / f"press_1_{number}.mcap" for number in (2, 5))
    with record(
        folder / "press", number_output=True, valves=["valve_1"], machine="press 7", depth=10,
        signing_key=str(private), max_part_duration=10.0, thin_after=25.0 / 86400.0,
        snapshot_folder=str(folder / "around"), snapshot_before=3.0, snapshot_after=2.0,
    ) as one:  # fmt: skip
        for second in range(60):
            one.send("/valve_1/acceleration", second, block(second))
            one.publish["/valve_2/acceleration"](block(second))
            if second == 30:
                one.send("/valve_1/events", 30.1, alarm(30))
        for celsius in range(60):
            one.publish["/valve_1/oil_temperature"](Temperature(temperature=float(celsius)))
        one.until(lambda: one.taken["/valve_1/oil_temperature"], "the temperature")
        one.until(lambda: last.exists() and not BagReader(third).valves, "the third part is thinned")
        looks = one.taken["looks"]
        one.until(lambda: one.taken["looks"] > looks + 10, "more parts would be thinned")
    reader, verified = BagReader(bag), verify(bag, public)
    (kept,) = (folder / "around").iterdir()
    stamps = [round((each.stamp - START) / SECOND) for each in BagReader(kept).blocks("valve_1")]
    parts = [BagReader(path) for path in sorted(bag.glob("*.mcap"))]
    lengths = [len(list(part.blocks("valve_1"))) if part.valves else 0 for part in parts]
    return {
        "output": bag.is_dir(),
        "number_output": {path.name for path in folder.glob("press*")},
        "valves": {topic.split("/")[1] for topic in reader.topics if topic.startswith("/valve")},
        "machine": custom_data(bag).get("machine"),
        "depth": len(list(reader.records("/valve_1/oil_temperature"))),
        "signing_key": (verified.signed, verified.wrong),
        "max_part_duration": lengths[3:],
        "thin_after": lengths[:4],
        "snapshot_folder": kept.name.partition("_2023")[0],
        "snapshot_before": stamps[0],
        "snapshot_after": stamps[-1],
    }


@pytest.fixture(scope="module", name="seen")
def _seen(record: Record, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what each parameter made of recordings, by name."""
    folder = tmp_path_factory.mktemp("recorder")
    found = in_parts(record, folder)
    with record(folder / "large", max_part_size=1_000_000, max_total_size=4_000_000) as two:
        for second in range(16):
            two.send("/valve_1/acceleration", second, block(second, 60_000))
    sizes = [path.stat().st_size for path in (folder / "large").glob("*.mcap")]
    found |= {"max_part_size": max(sizes), "max_total_size": sum(sizes)}

    with BagWriter(folder / "earlier", limits=PartLimits()) as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for second in range(-9, -5):
            writer.write(channel, START + second * SECOND, block(second + 9))

    def names() -> list[str]:
        return [path.name[-7:-1] for path in (folder / "snapshots").glob("valve*")]

    around = {"snapshot_before": 2.0, "snapshot_after": 1.0, "snapshot_max_total_size": 20_000}
    with record(folder / "earlier", resume=True, **around) as three:
        for second in range(16):
            three.send("/valve_1/acceleration", second, block(second, 500))
            if second in (3, 8, 13):
                three.send("/valve_1/events", second + 0.1, alarm(second))
            if second in (5, 10):
                wanted = [f"2213{second + 18}"]
                three.until(lambda wanted=wanted: names() == wanted, "the snapshot")
            if second == 10:
                three.nodes.nodes[0].set_parameters([Parameter("snapshot_limit", value=0)])
    found |= {
        "resume": len(list(BagReader(folder / "earlier").blocks("valve_1"))),
        "snapshot_max_total_size": len(names()),
        "snapshot_limit": names(),
    }
    with record(folder / "full", minimum_free_space=10**17) as four:
        four.until(lambda: four.says(Level.ERROR), "the recording pauses")
        four.send("/valve_1/acceleration", 0, block(0))
    return found | {"minimum_free_space": set(BagReader(folder / "full").valves)}


@pytest.mark.parametrize(("valves", "kept"), [([""], {"valve_1", "valve_2"}), (["valve_2"], {"valve_2"})])
def test_blocks_of_many_valves_are_kept_as_those_of_each(
    record: Record, tmp_path: Path, valves: list[str], kept: set[str]
) -> None:
    """A bag has them as its readers know them; what cannot be a valve is left out, and the rest is kept."""
    names = ["valve_1", "1 press", "/valve_2"]
    blocks = [deserialize_message(block(number), AccelerationBlock) for number in (3, 5, 8)]
    with record(tmp_path / "bag", valves=valves) as one:
        publish = one.nodes.offer(AccelerationBlocks, "/accelerations")
        publish(AccelerationBlocks(names=names, blocks=blocks[:1]))
        publish(AccelerationBlocks(names=names, blocks=blocks))
        one.until(lambda: one.taken["/valve_2/acceleration"], "the blocks are taken")
    reader = BagReader(tmp_path / "bag")
    assert set(reader.valves) == kept
    sent = {"valve_1": block(3), "valve_2": block(8)}
    assert {name: [encode_block(one, "valve") for one in reader.blocks(name)] for name in kept} == {
        name: [sent[name]] for name in kept
    }


def test_the_command_of_a_solenoid_is_kept_with_the_blocks_of_its_valve(
    record: Record, tmp_path: Path
) -> None:
    with record(tmp_path / "bag") as one:
        one.send("/valve_1/acceleration", 0, block(0))
        one.publish["/valve_1/command"] = one.nodes.offer(Float64, "/valve_1/command")
        for second, value in ((0.2, 1.5), (0.7, 0.0)):
            one.send("/valve_1/command", second, Float64(data=value))
    found = [each for each in BagReader(tmp_path / "bag").stream("valve_1") if isinstance(each, Command)]
    assert [(round((each.stamp - START) / SECOND, 1), each.value) for each in found] == [
        (0.2, 1.5),
        (0.7, 0.0),
    ]


#: Result by parameter: each differs from what its default leaves.
EFFECTS: dict[str, Any] = {
    "output": True, "number_output": {"press", "press_1"}, "valves": {"valve_1"}, "machine": "press 7",
    "depth": 10, "signing_key": (6, []), "max_part_duration": [10, 10, 10], "thin_after": [0, 0, 0, 10],
    "snapshot_folder": "valve_1_resonance", "snapshot_before": 28, "snapshot_after": 32,
    "max_part_size": pytest.approx(1e6, abs=5e5), "max_total_size": pytest.approx(3e6, abs=1e6),
    "resume": 4 + 16, "snapshot_max_total_size": 1, "snapshot_limit": ["221328"], "minimum_free_space": set(),
}  # fmt: skip


@pytest.mark.parametrize("name", [one.name for one in RecorderNode.PARAMETERS])
def test_a_parameter_changes_what_lies_on_the_disk(name: str, seen: dict[str, Any]) -> None:
    assert seen[name] == EFFECTS[name]


GOOD = RecordingState("", 11, 22, 33, 44, 55, 66, 77, 88, 10**9)


@pytest.fixture(scope="module", name="told")
def _told(record: Record, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """Return a recorder that lost blocks of two valves, with a snapshot of one."""
    output = tmp_path_factory.mktemp("told") / "bag"
    with record(output, valves=["valve_1", "valve_2"], snapshot_after=0.0) as one:
        for sequence in (1, 2, 5, 6):
            one.send("/valve_1/acceleration", sequence, block(sequence))
        one.send("/valve_1/events", 6.1, alarm(6))
        one.send("/valve_2/acceleration", 7, block(7), block(13))
        kept = "1"
        one.until(lambda: one.nodes.numbers("recording").get("snapshots") == kept, "the snapshot")
        assert one.says(Level.WARNING)
        yield one


@pytest.mark.parametrize(
    ("state", "level"),
    [
        (GOOD, Level.OK),
        (replace(GOOD, paused="the disk is gone"), Level.ERROR),
        (replace(GOOD, free=399_999_999), Level.WARNING),
        (replace(GOOD, free=400_000_001), Level.OK),
        (replace(GOOD, waiting=LARGEST_QUEUE // 2 + 1), Level.WARNING),
    ],
)
def test_the_report_has_every_number_of_the_recording_under_its_name(
    told: Live, state: RecordingState, level: Level, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recording, "state", state)
    monkeypatch.setattr(recorder_node, "RECENT", 0.0)
    numbers = {
        "free_space_B": state.free, "messages": 11, "recorded_B": 22, "messages_not_recorded": 33,
        "waiting_B": state.waiting, "parts": 66, "total_size_B": 77, "parts_removed": 88, "snapshots": 1,
        "blocks_lost_valve_1": 2, "blocks_lost_valve_2": 5,
    }  # fmt: skip
    expected = {name: str(number) for name, number in numbers.items()}
    told.until(lambda: (told.nodes.numbers("recording"), told.says(level)) == (expected, True), str(expected))


def test_the_report_names_valves_whose_monitor_is_silent_or_was_never_heard(
    told: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    told.send("/valve_1/health", 8, ValveHealth())
    told.send("/valve_2/acceleration", 8, block(14))
    monkeypatch.setattr(recorder, "SILENT", 0.0)
    monkeypatch.setattr(recorder, "FLOWS", 1e9)
    states = {"state_valve_1": recorder.Monitored.NO.value, "state_valve_2": recorder.Monitored.NOT_YET.value}
    told.until(lambda: told.nodes.numbers("monitoring") == states, str(states))
    assert told.says(Level.ERROR, "monitoring")
