"""Acting on valves: an operator's act as a call of one of their services."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

from spool_msgs.srv import AcknowledgeAlarm, ManageBaseline, ResetAlarms, ShelveAlarm, TakeSnapshot
from std_srvs.srv import Trigger

from spool_view.web.operator.acts import (
    ACKNOWLEDGE,
    ANALYSE,
    FREEZE,
    LEARN,
    RESET,
    SHELVE,
    SNAPSHOT,
    Act,
    Outcome,
)

from .calls import Calls

#: Nodes that do what the monitor does not.
_NODES = {ANALYSE: "estimator", SNAPSHOT: "recorder"}


def do(calls: Calls, act: Act) -> Future[Outcome]:
    """Ask for ``act``; the outcome comes once the valve's node has answered, or is not there."""
    service, request = _request(act)
    outcome: Future[Outcome] = Future()

    def take(answer: Future[Any]) -> None:
        outcome.set_result(_outcome(act, answer.result()))

    calls.ask(act.valve, service, request).add_done_callback(take)
    return outcome


def _request(act: Act) -> tuple[str, Any]:
    by = {"who": act.who, "comment": act.comment}
    if act.act == ANALYSE:
        return "analyse_gap", Trigger.Request()
    if act.act == SNAPSHOT:
        return "take_snapshot", TakeSnapshot.Request(valve=act.valve, **by)
    if act.act in (FREEZE, LEARN):
        kind = ManageBaseline.Request
        return "manage_baseline", kind(action=kind.FREEZE if act.act == FREEZE else kind.LEARN, **by)
    by["alarm"] = act.alarm
    if act.act == ACKNOWLEDGE:
        return "acknowledge_alarm", AcknowledgeAlarm.Request(occurrence=act.occurrence, **by)
    if act.act == RESET:
        return "reset_alarms", ResetAlarms.Request(**by)
    shelved = act.act == SHELVE
    return "shelve_alarm", ShelveAlarm.Request(shelved=shelved, duration=60.0 * act.minutes, **by)


def _outcome(act: Act, answer: Any) -> Outcome:
    if answer is None:
        node = _NODES.get(act.act, "monitor")
        return Outcome(False, f"{act.valve}: its {node} does not answer")
    if act.act == ANALYSE:
        return Outcome(bool(answer.success), str(answer.message))
    if not answer.success:
        return Outcome(False, str(answer.reason))
    return Outcome(True, ", ".join(getattr(answer, "changed", ())) or str(getattr(answer, "stage", "")))
