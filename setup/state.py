"""State of the set-up: what is done so far, kept between calls as one JSON file."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, fields

from setup.layout import Layout


@dataclass
class SetupState:
    """The stamp of a set-up; empty fields are steps not yet done.

    Attributes:
        root: the project's folder at that time; the environment holds absolute paths.
        base_python: interpreter that made the environment.
        python_version: its "3.x".
        underlay: prefixes of the sourced ROS 2.
        lock: hash of the lock that was installed.
        patched: whether the CMake files of the wheels name this machine's folders.
        packages: fingerprint of every package built.
        environment: variables that the built workspace wants, whole values.
        warmed: whether the kernels were compiled.
    """

    root: str = ""
    base_python: str = ""
    python_version: str = ""
    underlay: list[str] = field(default_factory=list)
    lock: str = ""
    patched: bool = False
    packages: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    warmed: bool = False


def load(layout: Layout) -> SetupState:
    """The stamp, or an empty one where there is none or it cannot be read."""
    try:
        data = json.loads(layout.state_file.read_text())
        return SetupState(**{entry.name: data[entry.name] for entry in fields(SetupState)})
    except (OSError, ValueError, KeyError, TypeError):
        return SetupState()


def save(layout: Layout, state: SetupState) -> None:
    """Write the stamp in one move, so that a kill leaves the old or the new one."""
    layout.notes.mkdir(parents=True, exist_ok=True)
    new = layout.state_file.with_suffix(".new")
    new.write_text(json.dumps(asdict(state), indent=1))
    os.replace(new, layout.state_file)
