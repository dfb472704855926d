"""Node ``estimator``: identifies the model of one valve from its acceleration blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

from sensor_msgs.msg import Temperature
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.events.language import Language
from spool_core.events.sentences import language_of
from spool_core.node import messages, qos
from spool_core.node.block_hub import Silence, Throttle
from spool_core.node.diagnostics import DiagnosticPublisher, Level, Status, block_faults, block_values, key
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import LANGUAGE, NodeParameter
from spool_core.uncertainty import Quantity, Validity
from spool_msgs.msg import GapAnalysis, HealthEvent, ModelEstimate, ValveDescription, WindowRefit
from spool_sim.model import Model, load_model
from spool_sim.valve import Valve, find_valve
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, phase_of, settings_for
from spool_estimator.gap_watch import GapTask, GapWatch, GapWorker, RecentBlocks
from spool_estimator.messages import to_description, to_message, to_refit_message
from spool_estimator.plausibility import ValveCheck
from spool_estimator.refit import RefitSettings, RefitWorker, WindowRefits
from spool_estimator.warm_up import warm_up_estimator

#: Names and units of what is reported of an estimate, whether or not it is known yet.
_TOLD = (
    ("spring_stiffness", "N/m"),
    ("viscous_coefficient", "N s/m"),
    ("coulomb_force", "N"),
    ("oil_temperature", "deg C"),
)

#: s between two looks at what arrives: chosen, silence is noticed later by that.
LOOK = 0.25

#: Events that late joiners get.
KEPT_EVENTS = 100


class EstimatorNode(ManagedNode):
    """Node ``estimator``: identifies the model of one valve from its acceleration blocks."""

    PARAMETERS: ClassVar = (
        NodeParameter(
            "valve_file", "4weh10_soft", "Path of a YAML file or name of a shipped valve.", structural=True,
        ),
        NodeParameter(
            "memory", 4.0, "Time constant of forgetting.", "s", 0.2, 3600.0, structural=True,
        ),
        NodeParameter("low_cut", 4.0, "Lower edge of the band.", "Hz", 0.1, 100.0, structural=True),
        NodeParameter("high_cut", 300.0, "Upper edge of the band.", "Hz", 10.0, 1e4, structural=True),
        NodeParameter(
            "minimum_excitation", 0.2, "Rms body acceleration below which parameters are held.",
            "m/s^2", 0.0, 1e3, structural=True,
        ),
        NodeParameter(
            "period", 1.0, "Time between estimates, in data time.", "s", 0.1, 60.0, structural=True
        ),
        NodeParameter(
            "stale_after", 1.5, "Silence after which the estimate is stale.", "s", 0.2, 60.0,
        ),
        NodeParameter(
            "refit_period", 0.0, "Data time between refits, 0: none.", "s", 0.0, 3.6e3, structural=True,
        ),
        NodeParameter("refit_window", 4.0, "Length of the refitted window.", "s", 2.0, 60.0, structural=True),
        NodeParameter("refit_model", "coulomb", "Name of a model or path of a YAML file.", structural=True),
        NodeParameter(
            "gap_growth", 2.0, "Residual over its median from which model_gap is raised.",
            "1", 1.1, 100.0, structural=True,
        ),
        NodeParameter(
            "gap_window", 60.0, "How far ~/analyse_gap looks back.", "s", 6.0, 600.0, structural=True,
        ),
        NodeParameter(
            "gap_base", "fluid", "Model that ~/analyse_gap adds to: name or YAML file.", structural=True,
        ),
        NodeParameter(
            "command_topic", "", "Machine's topic with the solenoid's command; empty: none.", structural=True
        ),
        NodeParameter("command_type", "std_msgs/msg/Float64", "Its message type.", structural=True),
        NodeParameter(
            "command_field", "data", "Its field, e.g. currents[2] or valves[0].current.", structural=True
        ),
        LANGUAGE,
    )  # fmt: skip

    def __init__(self, namespace: str | None = None, **options: Any) -> None:
        super().__init__("estimator", namespace, **options)
        self._core: Estimator | None = None
        self._gate = BlockGate()
        self._refits: WindowRefits | None = None
        self._worker: RefitWorker | None = None
        self._check: ValveCheck | None = None
        self._doubts: list[str] = []
        self._silence = Silence(2.0 * LOOK)
        self._reported = (Level.OK, 0)
        self._throttle = Throttle()
        self._relay: Any = None
        self._told: float | None = None

    def configure(self) -> None:
        """Build the core and say which valve it is for."""
        # Compiling takes seconds where the cache is old or can't be written: blocks would be lost meanwhile.
        self.compile(warm_up_estimator)
        valve = find_valve(self.value("valve_file"))
        names = ("memory", "low_cut", "high_cut", "minimum_excitation", "period")
        settings = settings_for(
            valve, phase=phase_of(self.get_namespace()), **{name: self.value(name) for name in names}
        )
        self._core = Estimator(settings)
        self._gate = self._core.gate
        self._valve_id = valve.id
        self._publisher = self.create_lifecycle_publisher(ModelEstimate, "estimate", qos.state())
        self._description_publisher = self.create_lifecycle_publisher(ValveDescription, "valve", qos.state())
        self._description = to_description(valve)
        if self.value("command_topic"):
            self._machine = messages.type_with(self.value("command_type"), self.value("command_field"))
            self._relay = self.create_lifecycle_publisher(Float64, "command", qos.samples_offered(50.0))
        self._check, self._doubts = ValveCheck(valve), []
        model = load_model(self.value("refit_model"))
        model.values_for(valve)
        if self.value("refit_period") > 0.0:
            refits = RefitSettings(valve, model, self.value("refit_period"), self.value("refit_window"))
            self._refits = WindowRefits(refits)
            self._worker = RefitWorker(refits)
            self._refit_publisher = self.create_lifecycle_publisher(WindowRefit, "refit", qos.state())
        base = load_model(self.value("gap_base"))
        base.values_for(valve)
        window, growth = self.value("gap_window"), self.value("gap_growth")
        language = language_of(self.value(LANGUAGE.name))
        self._gap = GapService(self, valve, base, language, window=window, growth=growth)
        self._diagnostics = DiagnosticPublisher(self, valve.id)
        self.get_logger().info(
            f"configured for valve {valve.id} ({self.value('valve_file')}): {1e3 * valve.moving_mass:g} g, "
            f"{valve.natural_frequency:.1f} Hz"
        )

    def activate(self) -> None:
        """Listen; the core goes on from where it was."""
        self._silence.end()
        self._gate.resume()
        self._description.header.stamp = self.get_clock().now().to_msg()
        self._description_publisher.publish(self._description)
        self.subscribe_blocks("acceleration", self._take, self._room)
        self.subscribe(Temperature, "oil_temperature", self._take_temperature, qos.samples_wanted())
        self.subscribe(Float64, "command", self._take_command, qos.samples_wanted())
        if self._relay is not None:
            self.subscribe(
                self._machine, self.value("command_topic"), self._pass_command, qos.samples_wanted()
            )
        if self._worker is not None:
            self.every(0.05, self._collect, steady=True)
        self._gap.open()
        self.every(LOOK, self._watch, steady=True)
        self.every(1.0, self._report, steady=True)

    def deactivate(self) -> None:
        """Publish that nothing is estimated: the last level would stay."""
        self._diagnostics.rest("inactive: nothing is estimated")

    def cleanup(self) -> None:
        """Release core and publishers."""
        self.destroy_publisher(self._publisher)
        self.destroy_publisher(self._description_publisher)
        if self._relay is not None:
            self.destroy_publisher(self._relay)
            self._relay = self._told = None
        self._diagnostics.destroy()
        self._gap.close()
        if self._worker is not None:
            self._worker.close()
            self.destroy_publisher(self._refit_publisher)
        self._core = self._refits = self._worker = None

    def _room(self) -> int:
        """Return the samples until an estimate falls due, with which nothing waits."""
        return self._core.lacking if self._core is not None else 0

    def _take(self, blocks: Sequence[Block]) -> None:
        gate = self._gate
        for block, verdict in gate.admitted(blocks, self._room):
            assert self._core is not None
            estimates = self._core.update(block, verdict)
            if verdict is not Verdict.REFUSED:
                self._silence.end()
                self._gap.take(block, verdict, estimates)
            for estimate in estimates:
                self._publisher.publish(to_message(estimate, self._valve_id))
                if self._check is not None and not self._check.complete:
                    self._check.update(estimate)
                    before, self._doubts = self._doubts, self._check.doubts()
                    if self._doubts and not before:  # valve file and record contradict: said once
                        self.get_logger().warning("; ".join(self._doubts))
            if self._refits is not None and self._worker is not None:
                for task in self._refits.update(block, verdict, estimates):
                    self._worker.offer(task)
            if verdict is Verdict.REFUSED and gate.fault is not None:
                reason = gate.fault.value
                count = self._throttle.take(reason)
                if count:
                    told = "block" if count == 1 else f"{count} blocks, the last one"
                    self.get_logger().warning(f"{told} {block.sequence} refused: {reason}")

    def _collect(self) -> None:
        assert self._worker is not None
        found = self._worker.collect()
        if found is not None:
            done, skipped = self._worker.done, self._worker.skipped
            message = to_refit_message(found, self._valve_id, refits=done, skipped=skipped)
            self._refit_publisher.publish(message)

    def _take_command(self, message: Float64) -> None:
        """Take the solenoid's command, which has no stamp: it holds at the end of the newest block."""
        if self._core is not None and self._gate.last is not None:
            self._core.strokes.take_command(self._gate.last.end, message.data)

    def _pass_command(self, message: Any) -> None:
        """Send the command in a message of the machine to all that take it, this node among them."""
        topic, field = self.value("command_topic"), self.value("command_field")
        try:
            value = messages.number_of(message, field)
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            if count := self._throttle.take("command"):
                self.get_logger().warning(f"{topic}: {count} messages without the number {field}: {error}")
            return
        if value != self._told:
            self._told = value
            self._relay.publish(Float64(data=value))

    def _take_temperature(self, message: Temperature) -> None:
        assert self._core is not None
        deviation = math.sqrt(message.variance) if message.variance > 0.0 else math.nan
        stamp = messages.nanoseconds(message.header.stamp)
        self._core.update_temperature(stamp, message.temperature, deviation)

    def _watch(self) -> None:
        """Publish once that the estimate is held, an analysis that is done, and another level immediately."""
        assert self._core is not None
        self._gap.collect()
        latest = self._core.latest
        self._silence.look()
        if self.host.hub.waits(self, "acceleration"):
            self._silence.end()
        if self._silent and latest is not None and latest.state is not State.STALE:
            stale = self._core.stale()
            assert stale is not None
            self._core.latest = stale
            self._publisher.publish(to_message(stale, self._valve_id))
        if (self._level(), self._core.gate.refused) != self._reported:
            self._report()

    @property
    def _silent(self) -> bool:
        """Whether no blocks arrive. The monitor alone judges it: it knows what is out of service."""
        return bool(self._silence.seconds > self.value("stale_after"))

    def _level(self) -> Level:
        assert self._core is not None
        gate = self._core.gate
        well = not self._silent and gate.accepted and not block_faults(gate) and not self._doubts
        return Level.OK if well else Level.WARNING

    def _report(self) -> None:
        assert self._core is not None
        gate = self._core.gate
        latest: Estimate | None = self._core.latest
        level = self._level()
        self._reported = (level, gate.refused)
        if self._silent:
            message = "no usable blocks arrive"
        elif level is Level.WARNING:
            message = block_faults(gate) or "; ".join(self._doubts) or "waiting for data"
        else:
            message = latest.state.name.lower().replace("_", " ") if latest else "no estimate yet"
        values = block_values(gate)
        if self._worker is not None:
            values["refits_done"] = self._worker.done
            values["refits_skipped"] = self._worker.skipped
        told = {one.name: one.value for one in (*latest.parameters, latest.oil_temperature)} if latest else {}
        for name, unit in _TOLD:
            values[key(name, unit)] = told.get(name, math.nan)
        self._diagnostics.publish(Status("estimate", level, message, values))


class GapService:
    """Topics ``events`` and ``gap`` and service ``~/analyse_gap`` of one valve's model gap."""

    def __init__(
        self, node: Any, valve: Valve, base: Model, language: Language, *, window: float, growth: float
    ) -> None:
        """Make publishers and service.

        Args:
            node: a managed node.
            valve: that is listened to.
            base: model that effects are added to.
            language: of the events' sentences.
            window: s that an analysis looks back.
            growth: residual over its median from which the event is raised.
        """
        self._node, self._valve, self._base, self._language = node, valve, base, language
        self._watch = GapWatch(growth)
        self._recent = RecentBlocks(window)
        self._worker = GapWorker()
        self._events = node.create_lifecycle_publisher(HealthEvent, "events", qos.state(KEPT_EVENTS))
        self._answers = node.create_lifecycle_publisher(GapAnalysis, "gap", qos.state())
        node.serve(Trigger, "~/analyse_gap", self._answer)

    def open(self) -> None:
        """Listen to the valve's events."""
        self._node.subscribe(HealthEvent, "events", self._hear, qos.state(KEPT_EVENTS))

    def take(self, block: Block, verdict: Verdict, estimates: list[Estimate]) -> None:
        """Keep ``block``, which the gate did not refuse, and judge ``estimates``."""
        self._recent.take(block, verdict)
        self._watch.take(block)
        for estimate in estimates:
            event = self._watch.update(estimate)
            if event is not None:
                self._events.publish(messages.to_event_message(event, self._valve.id, self._language))

    def _hear(self, event: HealthEvent) -> None:
        raised = event.state == HealthEvent.STATE_RAISED
        self._watch.hear(event.kind, event.source or event.cause, raised=raised)

    def _answer(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Begin an analysis of what is kept; its result comes on ``gap``."""
        records = self._recent.records(self._valve.id)
        task = GapTask(records, self._valve, self._base, self._recent.stamp)
        response.success = bool(records) and self._worker.offer(task)
        begun = f"analysing {task.seconds:.1f} s; the result comes on gap"
        refused = "an analysis is under way" if records else "no samples have arrived yet"
        response.message = begun if response.success else refused
        return response

    def collect(self) -> None:
        """Publish the analysis that was finished since, if any."""
        answer = self._worker.collect()
        if answer is None:
            return
        validity = Validity.VALID if answer.done else Validity.UNKNOWN
        message = GapAnalysis(
            state=GapAnalysis.STATE_DONE if answer.done else GapAnalysis.STATE_FAILED,
            verdict=answer.verdict,
            confidence=messages.to_quantity(
                Quantity("confidence", "1", answer.confidence, validity=validity)
            ),
            sentence=answer.sentence,
            window=answer.duration,
            json=answer.json,
        )
        message.header.frame_id = self._valve.id
        message.header.stamp = messages.to_time(answer.stamp)
        self._answers.publish(message)

    def close(self) -> None:
        """End the worker and release the publishers."""
        self._worker.close()
        self._node.destroy_publisher(self._events)
        self._node.destroy_publisher(self._answers)
