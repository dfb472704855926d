"""Model gap in the node ``estimator``: its event, and its analysis on request.

The node hands over what it hears; this holds the topics ``events`` and ``gap`` and the service
``~/analyse_gap``.
"""

from __future__ import annotations

from typing import Any

from spool_core.block import Block
from spool_core.node import qos
from spool_core.node.messages import to_quantity, to_time
from spool_core.uncertainty import Quantity, Validity
from spool_msgs.msg import GapAnalysis, HealthEvent
from spool_sim.model import Model
from spool_sim.valve.description import Valve
from std_srvs.srv import Trigger

from spool_estimator.estimate import Estimate
from spool_estimator.gap_requests.gap_watch import MODEL_GAP, MODEL_GAP_CODE, GapChange, GapWatch
from spool_estimator.gap_requests.gap_worker import GapAnswer, GapTask, GapWorker, RecentBlocks

#: Events that late joiners get.
KEPT_EVENTS = 100


class GapService:
    """Events and analyses of one valve's model gap."""

    def __init__(self, node: Any, valve: Valve, base: Model, *, window: float, growth: float) -> None:
        """Make the publishers.

        Args:
            node: a managed node.
            valve: that is listened to.
            base: model that effects are added to.
            window: s that an analysis looks back.
            growth: residual over its median from which the event is raised.
        """
        self._node, self._valve, self._base = node, valve, base
        self._watch = GapWatch(growth)
        self._recent = RecentBlocks(window)
        self._worker = GapWorker()
        self._events = node.create_lifecycle_publisher(HealthEvent, "events", qos.state(KEPT_EVENTS))
        self._answers = node.create_lifecycle_publisher(GapAnalysis, "gap", qos.state())

    def open(self) -> None:
        """Listen to the valve's events, and answer requests."""
        self._node.subscribe(HealthEvent, "events", self._hear, qos.state(KEPT_EVENTS))
        self._node.serve(Trigger, "~/analyse_gap", self._answer)

    def take(self, block: Block, estimates: list[Estimate]) -> None:
        """Keep ``block`` and judge ``estimates``."""
        self._recent.take(block)
        self._watch.take(block)
        for estimate in estimates:
            change = self._watch.update(estimate)
            if change is not None:
                self._events.publish(self._event(change))

    def _hear(self, event: HealthEvent) -> None:
        raised = event.state == HealthEvent.STATE_RAISED
        self._watch.hear(event.kind, event.source or event.cause, raised=raised)

    def _answer(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Begin an analysis of what is kept; its result comes on ``gap``."""
        records = self._recent.records(self._valve.id)
        if not records:
            response.success, response.message = False, "no samples have arrived yet"
        elif self._worker.offer(GapTask(records, self._valve, self._base, self._recent.stamp)):
            seconds = sum(record.duration for record in records)
            response.success, response.message = True, f"analysing {seconds:.1f} s; the result comes on gap"
        else:
            response.success, response.message = False, "an analysis is under way"
        return response

    def collect(self) -> None:
        """Publish the analysis that was finished since, if any."""
        answer = self._worker.collect()
        if answer is not None:
            self._answers.publish(self._message(answer))

    def close(self) -> None:
        """End the worker and let go of the publishers."""
        self._worker.close()
        self._node.destroy_publisher(self._events)
        self._node.destroy_publisher(self._answers)

    def _event(self, change: GapChange) -> HealthEvent:
        message = HealthEvent(
            kind=MODEL_GAP,
            code=MODEL_GAP_CODE,
            state=HealthEvent.STATE_RAISED if change.raised else HealthEvent.STATE_CLEARED,
            severity=HealthEvent.SEVERITY_WARNING,
            quantity=to_quantity(change.residual),
            message=change.sentence,
        )
        message.header.frame_id = self._valve.id
        message.header.stamp = to_time(change.stamp)
        return message

    def _message(self, answer: GapAnswer) -> GapAnalysis:
        validity = Validity.VALID if answer.done else Validity.UNKNOWN
        message = GapAnalysis(
            state=GapAnalysis.STATE_DONE if answer.done else GapAnalysis.STATE_FAILED,
            verdict=answer.verdict,
            confidence=to_quantity(Quantity("confidence", "1", answer.confidence, validity=validity)),
            sentence=answer.sentence,
            window=answer.duration,
            json=answer.json,
        )
        message.header.frame_id = self._valve.id
        message.header.stamp = to_time(answer.stamp)
        return message
