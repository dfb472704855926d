"""Diagnostic tasks of a node, by the rules of the standard tools."""

from __future__ import annotations

import enum
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from spool_core.block_gate import BlockGate, Fault
from spool_core.node import qos
from spool_core.node.managed_node import ManagedNode
from spool_core.text import plural

#: s between two reports of a node at rest: `diagnostic_aggregator` shows a task STALE after 5 s by default.
PERIOD = 1.0


class Level(enum.Enum):
    """How well a task runs, as in ``DiagnosticStatus``; values are what the message field takes."""

    OK = DiagnosticStatus.OK
    WARNING = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR
    STALE = DiagnosticStatus.STALE


@dataclass(frozen=True, slots=True)
class Status:
    """How one task is doing: its level, one line for people, values by key (see :func:`key`).

    Keys never change while a node runs: plots and rules follow them. What is not known yet is NaN.
    """

    task: str
    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


def key(name: str, unit: str = "1") -> str:
    """Return a value's key: ``name`` in snake_case and its unit, e.g. ``spring_stiffness_N_per_m``."""
    if unit in ("", "1"):
        return name
    return f"{name}_{re.sub('[^A-Za-z0-9]+', '_', unit.replace('^', '').replace('/', '_per_'))}"


def block_values(gate: BlockGate) -> dict[str, object]:
    """Return what a consumer of blocks tells of them: since its start, and within the last minute of data."""
    return {
        "blocks_used": gate.accepted,
        "blocks_lost": gate.lost,
        "blocks_refused": gate.refused,
        "blocks_lost_last_minute": gate.recent.lost,
        "blocks_refused_last_minute": gate.recent.refused,
        **{f"fault_{fault.name.lower()}": gate.faults.get(fault, 0) for fault in Fault},
    }


def block_faults(gate: BlockGate) -> str:
    """Return what was lost and refused within the last minute of data, empty where nothing was."""
    lost, refused = gate.recent.lost, gate.recent.refused
    return f"{plural(lost, 'block')} lost, {refused} refused in the last minute" if lost or refused else ""


class DiagnosticPublisher:
    """Reports the tasks of one node on ``/diagnostics``; names are ``namespace/node: task``.

    The hardware_id is the node's fully qualified name: a bridge to fault memories finds the node by it.
    ``valve_id``, where not empty, is a value of every task; it may change when the node learns it.
    """

    def __init__(self, node: ManagedNode, valve_id: str = "") -> None:
        self._node = node
        self.valve_id = valve_id
        self._resting = False
        self._kept: dict[str, DiagnosticStatus] = {}
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.diagnostics())

    def publish(self, *tasks: Status) -> None:
        """Send the state of ``tasks`` now."""
        self._resting = False
        self._send([self._filled(task) for task in tasks])

    def rest(self, reason: str, *tasks: str) -> None:
        """Send that ``tasks`` (none: all that were sent) are silent by order, which is no fault: ``reason``.

        Otherwise their last level would stay with every listener. All tasks are sent each second until the
        next :meth:`publish`: a node that rests differs from one that died.
        """
        for task, status in self._kept.items():
            if not tasks or task in tasks:
                status.level, status.message = Level.OK.value, reason
        self._resting = True
        self._rest_on()
        self._node.every(PERIOD, self._rest_on, steady=True)

    def _rest_on(self) -> None:
        if self._resting:
            self._send(list(self._kept.values()))

    def _send(self, statuses: list[DiagnosticStatus]) -> None:
        message = DiagnosticArray(status=statuses)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _filled(self, task: Status) -> DiagnosticStatus:
        """Return the message of ``task``: the former one with its values renewed, as keys never change."""
        status = self._kept.get(task.task)
        values = {**task.values, "valve_id": self.valve_id} if self.valve_id else task.values
        if status is None or len(status.values) != len(values):
            name = self._node.get_fully_qualified_name()
            status = DiagnosticStatus(
                name=f"{name.lstrip('/')}: {task.task}", hardware_id=name,
                values=[KeyValue(key=key) for key in values],
            )  # fmt: skip
            self._kept[task.task] = status
        status.level, status.message = task.level.value, task.message
        for pair, (name, value) in zip(status.values, values.items(), strict=True):
            pair.key, pair.value = name, f"{value:.6g}" if isinstance(value, float) else str(value)
        return status

    def destroy(self) -> None:
        """Take the publisher away."""
        self._resting = False
        self._node.destroy_publisher(self._publisher)
