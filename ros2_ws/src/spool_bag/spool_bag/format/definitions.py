"""Message definitions and type hashes as a bag carries them, without rclpy."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from pathlib import Path

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from spool_core.errors import InputError

ACCELERATION_BLOCK = "spool_msgs/msg/AccelerationBlock"
TEMPERATURE = "sensor_msgs/msg/Temperature"
OUR_PACKAGE = "spool_msgs"
SEPARATOR = "=" * 80


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
    for other in _dependencies(store, name):
        package, _, kind = other.split("/")
        parts.append(f"{SEPARATOR}\nMSG: {package}/{kind}\n{_own_text(store, other)}")
    return Definition(name, "".join(parts), store.hash_rihs01(name))


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
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        folder = Path(prefix) / "share" / package / "msg"
        if prefix and folder.is_dir():
            return folder
    return None


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
    found = []
    for _, (node, detail) in store.fielddefs[name][1]:
        inner = detail[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, detail)
        if inner[0] == Nodetype.NAME:
            found.append(str(inner[1]))
    return found


def _dependencies(store: Typestore, name: str) -> list[str]:
    """Return every type that ``name`` needs, each once, nearest first."""
    queue, seen = _direct(store, name), []
    while queue:
        other = queue.pop(0)
        if other not in seen:
            seen.append(other)
            queue.extend(_direct(store, other))
    return seen


def starts_with_header(name: str) -> bool:
    """Return whether the first field of message type ``name`` is a std_msgs/Header."""
    definition(name)
    fields = typestore().fielddefs[name][1]
    return bool(fields) and fields[0][1] == (Nodetype.NAME, "std_msgs/msg/Header")
