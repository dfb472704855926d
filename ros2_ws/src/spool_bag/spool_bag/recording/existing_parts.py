"""Parts of a recording that is there, to go on from: what they hold, and how the last one is named."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import NamedTuple

from rosbags.rosbag2.metadata import parse_qos
from spool_core.errors import InputError
from spool_core.files import load_yaml

from spool_bag.format.definitions import Definition
from spool_bag.format.metadata import PartCount, TopicCount
from spool_bag.mcap.mcap_definitions import Topic
from spool_bag.mcap.mcap_file import McapFile
from spool_bag.mcap.part_chain import UNREADABLE, begin_of, end_of, file_hash, oldest_of

_NUMBER = re.compile(r".*_(\d{1,9})\.mcap")


class Existing(NamedTuple):
    """Existing parts in order, their topics, the next number, the hash of the last one and of its file,
    and the oldest part that it tells of: what lacks from there on was not removed by the recorder."""

    parts: list[PartCount]
    topics: list[tuple[TopicCount, Definition]]
    next: int
    link: str
    file: str
    oldest: int


def numbered(folder: Path) -> list[tuple[int, Path]]:
    """Return the parts in a folder by their numbers."""
    found = [(number, path) for path in folder.glob("*.mcap") if (number := number_of(path.name)) is not None]
    return sorted(found)


def number_of(name: str) -> int | None:
    """Return the number in a part's file name, ``None`` where it has none."""
    match = _NUMBER.fullmatch(name)
    return int(match[1]) if match else None


def existing_parts(folder: Path) -> Existing:
    """Return what a recording in ``folder`` holds; finished parts by their index, others as far as
    they can be read.

    Raises:
        OSError: the folder cannot be read.
    """
    parts: list[PartCount] = []
    topics: dict[str, tuple[TopicCount, Definition]] = {}
    files = numbered(folder)
    for number, path in files:
        count = PartCount(path.name, number)
        parts.append(count)
        try:
            count.size = path.stat().st_size
            file = McapFile(path)
            if file.counts is not None and file.times is not None:
                count.start, count.end = file.times
                count.messages = {
                    topic.name: file.counts.get(channel, 0) for channel, topic in file.topics.items()
                }
            else:
                for record in file.records(lambda _: True, lambda _: None):
                    count.take(file.topics[record.channel].name, record.log_time)
        except (InputError, OSError):
            continue  # not one byte of it can be used: it takes room, and goes by the quota
        for topic in file.topics.values():
            topics.setdefault(topic.name, (_counted(topic), _definition(topic)))
    return Existing(
        parts, list(topics.values()), files[-1][0] + 1 if files else 0, *_last(files), _oldest(files)
    )


def _last(files: list[tuple[int, Path]]) -> tuple[str, str]:
    """Return the hash that stands for the last part, and that of its whole file where it is finished."""
    if not files:
        return "", ""
    path = files[-1][1]
    try:
        with path.open("rb") as stream:
            os.fsync(stream.fileno())  # a recorder that was killed left what a power loss would take
        last = end_of(path)
        return (last.end.link, last.file) if last is not None else (file_hash(path), "")
    except OSError:
        return UNREADABLE, ""


def _oldest(files: list[tuple[int, Path]]) -> int:
    """Return the number of the oldest part that the last readable one tells of."""
    for _, path in reversed(files):
        try:
            if begin_of(path) is not None:
                ended = end_of(path)
                return max(oldest_of(path), ended.end.oldest if ended is not None else 0)
        except OSError:
            continue
    return 0


def _counted(topic: Topic) -> TopicCount:
    try:
        qos = tuple(parse_qos(load_yaml(topic.qos) or []))
    except Exception:  # rosbags and its YAML parser: whatever a damaged text brings
        qos = ()
    return TopicCount(topic.name, topic.type, topic.digest, qos)


def _definition(topic: Topic) -> Definition:
    return Definition(topic.type, topic.schema, topic.digest, topic.schema_encoding)
