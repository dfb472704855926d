"""Node ``monitor``: says what blocks and estimates of one valve mean."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import ClassVar

from spool_estimator.messages import from_message
from spool_estimator.valve_messages import from_description
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, ValveDescription, ValveHealth
from spool_node import qos
from spool_node.diagnostics import DiagnosticPublisher, Level, Status
from spool_node.managed_node import ManagedNode
from spool_node.messages import to_block
from spool_node.parameters import Parameter
from spool_node.running import run
from spool_stream.quantity import Quantity

from . import monitor as core
from .event import Condition, Event, Severity
from .messages import to_event_message, to_health_message

_SETTINGS = (
    Parameter(
        "natural_frequency", 0.0, "Start value until it is estimated; 0: from the valve's description.",
        "Hz", 0.0, 1e3, read_only=True,
    ),
    Parameter(
        "resonance_band", 0.2, "Relative distance that counts as near resonance.",
        "1", 0.01, 1.0, read_only=True,
    ),
    Parameter(
        "amplification_on", 1.8, "Spool over body that raises resonance.", "1", 1.0, 100.0, read_only=True,
    ),
    Parameter("amplification_off", 1.5, "Spool over body that clears it.", "1", 0.5, 100.0, read_only=True),
    Parameter(
        "minimum_body", 0.5, "Peak body acceleration that is judged.", "m/s^2", 0.0, 1e3, read_only=True,
    ),
    Parameter("viscous_change", 0.2, "Relative change that warns.", "1", 0.01, 10.0, read_only=True),
    Parameter(
        "coulomb_change", 0.1, "Change of the Coulomb force that warns.", "N", 1e-4, 1e4, read_only=True,
    ),
    Parameter("stiffness_change", 0.1, "Relative change that warns.", "1", 0.001, 10.0, read_only=True),
    Parameter(
        "baseline_time", 15.0, "Time of valid estimates for the start values.", "s", 3.0, 1e5, read_only=True,
    ),
    Parameter("stale_after", 1.5, "Silence that is reported.", "s", 0.2, 60.0, read_only=True),
)  # fmt: skip

_LEVELS = {
    core.Level.OK: Level.OK,
    core.Level.UNKNOWN: Level.OK,
    core.Level.WARNING: Level.WARNING,
    core.Level.ALARM: Level.ERROR,
    core.Level.STALE: Level.STALE,
}


class MonitorNode(ManagedNode):
    """Judge resonance, drift and silence of one valve from its blocks and estimates."""

    PARAMETERS: ClassVar = _SETTINGS

    def __init__(self) -> None:
        super().__init__("monitor")
        self._core: core.Monitor | None = None
        self._valve_id = self.get_namespace().strip("/")
        self._block_arrival = self._estimate_arrival = time.monotonic()
        self._level = core.Level.UNKNOWN

    def configure(self) -> None:
        """Build the core."""
        values = {parameter.name: self.value(parameter.name) for parameter in _SETTINGS}
        if values["natural_frequency"] == 0.0:
            del values["natural_frequency"]
        self._core = core.Monitor(core.MonitorSettings(**values))
        self._health_publisher = self.create_lifecycle_publisher(ValveHealth, "health", qos.state())
        self._event_publisher = self.create_lifecycle_publisher(HealthEvent, "events", qos.state(depth=100))
        self._diagnostics = DiagnosticPublisher(self, self._valve_id)

    def activate(self) -> None:
        """Listen; estimates and the valve's description are latched, so a late start misses neither."""
        self._block_arrival = self._estimate_arrival = time.monotonic()
        self.subscribe(ValveDescription, "valve", self._take_description, qos.state())
        self.subscribe(AccelerationBlock, "acceleration", self._take_block, qos.samples_wanted())
        self.subscribe(ModelEstimate, "estimate", self._take_estimate, qos.state(depth=10))
        self.every(0.2, self._watch, steady=True)
        self.every(1.0, self._report, steady=True)

    def cleanup(self) -> None:
        """Let go of core and publishers."""
        self.destroy_publisher(self._health_publisher)
        self.destroy_publisher(self._event_publisher)
        self._diagnostics.destroy()
        self._core = None

    def _take_description(self, message: ValveDescription) -> None:
        assert self._core is not None
        self._valve_id = self._diagnostics.hardware_id = message.header.frame_id
        if self.value("natural_frequency") == 0.0:
            self._core.set_natural_frequency(from_description(message).natural_frequency)

    def _take_block(self, message: AccelerationBlock) -> None:
        assert self._core is not None
        gate = self._core.gate
        accepted = gate.accepted
        events = self._core.update(to_block(message))
        if gate.accepted > accepted:
            self._block_arrival = time.monotonic()
        if accepted == 0:
            self._estimate_arrival = self._block_arrival
        self._publish(events)

    def _take_estimate(self, message: ModelEstimate) -> None:
        assert self._core is not None
        self._estimate_arrival = time.monotonic()
        self._publish(self._core.update_estimate(from_message(message)))

    def _watch(self) -> None:
        assert self._core is not None
        now = time.monotonic()
        self._publish(self._core.idle(now - self._block_arrival, now - self._estimate_arrival))

    def _publish(self, events: list[Event]) -> None:
        assert self._core is not None
        for event in events:
            self._event_publisher.publish(to_event_message(event, self._valve_id))
            self.get_logger().info(f"{event.kind} {event.state.name.lower()}: {event.message}")
        if events and self._core.health.level is not self._level:
            self._report()

    def _report(self) -> None:
        assert self._core is not None
        health = self._core.health
        if health.stamp == 0:  # before the first block the node's clock is all there is
            health = replace(health, stamp=self.get_clock().now().nanoseconds)
        self._level = health.level
        self._health_publisher.publish(to_health_message(health, self._valve_id))
        gate = self._core.gate
        stale = health.level is core.Level.STALE
        resonance = self._core.resonance.condition
        frictions = [drift.condition for drift in self._core.drifts]
        faulty = gate.lost + gate.refused
        data = Status(
            "data",
            Level.STALE if stale else Level.WARNING if faulty else Level.OK,
            health.summary if stale else f"{gate.lost} blocks lost, {gate.refused} refused",
            {
                "blocks used": gate.accepted,
                "blocks lost": gate.lost,
                "blocks refused": gate.refused,
                **{f"fault: {fault.value}": count for fault, count in gate.faults.items()},
            },
        )
        self._diagnostics.publish(
            data,
            _status("resonance", [resonance], stale, health.dominant_frequency, health.amplification,
                    health.natural_frequency),
            _status("friction and spring", frictions, stale, health.viscous_drift, health.coulomb_drift),
        )  # fmt: skip


def _status(task: str, conditions: list[Condition], stale: bool, *values: Quantity) -> Status:
    active = [condition for condition in conditions if condition.active is not None]
    worst = max((condition.active for condition in active if condition.active is not None), default=None)
    level = {None: Level.OK, Severity.WARNING: Level.WARNING}.get(worst, Level.ERROR)
    text = ", ".join(f"{one.kind} {one.cause}".strip().replace("_", " ") for one in active) or "nothing found"
    return Status(
        task,
        Level.STALE if stale else level,
        "no data" if stale else text,
        {f"{value.name} ({value.unit})": value.value for value in values},
    )


def main() -> int:
    """Run the node."""
    return run(MonitorNode)


if __name__ == "__main__":
    sys.exit(main())
