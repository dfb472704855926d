"""Bags: recorder, reader, recovery, import and export; here the names of valves and of columns of tables."""

from __future__ import annotations

import re
from pathlib import Path

from spool_core.errors import InputError
from spool_core.system import leftovers

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

TIME = "time_s"
BODY = "body_m_s2"
SPOOL = "spool_m_s2"
OIL_TEMPERATURE = "oil_temperature_C"
SPEED = "speed_rpm"
#: Pulses of a tacho in any unit; their speed takes the place of the column.
TACHO = "tacho_pulse"
#: The solenoid's command in any unit, 0 in the position that is judged.
COMMAND = "command"
#: Columns of slow readings beside the accelerations; each may be missing, or have empty cells.
SLOW = (OIL_TEMPERATURE, SPEED, TACHO, COMMAND)
DISPLACEMENT = "displacement_m"
FORCE = "force_N"

#: What ``linear_acceleration_covariance[0]`` holds where an Imu measures no acceleration (sensor_msgs/Imu).
NOT_MEASURED = -1.0


def no_such_bag(path: Path) -> InputError:
    """Return the refusal of ``path`` where there is no bag."""
    left = "".join(f"; a killed process left {part} behind" for part in leftovers(path)[:1])
    return InputError(f"{path}: no such bag: name a rosbag2 directory or an .mcap file{left}")


def check_valve(valve: str) -> None:
    """Raise InputError unless ``valve`` can be a ROS namespace."""
    if not _NAME.fullmatch(valve) or "__" in valve:
        raise InputError(
            f"valve name {valve!r}: use letters, digits and single underscores, not a digit first"
        )
