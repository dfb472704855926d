"""The ``metadata.yaml`` of a rosbag2 directory (version 9, as ROS 2 Jazzy writes it)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from spool_stream.errors import InputError

FILE_NAME = "metadata.yaml"
ROOT = "rosbag2_bagfile_information"
VERSION = 9


@dataclass(slots=True)
class TopicCount:
    """A topic of the bag and how many messages it has so far."""

    name: str
    type: str
    digest: str
    qos: tuple[Qos, ...] = ()
    messages: int = 0


@dataclass(frozen=True, slots=True)
class BagMetadata:
    """What the file says of a bag; times in ns."""

    file: str
    start: int
    duration: int
    topics: tuple[TopicCount, ...]


def _yaml() -> YAML:
    yaml = YAML(typ="rt", pure=True)  # keeps the order of keys
    yaml.default_flow_style = False
    yaml.width = 4096
    return yaml


def _text(value: object) -> str:
    stream = StringIO()
    _yaml().dump(value, stream)
    return stream.getvalue()


def qos_text(profiles: Sequence[Qos]) -> str:
    """Return the quality-of-service profiles as the channel's metadata spells them."""
    return _text(dump_qos_v9(list(profiles))).strip() if profiles else ""


def write_metadata(folder: Path, bag: BagMetadata) -> None:
    """Write ``metadata.yaml`` so that at any moment either the old or the new one is whole."""
    count = sum(topic.messages for topic in bag.topics)
    content = {
        ROOT: {
            "version": VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": bag.duration},
            "starting_time": {"nanoseconds_since_epoch": bag.start},
            "message_count": count,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": dump_qos_v9(list(topic.qos)),
                        "type_description_hash": topic.digest,
                    },
                    "message_count": topic.messages,
                }
                for topic in bag.topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [bag.file],
            "files": [
                {
                    "path": bag.file,
                    "starting_time": {"nanoseconds_since_epoch": bag.start},
                    "duration": {"nanoseconds": bag.duration},
                    "message_count": count,
                }
            ],
            "custom_data": None,
            "ros_distro": "jazzy",
        }
    }
    temporary = folder / (FILE_NAME + ".tmp")
    with temporary.open("w", encoding="utf-8") as stream:
        stream.write(_text(content))
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(folder / FILE_NAME)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Bring the names in ``folder`` to the disk; synced files can be lost with their name otherwise."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def storage_files(folder: Path) -> tuple[list[Path], list[str]]:
    """Return the MCAP files of the rosbag2 directory ``folder`` in order, and warnings.

    Raises:
        InputError: no MCAP file, another storage, or compression around the file.
    """
    warnings: list[str] = []
    try:
        content = _yaml().load((folder / FILE_NAME).read_text(encoding="utf-8"))
        info: dict[str, Any] = content[ROOT]
        storage, compression = info["storage_identifier"], info.get("compression_mode")
        names = [str(name) for name in info["relative_file_paths"]]
    except FileNotFoundError:
        warnings.append(f"{folder}: {FILE_NAME} is missing")
        storage, compression, names = "mcap", "", []
    except (OSError, UnicodeDecodeError, YAMLError, KeyError, TypeError):
        warnings.append(f"{folder / FILE_NAME} cannot be read")
        storage, compression, names = "mcap", "", []
    if storage != "mcap":
        raise InputError(
            f"{folder}: storage {storage!r} cannot be read: convert it with `ros2 bag convert` to mcap"
        )
    if compression:
        raise InputError(
            f"{folder}: compression mode {compression!r} cannot be read: decompress the bag first"
        )
    paths = [folder / name for name in names if (folder / name).is_file()]
    missing = [name for name in names if not (folder / name).is_file()]
    warnings.extend(f"{folder}: {name} is missing" for name in missing)
    if not paths:
        paths = sorted(folder.glob("*.mcap"), key=lambda path: (len(path.name), path.name))
    if not paths:
        raise InputError(f"{folder}: no .mcap file in it: name a rosbag2 directory or an .mcap file")
    return paths, warnings
