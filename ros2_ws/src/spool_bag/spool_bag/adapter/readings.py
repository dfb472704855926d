"""Readings: the samples in a message of a sensor, by message type, axis, sign and unit."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import AccelStamped, Vector3Stamped
from sensor_msgs.msg import Imu
from spool_core.node.messages import nanoseconds
from std_msgs.msg import Float64MultiArray

#: m/s^2 in one of each unit; g is the standard acceleration of free fall (ISO 80000-3).
UNITS: Mapping[str, float] = {"m/s^2": 1.0, "g": 9.80665}

IMU, ACCEL, ARRAY = "sensor_msgs/msg/Imu", "geometry_msgs/msg/AccelStamped", "std_msgs/msg/Float64MultiArray"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
TYPES: Mapping[str, Any] = {
    IMU: Imu, ACCEL: AccelStamped, VECTOR: Vector3Stamped, ARRAY: Float64MultiArray,
}  # fmt: skip
_AXIS = re.compile(r"[+-]?[xyz]")
_COLUMN = re.compile(r"[+-]?column\d{1,4}")

#: What ``linear_acceleration_covariance[0]`` holds where an Imu measures no acceleration (sensor_msgs/Imu).
NOT_MEASURED = -1.0
#: Parts of a second in ``builtin_interfaces/Time``: more is no time.
NANOSECONDS = 1_000_000_000

Samples = list[tuple[int, float]]


class UnusableError(ValueError):
    """A message holds no sample that can be used; the text says why."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Reading: takes the samples of one sensor out of a message.

    ``kind`` is one of ``TYPES``; ``axis`` is ``+x``, ``+y``, ``+z``, with a minus where it points the other
    way, ``+column0`` and so on of an array; ``unit`` one of ``UNITS``; ``gain`` is multiplied on top.
    ``frame`` is the only ``frame_id`` taken, empty: any. ``by_arrival``: the arrival's time counts, not the
    header's.
    ``time_column``: of an array, in s; -1 for none. ``sample_rate`` (Hz) of arrays with several samples each.
    """

    kind: str
    axis: str
    unit: str = "m/s^2"
    gain: float = 1.0
    frame: str = ""
    by_arrival: bool = False
    time_column: int = -1
    sample_rate: float = 0.0

    def refusal(self) -> str | None:
        """Return what is wrong with ``axis`` for this type of message, or ``None``."""
        if self.kind == ARRAY:
            good, wanted = _COLUMN.fullmatch(self.axis), "+column0, -column0, +column1 and so on"
        else:
            good, wanted = _AXIS.fullmatch(self.axis), "+x, +y, +z, -x, -y or -z"
        return None if good else f"{self.axis!r} is no axis of {self.kind}: write {wanted}"

    @property
    def samples(self) -> Callable[[Any, int], Samples]:
        """What takes a message and the time of its arrival (ns), and returns stamps (ns) and values (m/s^2).

        Raises:
            UnusableError: there is no sample in it for this sensor.

        """
        name = self.axis.lstrip("+-").removeprefix("column")
        factor = UNITS[self.unit] * self.gain * (-1.0 if self.axis.startswith("-") else 1.0)
        if self.kind == ARRAY:
            return lambda message, arrival: self._of_array(message, arrival, int(name), factor)

        def of_vector(message: Any, arrival: int) -> Samples:
            header = message.header
            if self.frame and header.frame_id != self.frame:
                raise UnusableError(f"frame_id is {header.frame_id!r}, not {self.frame!r}")
            if self.kind == IMU:
                if message.linear_acceleration_covariance[0] == NOT_MEASURED:
                    raise UnusableError("this Imu says that it measures no acceleration")
                vector = message.linear_acceleration
            else:
                vector = message.vector if self.kind == VECTOR else message.accel.linear
            stamp = arrival if self.by_arrival else nanoseconds(header.stamp)
            if not self.by_arrival and header.stamp.nanosec >= NANOSECONDS:
                stamp = 0
            return [(stamp, factor * getattr(vector, name))]

        return of_vector

    def _of_array(self, message: Any, arrival: int, column: int, factor: float) -> Samples:
        dimensions = message.layout.dim
        data = message.data[message.layout.data_offset :]
        columns = dimensions[-1].size if len(dimensions) > 1 else len(data)
        if columns < 1 or len(data) % columns or not data:
            raise UnusableError(f"{len(data)} numbers are no rows of {columns} columns")
        highest = max(column, self.time_column)
        if highest >= columns:
            raise UnusableError(f"there is no column {highest}: it has {columns}, counted from 0")
        values = [factor * value for value in data[column::columns]]
        if self.time_column >= 0:
            times = data[self.time_column :: columns]
            return [
                (round(1e9 * time) if math.isfinite(time) and abs(time) < 1e10 else 0, value)
                for time, value in zip(times, values, strict=True)
            ]
        if len(values) == 1:
            return [(arrival, values[0])]
        if self.sample_rate <= 0.0:
            raise UnusableError(f"{len(values)} samples in a message: set sample_rate, or time_column")
        step, last = 1e9 / self.sample_rate, len(values) - 1
        return [(arrival - round((last - place) * step), value) for place, value in enumerate(values)]
