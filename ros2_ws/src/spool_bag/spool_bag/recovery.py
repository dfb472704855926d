"""Make a readable bag of a damaged or unfinished one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import parse_qos
from spool_stream.errors import InputError

from .definitions import Definition
from .mcap_file import Damage, Topic
from .reader import BagReader
from .writer import BagWriter


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """What was saved.

    ``messages`` counts by topic what the new bag holds, as read back from it. ``undecodable`` counts messages
    whose bytes do not fit their definition; they are left out. ``expected`` counts by topic what the old bag
    says it held, ``None`` where it says nothing (a killed recording). ``damages`` are the old bag's.
    """

    source: Path
    target: Path
    messages: Mapping[str, int]
    undecodable: Mapping[str, int]
    expected: Mapping[str, int] | None
    damages: tuple[Damage, ...]
    warnings: tuple[str, ...]

    @property
    def lost(self) -> int | None:
        """Messages that the old bag held and the new one does not; ``None``: not known."""
        if self.expected is None:
            return None
        return sum(self.expected.values()) - sum(self.messages.values())


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
    with BagWriter(target) as writer:
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
    again = BagReader(target)
    read: dict[str, int] = dict.fromkeys(written, 0)
    for topic, _ in again.records():
        read[topic.name] += 1
    if read != written:
        raise OSError(f"{target}: what was written could not be read back: the disk may be failing")
    return RecoveryResult(
        Path(source), Path(target), read, undecodable, expected, tuple(reader.damages), tuple(warnings)
    )


def _channel(writer: BagWriter, topic: Topic, warnings: list[str]) -> int | None:
    if topic.encoding != "cdr" or not topic.schema:
        warnings.append(f"{topic.name}: encoding {topic.encoding!r} without a ROS 2 definition is left out")
        return None
    try:
        qos = parse_qos(topic.qos)
    except (ReaderError, KeyError, TypeError):
        qos = []
    described = Definition(topic.type, topic.schema, topic.digest, topic.schema_encoding)
    try:
        return writer.add_topic(topic.name, topic.type, qos, described)
    except InputError as error:
        warnings.append(str(error))
        return None
