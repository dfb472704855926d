"""Metadata of a bag as rosbag2 writes it, and the definitions of the messages."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from rosbags.interfaces import Nodetype, Qos
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from spool_core.errors import InputError
from spool_core.files import YamlError, load_yaml
from spool_core.system import sync_folder, write_durably
from spool_core.text import printable

FILE_NAME = "metadata.yaml"
ROOT = "rosbag2_bagfile_information"
VERSION = 9
#: Characters and values of it that are read: a topic and a file have some 400 B and 20 values each.
LARGEST = 1 << 24
MOST_VALUES = 1 << 20
#: Suffix of a file that rosbag2 compressed as a whole, and those that are read so.
COMPRESSED = ".zstd"
COMPRESSED_WHOLE = (COMPRESSED, ".zst")
#: Missing files that are named one by one.
MOST_MISSING = 10
#: What ``custom_data`` says of a recording under way, or of one that was never finished.
_UNFINISHED = {"recording": "not finished"}
#: Key of ``custom_data`` that holds the relative standard deviation of the sampling rate.
RATE_STD = "import_rate_std"
_PACKAGE = Path(__file__).resolve().parent
#: Key of ``custom_data`` that names the machine of which a bag was recorded.
MACHINE = "machine"


class _Dumper(yaml.SafeDumper):
    """YAML dumper with an empty value for ``None``."""


_Dumper.add_representer(type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", ""))


#: Names of parts without suffix: rosbag2 writes ``NAME_N`` up to Kilted, ``N_NAME_DATE`` from Lyrical on.
_COUNTED = re.compile(r"(?P<stem>.*)_(?P<number>\d{1,9})")
_DATED = re.compile(r"(?:(?P<number>\d{1,9})_)?(?P<stem>.*?)_?\d{4}_\d\d_\d\d-\d\d_\d\d_\d\d")
#: Suffixes of the files of a bag.
STORED = (".mcap", ".db3")

ACCELERATION_BLOCK = "spool_msgs/msg/AccelerationBlock"
ACCELERATION_BLOCKS = "spool_msgs/msg/AccelerationBlocks"
TEMPERATURE = "sensor_msgs/msg/Temperature"
FLOAT64 = "std_msgs/msg/Float64"
OUR_PACKAGE = "spool_msgs"
SEPARATOR = "=" * 80


@dataclass(slots=True)
class TopicCount:
    """Topic of the bag, and how many messages were written to it so far."""

    name: str
    type: str
    digest: str
    qos: tuple[Qos, ...] = ()
    messages: int = 0


@dataclass(slots=True)
class PartCount:
    """Count of one file of a bag: messages by topic, first and last time of reception (ns), size (B)."""

    file: str
    number: int
    start: int | None = None
    end: int = 0
    messages: dict[str, int] = field(default_factory=dict)
    size: int = 0

    def take(self, topic: str, log_time: int) -> None:
        """Count a message."""
        self.messages[topic] = self.messages.get(topic, 0) + 1
        self.start = log_time if self.start is None else min(self.start, log_time)
        self.end = max(self.end, log_time)

    @property
    def duration(self) -> int:
        """From the first to the last message, ns."""
        return max(self.end - (self.start or 0), 0) if self.start is not None else 0


@dataclass(frozen=True, slots=True)
class BagMetadata:
    """Metadata of a bag: its files in order, its topics; ``custom`` is what else is to be said of it."""

    parts: tuple[PartCount, ...]
    topics: tuple[TopicCount, ...]
    finished: bool = True
    custom: Mapping[str, str] = field(default_factory=dict)


def qos_text(profiles: Sequence[Qos]) -> str:
    """Return the quality-of-service profiles as the channel's metadata spells them."""
    return _text(dump_qos_v9(list(profiles))).strip() if profiles else ""


def qos_of(text: str) -> tuple[Qos, ...]:
    """Return the profiles that a channel's metadata spells; none where they cannot be read."""
    try:
        return tuple(parse_qos(load_yaml(text) or []))
    except Exception:  # rosbags and its YAML parser: whatever a damaged text brings
        return ()


def metadata_text(bag: BagMetadata) -> str:
    """Return what a bag's file tells of itself, as YAML: the content of ``metadata.yaml`` below its root."""
    return _text(_content(bag))


def write_metadata(folder: Path, bag: BagMetadata) -> None:
    """Write ``metadata.yaml`` to the disk; at any moment the old or the new one is whole."""
    write_durably(folder / FILE_NAME, _text({ROOT: _content(bag)}))
    sync_folder(folder)


def is_bag_file(path: Path) -> bool:
    """Return whether a file is an MCAP file by its name, compressed as a whole or not."""
    return path.name.lower().endswith((".mcap", *(f".mcap{suffix}" for suffix in COMPRESSED_WHOLE)))


def part_of(name: str) -> tuple[str, int] | None:
    """Return what the parts of one recording have in common, and the number of the file called ``name``.

    ``None`` where the name has no number.
    """
    base = name.removesuffix(COMPRESSED)
    suffix = next((one for one in STORED if base.endswith(one)), "")
    if not suffix:
        return None
    base = base.removesuffix(suffix)
    # The last digits of a date are no number of a part.
    match = _DATED.fullmatch(base) or _COUNTED.fullmatch(base)
    return (match["stem"], int(match["number"])) if match and match["number"] else None


def in_order(names: Iterable[str]) -> list[str]:
    """Return names of files in the order in which they were recorded, as far as their numbers tell."""
    return sorted(names, key=lambda name: (*(part_of(name) or (name, -1)), len(name), name))


class Storage(NamedTuple):
    """Files of a bag in order.

    ``messages``: as the metadata counts them. ``warnings``: one line each. ``packed``: each message is
    compressed by itself.
    """

    files: list[Path]
    messages: int
    warnings: list[str]
    packed: bool = False


def storage_files(folder: Path, *, foreign: bool = False) -> Storage:
    """Return what makes up the rosbag2 directory ``folder``.

    Args:
        folder: where the files are.
        foreign: whether SQLite files and messages that are compressed one by one are taken as well.

    Raises:
        InputError: no file of a bag, another storage, or compressed messages.
    """
    warnings: list[str] = []
    storage, compression, names, messages = "mcap", "", list[str](), 0
    try:
        storage, compression, names, messages = _told(folder)
    except FileNotFoundError:
        warnings.append(f"{folder}: {FILE_NAME} is missing")
    except YamlError as error:
        warnings.append(f"{folder / FILE_NAME} cannot be read: {printable(error, 200)}")
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        warnings.append(f"{folder / FILE_NAME} cannot be read")
    other = storage not in ("mcap", "") or any(name.endswith(".db3") for name in names)
    packed = compression.lower() == "message"
    if foreign:
        other = storage not in ("mcap", "sqlite3", "")
    if other or not (compression.lower() in ("", "none", "file") or (foreign and packed)):
        what = f"storage {storage or 'sqlite3'!r}" if other else f"compression mode {compression!r}"
        raise InputError(
            f"{folder}: {printable(what, 80)} is not supported here: type "
            f"`./spool import {folder} --out {folder.name}_mcap` to convert its accelerations, or convert "
            "all of it with `ros2 bag convert`"
        )
    # In the encoding of file names, which may not be that of the list; some were decompressed since.
    names = [os.fsdecode(name.encode("utf-8", "surrogateescape")) for name in names]
    names = [name if (folder / name).is_file() else name.removesuffix(COMPRESSED) for name in names]
    unlisted = in_order(_parts_of(folder, names) - set(names))
    warnings.extend(
        f"{folder}: {printable(name, 200)} is not in {FILE_NAME}, and is read as well" for name in unlisted
    )
    names = in_order({*names, *unlisted}) if unlisted else names
    paths = [folder / name for name in names if (folder / name).is_file()]
    missing = [name for name in names if not (folder / name).is_file()]
    warnings.extend(f"{folder}: {printable(name, 200)} is missing" for name in missing[:MOST_MISSING])
    if len(missing) > MOST_MISSING:
        warnings.append(f"{folder}: {len(missing) - MOST_MISSING} more files are missing")
    for suffix in STORED[: 1 + foreign]:
        if not paths:
            found = [*folder.glob(f"*{suffix}"), *folder.glob(f"*{suffix}{COMPRESSED}")]
            paths = [folder / name for name in in_order(path.name for path in found)]
    if not paths:
        kinds = "a rosbag2 directory, or a file in it" if foreign else "a rosbag2 directory or an .mcap file"
        raise InputError(f"{folder}: no .mcap file in it: name {kinds}")
    return Storage(paths, messages, warnings, packed)


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` in ``folder`` says below its root; nothing in it is checked.

    Raises:
        OSError, YamlError, ValueError, KeyError, TypeError: it cannot be read.
    """
    with (folder / FILE_NAME).open(encoding="utf-8") as stream:
        content = load_yaml(stream.read(LARGEST + 1), largest=LARGEST, most_values=MOST_VALUES)
    told: dict[str, Any] = content[ROOT]
    return told


def rate_std(path: Path) -> float:
    """Return the relative standard deviation of the sampling rate that a bag states, else 0."""
    try:
        found = float(custom_data(path).get(RATE_STD, "0"))
    except ValueError:
        return 0.0
    return found if 0.0 < found < 1.0 else 0.0


def custom_data(path: Path) -> dict[str, str]:
    """Return ``custom_data`` of the bag at ``path``, texts only; empty where there is none to be read."""
    try:
        told = read_metadata(path).get("custom_data") or {}
        return {
            printable(key, 80): printable(text, 200) for key, text in told.items() if isinstance(text, str)
        }
    except (OSError, YamlError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def is_unfinished(path: Path) -> bool:
    """Return whether the bag at ``path`` says that its recording is under way, or was never finished."""
    return custom_data(path).items() >= _UNFINISHED.items()


@dataclass(frozen=True, slots=True)
class Definition:
    """Definition of a message: ``text`` in ``encoding`` with dependencies, ``digest`` the RIHS01 hash."""

    name: str
    text: str
    digest: str
    encoding: str = "ros2msg"


@functools.cache
def typestore() -> Typestore:
    """Return rosbags' store of the Jazzy types and ours.

    Raises:
        InputError: the package ``spool_msgs`` is not on AMENT_PREFIX_PATH.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    folder = _message_folder(OUR_PACKAGE)
    if folder is None:
        raise InputError(
            f"the messages of {OUR_PACKAGE} are not on AMENT_PREFIX_PATH: "
            "start through ./spool or source the workspace's install/setup.bash"
        )
    types = {}
    for path in sorted(folder.glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(encoding="utf-8"), f"{OUR_PACKAGE}/msg/{path.stem}"))
    store.register(types)
    return store


@functools.cache
def definition(name: str) -> Definition:
    """Return the definition of message type ``name``, e.g. ``sensor_msgs/msg/Temperature``.

    The text is the installed ``.msg`` file word for word (comments carry the units); rosbags'
    own text stands in for types that are not installed.

    Raises:
        InputError: the type is unknown.
    """
    store = typestore()
    if name not in store.fielddefs:
        _register_installed(store, name)
    parts = [_own_text(store, name)]
    needed = _direct(store, name)
    for other in needed:  # nearest first; each adds those that it needs itself
        package, _, kind = other.split("/")
        parts.append(f"{SEPARATOR}\nMSG: {package}/{kind}\n{_own_text(store, other)}")
        needed += [one for one in _direct(store, other) if one not in needed]
    return Definition(name, "".join(parts), store.hash_rihs01(name))


@functools.lru_cache(maxsize=256)
def types_in(text: str, name: str) -> Typestore | None:
    """Return the types that the definition ``text`` of message type ``name`` holds.

    ``None`` where it is damaged, lacks one, or is in another language.
    """
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(text, name))
        store.generate_msgdef(name)  # fails where a type in it is not defined
    except Exception:  # rosbags and its parser: whatever a damaged text brings
        return None
    return store


def starts_with_header(name: str) -> bool:
    """Return whether the first field of message type ``name`` is a std_msgs/Header."""
    definition(name)
    fields = typestore().fielddefs[name][1]
    return bool(fields) and fields[0][1] == (Nodetype.NAME, "std_msgs/msg/Header")


def _text(value: object) -> str:
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=4096))


def _content(bag: BagMetadata) -> dict[str, Any]:
    counts = {topic.name: sum(part.messages.get(topic.name, 0) for part in bag.parts) for topic in bag.topics}
    start = min((part.start for part in bag.parts if part.start is not None), default=0)
    duration = max((part.end for part in bag.parts if part.start is not None), default=start) - start
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": max(duration, 0)},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(counts.values()),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": dump_qos_v9(list(topic.qos)),
                    "type_description_hash": topic.digest,
                },
                "message_count": counts[topic.name],
            }
            for topic in bag.topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.file for part in bag.parts],
        "files": [
            {
                "path": part.file,
                "starting_time": {"nanoseconds_since_epoch": part.start or 0},
                "duration": {"nanoseconds": part.duration},
                "message_count": sum(part.messages.values()),
            }
            for part in bag.parts
        ],
        "custom_data": {**bag.custom, **({} if bag.finished else _UNFINISHED)} or None,
        "ros_distro": "jazzy",
    }


def _parts_of(folder: Path, names: Sequence[str]) -> set[str]:
    """Return the parts that lie beside those that are listed, numbered like these."""
    stems = {part[0] for name in names if (part := part_of(name)) is not None}
    listed = {name.removesuffix(COMPRESSED) for name in names}
    kinds = [suffix for suffix in STORED if any(name.endswith(suffix) for name in listed)]
    beside = (path.name for suffix in kinds for path in folder.glob(f"*{suffix}") if path.is_file())
    return {
        name
        for name in beside
        if name not in listed and (part := part_of(name)) is not None and part[0] in stems
    }


def _told(folder: Path) -> tuple[str, str, list[str], int]:
    """Return storage, compression, names of files and number of messages."""
    info = read_metadata(folder)
    names = [str(name) for name in info["relative_file_paths"]]
    for name in names:
        if "\0" in name:
            raise YamlError("a name of a file has a zero byte")
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise YamlError(f"the file {printable(name, 80)} would lie outside of the bag")
    count = info.get("message_count", 0)
    storage, compression = str(info["storage_identifier"]), str(info.get("compression_mode") or "")
    return storage, compression, names, count if isinstance(count, int) else 0


def _register_installed(store: Typestore, name: str) -> None:
    path = _message_file(name)
    if path is None:
        raise InputError(f"message type {name} is not known here: install its package or leave its topic out")
    types = get_types_from_msg(path.read_text(encoding="utf-8"), name)
    for kind in types:
        if kind not in store.fielddefs:
            store.register({kind: types[kind]})
    for other in _direct(store, name):
        if other not in store.fielddefs:
            _register_installed(store, other)


def _message_folder(package: str) -> Path | None:
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    # Without ROS: the wheel has our own messages in this package.
    folders = [Path(prefix, "share", package, "msg") for prefix in (*prefixes, str(_PACKAGE))]
    return next((folder for folder in folders if folder.is_dir()), None)


def _message_file(name: str) -> Path | None:
    package, _, kind = name.split("/")
    folder = _message_folder(package)
    path = folder / f"{kind}.msg" if folder else None
    return path if path and path.is_file() else None


def _own_text(store: Typestore, name: str) -> str:
    path = _message_file(name)
    if path is not None:
        return path.read_text(encoding="utf-8").rstrip("\n") + "\n"
    text, _ = store.generate_msgdef(name, ros_version=2)
    return text.split(SEPARATOR)[0].rstrip("\n") + "\n"


def _direct(store: Typestore, name: str) -> list[str]:
    """Return the types of the fields of ``name``, each once."""
    found: dict[str, None] = {}
    for _, (node, detail) in store.fielddefs[name][1]:
        inner = detail[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, detail)
        if inner[0] == Nodetype.NAME:
            found[str(inner[1])] = None
    return list(found)
