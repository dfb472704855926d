"""Log folder, that of ROS 2's log files, which rclpy needs to start."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from spool_core.private import private_temporary_folder


def ensure_log_folder() -> str | None:
    """Let ROS 2 log to a temporary folder where it can't write in its own; return one line about that.

    Its own is ``ROS_LOG_DIR``, else ``$ROS_HOME/log``, else ``~/.ros/log``.
    """
    folder, reason = _own(), "there is no home folder"
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return None
        except OSError as error:
            reason = error.strerror or str(error)
    other = private_temporary_folder("log")
    os.environ["ROS_LOG_DIR"] = str(other)
    return f"log folder {folder or '~/.ros/log'} can't be written ({reason}): logs go to {other}"


def _own() -> Path | None:
    named = os.environ.get("ROS_LOG_DIR")
    if named:
        return Path(named).expanduser()
    home = os.environ.get("ROS_HOME")
    try:
        return (Path(home).expanduser() if home else Path.home() / ".ros") / "log"
    except RuntimeError:
        return None
