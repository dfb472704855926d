"""Diagnostic tasks of a node, by the rules of the standard tools."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from . import qos


class Level(enum.Enum):
    """The levels of ``DiagnosticStatus``; values are what the message field takes."""

    OK = DiagnosticStatus.OK
    WARNING = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR
    STALE = DiagnosticStatus.STALE


@dataclass(frozen=True, slots=True)
class Status:
    """One task's state: its level, one line for people, values by key (with the unit in the key)."""

    task: str
    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


class DiagnosticPublisher:
    """Publish the tasks of one node on ``/diagnostics``; names are ``namespace/node: task``.

    ``hardware_id`` may change when the node learns which valve it is for.
    """

    def __init__(self, node: Node, hardware_id: str) -> None:
        self._node = node
        self.hardware_id = hardware_id
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.diagnostics())

    def publish(self, *tasks: Status) -> None:
        """Send the state of ``tasks`` now."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        prefix = self._node.get_fully_qualified_name().lstrip("/")
        message.status = [
            DiagnosticStatus(
                level=task.level.value,
                name=f"{prefix}: {task.task}",
                message=task.message,
                hardware_id=self.hardware_id,
                values=[KeyValue(key=key, value=_text(value)) for key, value in task.values.items()],
            )
            for task in tasks
        ]
        self._publisher.publish(message)

    def destroy(self) -> None:
        """Take the publisher away."""
        self._node.destroy_publisher(self._publisher)


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
