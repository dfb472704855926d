"""Node ``simulator``: publishes what two accelerometers on a simulated valve would measure."""

from __future__ import annotations

import time
from typing import Any, ClassVar

from sensor_msgs.msg import Temperature
from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.block_hub import BlockPublisher, Throttle
from spool_core.node.diagnostics import DiagnosticPublisher, Level, Status, key
from spool_core.node.managed_node import ManagedNode
from spool_core.node.messages import from_block, to_time
from spool_core.node.parameters import NodeParameter, Value
from spool_core.text import plural
from spool_msgs.msg import AccelerationBlocks
from std_msgs.msg import Float64

from spool_sim.excitation import load_excitation
from spool_sim.observation import Observation
from spool_sim.sensors import Sensor
from spool_sim.simulator import DRIFTING, Simulator
from spool_sim.strokes import Strokes
from spool_sim.valve import find_valve

#: Blocks sent in one turn when the node fell behind: half a second of 50 a second. Older ones are dropped.
_CATCH_UP = 25

#: Hz at which the speed of a machine is sent.
SPEED_RATE = 10.0

#: s, for which those that are waited for are seen before the first block: one that is seen by us may not have
#: seen us yet, and drops what it gets until then.
_KNOWN = 0.5


class Outlet:
    """Topics of one simulated valve beside its blocks, below ``prefix``."""

    def __init__(self, node: ManagedNode, prefix: str) -> None:
        samples = qos.samples_offered(SPEED_RATE)
        self.thermometer, self.tachometer, self.commander = (
            node.create_lifecycle_publisher(kind, f"{prefix}{name}", samples)
            for kind, name in ((Temperature, "oil_temperature"), (Float64, "speed"), (Float64, "command"))
        )
        self._command = 0.0

    def publish(self, simulator: Simulator, started: int, each_second: bool, each_speed: bool) -> None:
        """Send what is due before the next block of ``simulator``, which started at ``started`` (ns)."""
        valve, command = simulator.valve, simulator.command
        if each_second and valve.oil is not None:
            message = Temperature(temperature=simulator.truth.oil_temperature)
            message.header.frame_id = valve.id
            message.header.stamp = to_time(simulator.stamp)
            self.thermometer.publish(message)
        rpm = simulator.excitation.speed((simulator.stamp - started) * 1e-9)
        if rpm is not None and each_speed:
            self.tachometer.publish(Float64(data=rpm))
        if simulator.strokes is not None and (command != self._command or each_second):
            self.commander.publish(Float64(data=command))
            self._command = command


class SimulatorNode(ManagedNode):
    """Publish ``acceleration``, or ``/accelerations`` of many valves, at the pace of the node's clock."""

    PARAMETERS: ClassVar = (
        NodeParameter(
            "valve_file", "4weh10_soft", "Valve: path of a YAML file, or a shipped name.", structural=True
        ),
        NodeParameter("model", "coulomb", "Force terms: name of a model or a YAML file.", structural=True),
        NodeParameter(
            "coulomb_force", 0.1, "Coulomb friction of the model 'coulomb'; others bring their own values.",
            "N", 0.0, 1e4, structural=True,
        ),
        NodeParameter(
            "excitation", "orders", "Body acceleration: a preset's name or a YAML file.", structural=True
        ),
        NodeParameter("sample_rate", 2000.0, "Samples a second.", "Hz", 10.0, 1e5, structural=True),
        NodeParameter("block_rate", 50.0, "Blocks a second.", "Hz", 0.1, 1000.0, structural=True),
        NodeParameter(
            "noise", 0.05, "Noise of both accelerometers, rms.", "m/s^2", 0.0, 1e3, structural=True
        ),
        NodeParameter(
            "filter",
            "instants",
            "Filter of both channels before sampling: instants, mean, linear, causal.",
            structural=True,
        ),
        NodeParameter("body_gain_error", 0.0, "Relative gain error, body.", "1", -0.5, 0.5, structural=True),
        NodeParameter(
            "spool_gain_error", 0.0, "Relative gain error, spool.", "1", -0.5, 0.5, structural=True
        ),
        NodeParameter("seed", 0, "Seed of the noise.", "", 0, 2**31 - 1, structural=True),
        NodeParameter(
            "valves", 0, "Number of valves, valve_1 and so on, in one message; 0: the node's own valve.", "",
            0, 1000, structural=True,
        ),
        NodeParameter(
            "stroke_period", 0.0, "Time between two strokes of the solenoid, 0: none.", "s", 0.0, 1e5,
            structural=True,
        ),
        NodeParameter("stroke_hold", 0.5, "Time for which it holds.", "s", 0.01, 1e5, structural=True),
        NodeParameter("stroke_force", 20.0, "Force of the solenoid.", "N", 0.1, 1e4, structural=True),
        NodeParameter(
            "wait_for_subscribers", 0, "Number of subscribers to wait for before the first block.", "", 0,
            100, structural=True,
        ),
        NodeParameter(
            "drift_quantity", "none", "Parameter that drifts; changing it starts.",
            choices=("none", *DRIFTING),
        ),
        NodeParameter("drift_target", 0.0, "Final value of the parameter, SI unit or deg C.", "", -40.0, 1e8),
        NodeParameter("drift_duration", 10.0, "Duration of the drift; 0: a step.", "s", 0.0, 1e6),
    )  # fmt: skip

    def __init__(self, namespace: str | None = None, **options: Any) -> None:
        super().__init__("simulator", namespace, **options)
        self._simulators: list[Simulator] = []
        self._started: int | None = None
        self._last_turn = 0
        self._complete: float | None = None
        self._sent = 0
        self._skipped = self._told = 0
        self._throttle = Throttle()

    def configure(self) -> None:
        """Build the valve, the excitation and the sensors from the parameters."""
        self.compile(self._compile_motion)
        self._simulators = self._build(start_stamp=1)
        rate, count = self.value("block_rate"), self.value("valves")
        if count and self.host.hub.worker is not None:
            raise InputError("valves: the simulators of a host send one valve each; set it to 0")
        self._single = None if count else BlockPublisher(self, "acceleration", rate)
        if count:
            self._shared = self.create_lifecycle_publisher(
                AccelerationBlocks, "/accelerations", qos.samples_offered(rate)
            )
        self._names = [f"valve_{number + 1}" for number in range(count)]
        self._outlets = [Outlet(self, f"/{name}/") for name in self._names] or [Outlet(self, "")]
        self._diagnostics = DiagnosticPublisher(self, self._simulators[0].valve.id)
        self.get_logger().info(
            f"configured: valve {self._simulators[0].valve.id} ({self.value('valve_file')}), "
            f"model {self.value('model')}, excitation {self.value('excitation')}"
        )

    def activate(self) -> None:
        """Start at time zero of the excitation, stamped with the node's clock."""
        self._started = None
        self._last_turn = 0
        self._sent = self._skipped = self._told = 0
        self.every(0.5 / self.value("block_rate"), self._turn)
        self.every(1.0, self._report, steady=True)

    def deactivate(self) -> None:
        """Report that no blocks are sent, by order."""
        self._diagnostics.rest("inactive: no blocks are sent")

    def cleanup(self) -> None:
        """Release publisher and valve."""
        if self._single is not None:
            self._single.destroy()
        else:
            self.destroy_publisher(self._shared)
        for outlet in self._outlets:
            for publisher in (outlet.thermometer, outlet.tachometer, outlet.commander):
                self.destroy_publisher(publisher)
        self._diagnostics.destroy()
        self._simulators = []

    def refuse_change(self, changes: dict[str, Value]) -> str | None:
        """Try the drift on a separate simulator."""
        if not self._simulators or "drift_quantity" not in changes:
            return None
        try:
            self._drift(self._build(start_stamp=1), changes)
        except InputError as error:
            return str(error)
        return None

    def apply_change(self, changes: dict[str, Value]) -> None:
        """Start the drift that the parameters describe; its target and duration alone start none."""
        if "drift_quantity" in changes:
            self._drift(self._simulators, changes)

    def _drift(self, simulators: list[Simulator], changes: dict[str, Value]) -> None:
        def setting(name: str) -> Any:
            return changes.get(name, self.value(name))

        name, target, duration = map(setting, ("drift_quantity", "drift_target", "drift_duration"))
        if name != "none":
            for simulator in simulators:
                simulator.set_drift(str(name), float(target), float(duration))

    def _build(self, start_stamp: int) -> list[Simulator]:
        """Return the valves' simulators, which differ in their noise."""
        sample_rate = self.value("sample_rate")
        block_size = round(sample_rate / self.value("block_rate"))
        if block_size < 1:
            raise InputError("block_rate: more blocks than samples a second; lower it or raise sample_rate")
        period, hold = self.value("stroke_period"), self.value("stroke_hold")
        if 0.0 < period <= hold:
            raise InputError("stroke_hold: longer than stroke_period; lower it or raise stroke_period")
        strokes = None
        if period:
            strokes = Strokes(period=period, first=period, hold=hold, force=self.value("stroke_force"))
        valve, excitation = find_valve(self.value("valve_file")), load_excitation(self.value("excitation"))
        alike = {"filter": Observation.of(self.value("filter")), "noise": self.value("noise")}
        body, spool = (
            Sensor(gain_error=self.value(f"{one}_gain_error"), **alike) for one in ("body", "spool")
        )
        return [
            Simulator(
                valve,
                excitation,
                model=self.value("model"),
                coulomb_force=self.value("coulomb_force") if self.value("model") == "coulomb" else None,
                sample_rate=sample_rate,
                block_size=block_size,
                seed=self.value("seed") + number,
                start_stamp=start_stamp,
                body_sensor=body,
                spool_sensor=spool,
                strokes=strokes,
            )
            for number in range(max(1, self.value("valves")))
        ]

    def _compile_motion(self) -> None:
        self._build(start_stamp=1)[0].next_block()

    def _heard(self) -> bool:
        """Return whether as many listen as are waited for, and have for a while."""
        wanted, single = self.value("wait_for_subscribers"), self._single
        listeners = single.listeners if single is not None else self._shared.get_subscription_count()
        if listeners < wanted:
            self._complete = None
            return False
        if self._complete is None:
            self._complete = time.monotonic()
        return bool(wanted == 0 or time.monotonic() - self._complete >= _KNOWN)

    def _turn(self) -> None:
        now = self.get_clock().now().nanoseconds
        if now == 0:  # simulated time has not begun
            return
        back, self._last_turn = now < self._last_turn, now
        if self._started is None or back:
            self._started = None
            if not self._heard():
                return
            self._started = now
            self._simulators = self._build(start_stamp=now)
            self._drift(self._simulators, {})
            self._sent = 0
        rate = self.value("block_rate")
        due = int((now - self._started) * 1e-9 * rate) - self._sent
        while due > 0:
            each_second = self._sent % max(1, round(rate)) == 0
            each_speed = self._sent % max(1, round(rate / SPEED_RATE)) == 0
            for simulator, outlet in zip(self._simulators, self._outlets, strict=True):
                outlet.publish(simulator, self._started, each_second, each_speed)
            blocks = [one.next_block() for one in self._simulators]
            self._sent += 1
            due -= 1
            if due >= _CATCH_UP:
                self._skipped += 1
                count = self._throttle.take("dropped")
                if count:
                    self.get_logger().warning(f"{plural(count, 'block')} dropped: the machine is too slow")
                continue
            valve = self._simulators[0].valve.id
            if self._single is not None:
                self._single.publish(blocks[0], valve)
            else:
                messages = [from_block(block, valve) for block in blocks]
                self._shared.publish(AccelerationBlocks(names=self._names, blocks=messages))

    def _report(self) -> None:
        waiting = self._started is None
        message = "waiting for subscribers or time" if waiting else "publishing"
        dropped, self._told = self._skipped - self._told, self._skipped
        if dropped:
            message = f"{plural(dropped, 'block')} dropped in the last second: the machine is too slow"
        level = Level.WARNING if waiting or dropped else Level.OK
        truth = self._simulators[0].truth
        values = {
            "blocks_sent": self._sent - self._skipped,
            "blocks_dropped": self._skipped,
            key("viscous_coefficient", "N s/m"): truth.viscous_coefficient,
            key("coulomb_force", "N"): truth.coulomb_force,
            key("spring_stiffness", "N/m"): truth.spring_stiffness,
        }
        self._diagnostics.publish(Status("simulation", level, message, values))
