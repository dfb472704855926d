"""Recovery: a readable bag of a damaged or unfinished one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rosbags.rosbag2.metadata import parse_qos
from spool_core.block import Block
from spool_core.block_gate import BlockGate
from spool_core.errors import InputError
from spool_core.files import load_yaml
from spool_core.text import printable

from spool_bag.mcap_file import Damage
from spool_bag.mcap_record import Topic
from spool_bag.metadata import Definition
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """Result of a recovery: what was saved and what was not.

    ``messages`` counts by topic what the new bag holds, as read back from it. ``undecodable`` counts messages
    whose bytes do not fit their definition; they are left out. ``expected`` counts by topic what the old bag
    says it held, ``None`` where it says nothing (a killed recording). ``lost`` are the messages that the old
    bag held and the new one does not: by those counts, else by the index behind each damaged chunk, else, and
    then ``estimated`` is true, by the damaged places' sizes. ``missing`` counts the blocks that jumps in
    ``sequence`` show by valve, whether they were lost here or never arrived. ``damages`` are the old bag's,
    ``closed`` says whether its recording was finished.
    """

    source: Path
    target: Path
    messages: Mapping[str, int]
    undecodable: Mapping[str, int]
    expected: Mapping[str, int] | None
    lost: int
    estimated: bool
    missing: Mapping[str, int]
    damages: tuple[Damage, ...]
    warnings: tuple[str, ...]
    closed: bool


def recover(source: Path | str, target: Path | str) -> RecoveryResult:
    """Copy every readable message of the bag ``source`` into the new bag ``target`` and read that again.

    Raises:
        InputError: there is nothing to recover from, or ``target`` exists.
        RecordingError: ``target`` cannot be written on.
    """
    reader = BagReader(source, skip_damage=True)
    counted = all(file.counts is not None for file in reader.files)
    expected = {name: topic.messages for name, topic in reader.topics.items()} if counted else None
    undecodable: dict[str, int] = {}
    warnings = list(reader.warnings)
    with BagWriter(target, staged=True) as writer:
        channels: dict[tuple[str, str], int | None] = {}
        for topic, record in reader.records():
            key = (topic.name, topic.type)
            if key not in channels:
                channels[key] = _channel(writer, topic, warnings)
            channel = channels[key]
            if channel is None or not reader.decodable(topic, record.data):
                undecodable[topic.name] = undecodable.get(topic.name, 0) + 1
                continue
            writer.write(channel, record.log_time, record.data, record.publish_time, record.sequence)
        written = writer.counts
        writer.finish()
        read, missing = _read_back(writer.file, written)
        if read != written:
            raise OSError(f"{target}: what was written could not be read back: the disk may be failing")
    lost, estimated = _lost(reader, read, undecodable, expected)
    return RecoveryResult(
        Path(source),
        Path(target),
        read,
        undecodable,
        expected,
        lost,
        estimated,
        missing,
        tuple(reader.damages),
        tuple(warnings),
        reader.closed,
    )


def _lost(
    reader: BagReader,
    saved: Mapping[str, int],
    undecodable: Mapping[str, int],
    expected: Mapping[str, int] | None,
) -> tuple[int, bool]:
    """Return the messages lost in addition to those not decodable, and whether that is estimated."""
    found = sum(saved.values()) + sum(undecodable.values())
    if expected is not None:
        return max(sum(expected.values()) - found, 0), False
    lost, estimated = reader.lost()
    # metadata.yaml of a recording under way is some seconds old: it holds that many at least.
    return max(lost, reader.told - found), estimated


def _read_back(file: Path, written: Mapping[str, int]) -> tuple[dict[str, int], dict[str, int]]:
    """Return the messages by topic in ``file``, and the blocks missing in between by valve."""
    again = BagReader(file)
    read: dict[str, int] = dict.fromkeys(written, 0)
    for topic, _ in again.records():
        read[topic.name] += 1
    gates: dict[str, BlockGate] = {}
    for valve, item in again.streams():
        if isinstance(item, Block):
            gates.setdefault(valve, BlockGate()).judge(item)
    return read, {valve: gate.lost for valve, gate in gates.items() if gate.lost}


def _channel(writer: BagWriter, topic: Topic, warnings: list[str]) -> int | None:
    if topic.encoding != "cdr" or not topic.schema:
        name, encoding = printable(topic.name, 80), printable(topic.encoding, 40)
        warnings.append(f"{name}: encoding {encoding!r} without a ROS 2 definition is left out")
        return None
    try:
        qos = parse_qos(load_yaml(topic.qos) or [])
    except Exception:  # rosbags and its YAML parser: whatever a foreign text brings
        qos = []
    described = Definition(topic.type, topic.schema, topic.digest, topic.schema_encoding)
    try:
        return writer.add_topic(topic.name, topic.type, qos, described)
    except InputError as error:
        warnings.append(str(error))
        return None
