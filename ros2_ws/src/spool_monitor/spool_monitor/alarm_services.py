"""Alarm services of the monitor node: what operators do, and the topic that shows them the alarms."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from spool_core.errors import InputError
from spool_core.events.language import Language
from spool_core.events.sentences import headline
from spool_core.node import qos
from spool_core.node.block_hub import waiting_for_disk
from spool_core.node.diagnostics import Level, Status
from spool_core.node.managed_node import ManagedNode
from spool_core.node.messages import to_quantity
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate
from spool_msgs.msg import AlarmList
from spool_msgs.srv import AcknowledgeAlarm, ManageBaseline, ResetAlarms, ShelveAlarm, SuppressAlarm

from spool_monitor.alarm import Action, Alarm, AlarmRefusedError, AlarmState, Operator, Transition
from spool_monitor.event import Event, Namur, Severity
from spool_monitor.messages import to_alarm_list
from spool_monitor.trend_writer import TrendWriter
from spool_monitor.valve_state import ValveState


class AlarmServices:
    """Alarm services of one monitor: what operators do, the latched topic ``alarms``, and what is kept.

    A change is on the disk before it is published or answered.
    """

    def __init__(self, node: ManagedNode, state: ValveState, language: Language) -> None:
        self._node = node
        self._language = language
        self._state = state
        self.valve_id = node.get_namespace().strip("/")
        self._publisher = node.create_lifecycle_publisher(AlarmList, "alarms", qos.state())

    def open(self) -> None:
        """Offer the services while the node is active, and show what there is."""
        for kind, name, answer in (
            (AcknowledgeAlarm, "acknowledge_alarm", self._acknowledge),
            (ShelveAlarm, "shelve_alarm", self._shelve),
            (SuppressAlarm, "suppress_alarm", self._suppress),
            (ResetAlarms, "reset_alarms", self._reset),
            (ManageBaseline, "manage_baseline", self._baseline),
        ):
            self._node.serve(kind, f"~/{name}", answer)
        self._publish()

    def close(self) -> None:
        """Take the publisher away."""
        self._node.destroy_publisher(self._publisher)
        self._state.close()

    def identify(self, valve_id: str, oil: str) -> None:
        """Take note of which valve it is; its kept baseline is taken up."""
        self.valve_id = valve_id
        try:
            if self._state.baseline.identify(valve_id, oil):
                current = self._state.baseline.current
                assert current is not None
                self._node.get_logger().info(
                    f"baseline version {current.version} ({current.stage.value}) is compared with"
                )
        except InputError as error:
            self._node.get_logger().warning(f"{error}; learning")

    def take(self, events: Sequence[Event]) -> None:
        """Take the monitor's events; each is logged once."""
        transitions = [self._state.alarms.update(event) for event in events]
        self._settle(transitions)
        for event, transition in zip(events, transitions, strict=True):
            if not transition.changed or Action.ANNOUNCE not in transition.actions:
                self._node.get_logger().info(
                    f"{transition.after.name} {event.state.name.lower()}: {headline(event, self._language)}"
                )

    def take_estimate(self, estimate: Estimate) -> None:
        """Take an estimate that the monitor has seen."""
        before = self._state.baseline.current
        if not self._state.baseline.update(estimate):
            return
        with waiting_for_disk():
            self._state.keep_baseline()
        current = self._state.baseline.current
        assert current is not None
        if before is None:  # what takes longer to learn joins the same version later
            self._node.get_logger().info(f"baseline version {current.version} of {current.valve_id} learned")

    @property
    def namur(self) -> Namur:
        """Status after NE 107 as far as maintenance makes it."""
        serviced = any(alarm.out_of_service for alarm in self._state.alarms.alarms.values())
        return Namur.FUNCTION_CHECK if serviced else Namur.UNKNOWN

    def status(self, namur: Namur, trends: TrendWriter | None) -> Status:
        """Return what ``/diagnostics`` shows of the alarms: what is put aside does not raise its level."""
        alarms = self._state.alarms.alarms.values()
        shown = [alarm for alarm in self._state.alarms.shown if not alarm.hidden]
        waiting = [alarm for alarm in shown if not alarm.acknowledged]
        states = [alarm.state for alarm in alarms]
        level = Level.WARNING if shown else Level.OK
        if any(alarm.active and alarm.severity is Severity.ALARM for alarm in shown):
            level = Level.ERROR
        names = ", ".join(alarm.name for alarm in waiting or shown)
        text = f"waiting for an operator: {names}" if waiting else names or "none"
        current = self._state.baseline.current
        values: dict[str, object] = {
            "ne_107": f"{namur.letter} {namur.name.lower().replace('_', ' ')}".strip(),
            "active": sum(alarm.active for alarm in shown),
            "waiting": len(waiting),
            "latched": sum(alarm.latched for alarm in shown),
            "shelved": states.count(AlarmState.SHELVED),
            "suppressed": states.count(AlarmState.SUPPRESSED),
            "out_of_service": states.count(AlarmState.OUT_OF_SERVICE),
            "baseline": f"version {current.version} {current.stage.value}" if current else "learning",
            "kept_over_a_restart": "yes" if self._state.writable else "no",
        }
        trouble = trends.trouble if trends is not None else ""
        held = f"held in memory: {trouble}" if trouble else "kept"
        values["trends"] = "none" if trends is None else held
        values["travel_m"] = math.nan if trends is None else trends.travel.travel
        values["reversals"] = math.nan if trends is None else trends.travel.reversals
        return Status("alarms", level, text, values)

    def watch(self) -> None:
        """End the shelves that are due, and bring to the disk what could not be written."""
        self._settle(self._state.alarms.advance(self._now()))
        self._state.retry(self._now())

    def _settle(self, transitions: Sequence[Transition]) -> None:
        if not any(transition.changed for transition in transitions):
            return
        with waiting_for_disk():
            self._state.keep_alarms()
        self._publish()
        for transition in transitions:
            if Action.ANNOUNCE in transition.actions:
                self._announce(transition.after)

    def _announce(self, alarm: Alarm) -> None:
        """Log an alarm: as an error where the valve or its measurement has failed (NE 107: F)."""
        said = headline(alarm.event, self._language) if alarm.event is not None else ""
        text = f"{alarm.severity.name.lower()} {alarm.code} {alarm.name}: {said}"
        # A line each: rclpy lets a line of code log in one severity only.
        if alarm.namur is Namur.FAILURE:
            self._node.get_logger().error(text)
        else:
            self._node.get_logger().warning(text)

    def _publish(self) -> None:
        alarms = self._state.alarms
        shown = alarms.shown
        names = {alarm.name for alarm in shown}
        rest = [alarm for name, alarm in alarms.alarms.items() if name not in names]
        self._publisher.publish(to_alarm_list([*shown, *rest], self._now(), self.valve_id, self._language))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    # Services.

    def _operator(self, request: Any) -> Operator:
        return Operator(request.who, self._now(), request.comment)

    def _answer(self, response: Any, transitions: Sequence[Transition], operator: Operator) -> Any:
        self._settle(transitions)
        response.success = True
        response.changed = [transition.after.name for transition in transitions]
        done = f"{transitions[0].input.value}: {', '.join(response.changed)}, by {operator.who}"
        self._node.get_logger().info(done)
        return response

    def _acknowledge(self, request: Any, response: Any) -> Any:
        operator = self._operator(request)
        changed = self._state.alarms.acknowledge(request.alarm, operator, request.occurrence)
        return self._answer(response, changed, operator)

    def _shelve(self, request: Any, response: Any) -> Any:
        operator, alarms = self._operator(request), self._state.alarms
        if request.shelved:
            changed = alarms.shelve(request.alarm, operator, request.duration)
        else:
            changed = alarms.unshelve(request.alarm, operator)
        return self._answer(response, changed, operator)

    def _suppress(self, request: Any, response: Any) -> Any:
        operator, alarms = self._operator(request), self._state.alarms
        ways: dict[int, Callable[..., list[Transition]]] = {
            SuppressAlarm.Request.BY_DESIGN: alarms.suppress,
            SuppressAlarm.Request.OUT_OF_SERVICE: alarms.maintain,
        }
        if request.way not in ways:
            raise AlarmRefusedError(f"way: {request.way} is not one of {sorted(ways)}")
        changed = ways[request.way](request.alarm, operator, on=request.suppressed)
        return self._answer(response, changed, operator)

    def _reset(self, request: Any, response: Any) -> Any:
        operator = self._operator(request)
        return self._answer(response, self._state.alarms.reset(request.alarm, operator), operator)

    def _baseline(self, request: Any, response: Any) -> Any:
        keeper = self._state.baseline
        actions: dict[int, Callable[[Operator], object]] = {
            request.LEARN: lambda _: keeper.learn(),
            request.FREEZE: keeper.freeze,
            request.RESTORE: lambda _: keeper.restore(request.version),
        }
        if request.action in actions:
            operator = self._operator(request)
            actions[request.action](operator)
            self._state.keep_baseline()
            done = {
                request.LEARN: "learning again",
                request.FREEZE: "frozen",
                request.RESTORE: f"version {request.version} restored",
            }[request.action]
            comment = f" ({request.comment.strip()})" if request.comment.strip() else ""
            self._node.get_logger().info(f"baseline changed by {operator.who}: {done}{comment}")
        elif request.action != request.SHOW:
            raise AlarmRefusedError(f"action: {request.action} is not one of 0 to {request.RESTORE}")
        response.success = True
        response.stage = "learning"
        current = keeper.current
        if current is not None:
            response.version, response.stage = current.version, current.stage.value
            response.valve_id, response.oil = current.valve_id, current.oil
            response.temperature = list(current.temperature)
            response.frozen_by = current.who
            response.counts = [value.count for value in current.values]
            response.values = [
                to_quantity(
                    Quantity(value.name, value.unit, value.value, value.standard_deviation, Validity.VALID)
                )
                for value in current.values
            ]
        return response
