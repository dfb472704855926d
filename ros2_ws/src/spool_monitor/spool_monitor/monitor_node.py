"""Node ``monitor``: says what blocks and estimates of one valve mean."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from spool_estimator.messages import from_message
from spool_estimator.valve_messages import from_description
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, ValveDescription, ValveHealth
from spool_node import qos
from spool_node.diagnostics import DiagnosticPublisher, Level, Status, block_faults, block_values, key
from spool_node.managed_node import ManagedNode
from spool_node.messages import to_block
from spool_node.parameters import Parameter, Value
from spool_node.running import run
from spool_stream.errors import InputError
from spool_stream.quantity import Quantity

from spool_monitor.alarms.alarm_code import ALARMS, LATCHING
from spool_monitor.alarms.alarm_services import AlarmDesk
from spool_monitor.alarms.alarm_store import AlarmBook
from spool_monitor.alarms.event import Event, Severity
from spool_monitor.history.state_file import default_folder, valve_folder
from spool_monitor.history.trend_writer import TrendWriter
from spool_monitor.history.valve_state import TRENDS, ValveState

from . import monitor as core
from .detectors import JUDGEMENT_TEXTS, Judgement
from .messages import to_event_message, to_health_message
from .warm_up import warm_up_monitor

_SETTINGS = (
    Parameter(
        "natural_frequency", 0.0, "Start value until it is estimated; 0: from the valve's description.",
        "Hz", 0.0, 1e3, structural=True,
    ),
    Parameter("resonance_band", 0.15, "Relative distance that counts as near resonance.", "1", 0.01, 1.0),
    Parameter("amplification_on", 1.8, "Spool over body that raises resonance.", "1", 1.0, 100.0),
    Parameter(
        "amplification_off", 1.5, "Spool over body that clears it, below amplification_on.", "1", 0.5, 100.0
    ),
    Parameter("minimum_body", 0.5, "Peak body acceleration that is judged.", "m/s^2", 0.0, 1e3),
    Parameter("viscous_change", 0.2, "Relative change that warns.", "1", 0.01, 10.0),
    Parameter("coulomb_change", 0.1, "Change of the Coulomb force that warns.", "N", 1e-4, 1e4),
    Parameter("stiffness_change", 0.1, "Relative change that warns.", "1", 0.001, 10.0),
    Parameter("gain_change", 0.1, "Relative change of a channel's gain.", "1", 0.02, 1.0),
    Parameter("offset_change", 0.5, "Change of a channel's mean.", "m/s^2", 0.01, 1e3),
    Parameter(
        "false_alarm_hours", 1000.0, "Mean time between false alarms that noise alone may cause.",
        "h", 1.0, 1e6,
    ),
    Parameter(
        "baseline_time", 15.0, "Time of valid estimates for the start values.", "s", 3.0, 1e5,
        structural=True,
    ),
    Parameter("stale_after", 1.5, "Silence that is reported.", "s", 0.2, 60.0),
)  # fmt: skip
_LIMITS = frozenset(parameter.name for parameter in _SETTINGS if not parameter.structural)

_KEEPING = (
    Parameter(
        "state_folder", "",
        "Where alarms, baseline and trends are kept, each valve in a folder of its own; empty: "
        "$XDG_STATE_HOME/spool, else ~/.local/state/spool; none: nowhere.",
        structural=True,
    ),
    Parameter(
        "latched_kinds", list(LATCHING), "Kinds of events whose alarms stay until they are reset.",
        structural=True,
    ),
)  # fmt: skip

#: s that an estimator or simulator of the same namespace may take to start: kernels of several nodes may be
#: compiled, one after the other. Once it was heard, or without one, silence is told at once.
STARTS = 180.0

_LEVELS = {
    core.Level.OK: Level.OK,
    core.Level.UNKNOWN: Level.WARNING,
    core.Level.WARNING: Level.WARNING,
    core.Level.ALARM: Level.ERROR,
    core.Level.STALE: Level.STALE,
}


class MonitorNode(ManagedNode):
    """Judge resonance, drift and silence of one valve from its blocks and estimates."""

    PARAMETERS: ClassVar = (*_SETTINGS, *_KEEPING)

    def __init__(self) -> None:
        super().__init__("monitor")
        self._core: core.Monitor | None = None
        self._desk: AlarmDesk | None = None
        self._trends: TrendWriter | None = None
        self._valve_id = self.get_namespace().strip("/")
        self._described = False
        self._activated = self._block_arrival = self._estimate_arrival = time.monotonic()
        self._level = core.Level.UNKNOWN

    def configure(self) -> None:
        """Build the core; its kernels are compiled here, not at the first sample."""
        self.compile(warm_up_monitor)
        self._core = core.Monitor(self._settings({}))
        self._described = False
        kinds = tuple(kind for kind in self.value("latched_kinds") if kind)
        warn = self.get_logger().warning
        state = ValveState(self._core, self._folder(), warn, AlarmBook(kinds))
        state.open()
        self._desk = AlarmDesk(self, state)
        if state.folder is not None:
            self._trends = TrendWriter(state.folder / TRENDS, warn, lambda: state.owned)
        self._health_publisher = self.create_lifecycle_publisher(ValveHealth, "health", qos.state())
        self._event_publisher = self.create_lifecycle_publisher(HealthEvent, "events", qos.state(depth=100))
        self._diagnostics = DiagnosticPublisher(self, self._valve_id)
        kept = "nowhere" if state.folder is None or not state.writable else f"in {state.folder}"
        self.get_logger().info(f"configured: alarms and baseline are kept {kept}")

    def activate(self) -> None:
        """Listen; estimates and the valve's description are latched, so a late start misses neither."""
        self._activated = self._block_arrival = self._estimate_arrival = time.monotonic()
        assert self._desk is not None
        self._desk.open()
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
        if self._desk is not None:
            self._desk.close()
        if self._trends is not None:
            self._trends.close()
        self._core = self._desk = self._trends = None

    def refuse_change(self, changes: dict[str, Value]) -> str | None:
        """Refuse limits that contradict each other, and kinds that there are not."""
        try:
            self._settings(changes)
        except InputError as error:
            return str(error)
        kinds = changes.get("latched_kinds", [])
        unknown = [kind for kind in kinds if kind and kind not in ALARMS] if isinstance(kinds, list) else []
        return f"latched_kinds: {unknown[0]!r} is not one of {', '.join(ALARMS)}" if unknown else None

    def apply_change(self, changes: dict[str, Value]) -> None:
        """Judge by the new limits from now on."""
        if self._core is not None and _LIMITS & set(changes):
            self._core.set_limits(self._settings({}))

    def _settings(self, changes: dict[str, Value]) -> core.MonitorSettings:
        """Return the settings with ``changes``."""
        values: dict[str, Any] = {
            parameter.name: changes.get(parameter.name, self.value(parameter.name)) for parameter in _SETTINGS
        }
        return core.MonitorSettings(**values)

    def _folder(self) -> Path | None:
        """Return where this valve's state is kept, ``None`` for nowhere."""
        given = self.value("state_folder")
        if given == "none":
            return None
        try:
            base = Path(given).expanduser() if given else default_folder()
        except RuntimeError:
            self.get_logger().warning("state_folder: there is no home folder: nothing is kept, name a folder")
            return None
        return valve_folder(base, self.get_namespace())

    def _take_description(self, message: ValveDescription) -> None:
        assert self._core is not None
        assert self._desk is not None
        self._valve_id = self._diagnostics.hardware_id = message.header.frame_id
        if not self._described:
            self._described, self._estimate_arrival = True, time.monotonic()  # the estimator begins now
        self._desk.identify(message.header.frame_id, message.oil)
        if self.value("natural_frequency") == 0.0:
            self._core.set_natural_frequency(from_description(message).natural_frequency)

    def _take_block(self, message: AccelerationBlock) -> None:
        assert self._core is not None
        gate = self._core.gate
        accepted = gate.accepted
        block = to_block(message)
        if not self._described and message.header.frame_id:
            self._valve_id = self._diagnostics.hardware_id = message.header.frame_id
        events = self._core.update(block)
        if gate.accepted > accepted:
            self._block_arrival = time.monotonic()
            if self._trends is not None:
                self._trends.update(block)
        if accepted == 0:
            self._estimate_arrival = self._block_arrival
        self._publish(events)

    def _take_estimate(self, message: ModelEstimate) -> None:
        assert self._core is not None
        self._estimate_arrival = time.monotonic()
        estimate = from_message(message)
        self._publish(self._core.update_estimate(estimate))
        assert self._desk is not None
        self._desk.take_estimate(estimate)
        if self._trends is not None:
            self._trends.update_estimate(estimate)

    def _watch(self) -> None:
        assert self._core is not None
        now = time.monotonic()
        if (
            self._core.gate.accepted == 0
            and self.count_publishers("acceleration") == 0
            and self._starts("simulator")
        ):
            self._block_arrival = now
        if self._core.estimate is None and not self._described and self._starts("estimator"):
            self._estimate_arrival = now
        stamp = self.get_clock().now().nanoseconds
        self._publish(self._core.idle(now - self._block_arrival, now - self._estimate_arrival, stamp))
        assert self._desk is not None
        self._desk.watch()

    def _starts(self, node: str) -> bool:
        """Whether ``node`` of this valve may still be starting: it compiles or is unconfigured."""
        if time.monotonic() - self._activated > STARTS:
            return False
        return (node, self.get_namespace()) in self.get_node_names_and_namespaces()

    def _publish(self, events: list[Event]) -> None:
        assert self._core is not None
        assert self._desk is not None
        if events:
            self._desk.take(events)
        for event in events:
            self._event_publisher.publish(to_event_message(event, self._valve_id))
        if events or self._core.health.level is not self._level:
            self._report()

    def _report(self) -> None:
        assert self._core is not None
        health = self._core.health
        if health.stamp == 0:  # before the first block the node's clock is all there is
            health = replace(health, stamp=self.get_clock().now().nanoseconds)
        self._level = health.level
        assert self._desk is not None
        health = replace(health, namur=max(health.namur, self._desk.namur))
        self._health_publisher.publish(to_health_message(health, self._valve_id))
        stale = health.level is core.Level.STALE
        self._diagnostics.publish(
            self._data(health.summary, stale),
            self._task("condition", ("resonance", "friction_drift", "spring_change", "stuck_spool"), stale,
                       health.dominant_frequency, health.amplification, health.natural_frequency,
                       health.viscous_drift, health.coulomb_drift),
            self._desk.status(health.namur, self._trends),
        )  # fmt: skip

    def _data(self, summary: str, stale: bool) -> Status:
        """Return what arrives, and whether the sensors can be believed."""
        assert self._core is not None
        gate = self._core.gate
        sensors = self._task("data", ("sensor_fault",), stale)
        level, text = sensors.level, sensors.message
        faults = block_faults(gate)
        if stale:
            text = summary
        elif gate.accepted == 0:
            level, text = Level.WARNING, "waiting for data"
        elif level is Level.OK:
            level, text = (Level.WARNING, faults) if faults else (level, "no block lost or refused lately")
        return Status("data", level, text, {**block_values(gate), **sensors.values})

    def _task(self, task: str, kinds: tuple[str, ...], stale: bool, *values: Quantity) -> Status:
        """Return what the detectors of ``kinds`` say; what they can't judge is said as well."""
        assert self._core is not None
        detection = self._core.detection
        ours = [one for one in detection.detectors if one.kind in kinds]
        active = [detection.conditions[one.name] for one in ours]
        active = [condition for condition in active if condition.active is not None]
        worst = max((condition.active for condition in active if condition.active is not None), default=None)
        level = {None: Level.OK, Severity.WARNING: Level.WARNING}.get(worst, Level.ERROR)
        text = ", ".join(f"{one.kind} {one.cause}".strip().replace("_", " ") for one in active)
        if not text:
            open_ = {one.judgement for one in ours if one.judgement is not Judgement.JUDGED}
            text = ", ".join(JUDGEMENT_TEXTS[judgement] for judgement in sorted(open_)) or "nothing found"
        if self._level is core.Level.UNKNOWN and not active:
            level = _LEVELS[core.Level.UNKNOWN]
        return Status(
            task,
            Level.STALE if stale else level,
            "no data" if stale else text,
            {
                **{key(value.name, value.unit): value.value for value in values},
                **{f"{one.name}_judgement": JUDGEMENT_TEXTS[one.judgement] for one in ours},
            },
        )


def main() -> int:
    """Run the node."""
    return run(MonitorNode)


if __name__ == "__main__":
    sys.exit(main())
