"""Alarms of valves as OPC UA conditions (OPC 10000-9), of the alarm types of OPC 10000-100 (DI).

A condition has the mandatory parts of its type; all of its state is in its events. asyncua hands no event to
the notifiers above, so that is done here.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any, NamedTuple

from asyncua import Server, ua
from spool_core.events.language import ENGLISH, Language
from spool_core.events.sentences import headline
from spool_core.node.messages import from_event_message
from spool_monitor.alarm import LONGEST_SHELF, AlarmState
from spool_monitor.detectors import event_kind
from spool_monitor.event import Namur, Severity
from spool_monitor.listener import NO_WORD, HeardValve
from spool_msgs.msg import Alarm, AlarmList
from spool_view.acts import ACKNOWLEDGE, RESET, SHELVE, UNSHELVE, Act, ActRefusedError, Outcome, act_of

from spool_opcua.machine import Machine, below
from spool_opcua.security import PlantSession, Watch

#: Numbers of DI's alarm types (OPC 10000-100, 4.12): what they are derived from, then one for each status.
DEVICE_HEALTH = 15143
TYPES = {
    Namur.FAILURE: 15292,  # FailureAlarmType
    Namur.FUNCTION_CHECK: 15441,  # CheckFunctionAlarmType
    Namur.OUT_OF_SPECIFICATION: 15590,  # OffSpecAlarmType
    Namur.MAINTENANCE_REQUIRED: 15739,  # MaintenanceRequiredAlarmType
}
#: Severity of 1 to 1000: the middle of "high" and of "medium" (OPC 10000-9, table E.2).
SEVERITIES: Mapping[int, int] = {Severity.ALARM: 834, Severity.WARNING: 500}
#: Alarms of one valve at most: what comes over the network is data.
MOST = 64
#: Earlier events of a condition that a client may still acknowledge: chosen, it bounds the memory.
MOST_EVENTS = 16
#: Time of what has not happened.
NEVER = datetime.fromtimestamp(0, timezone.utc)

_IDS, _CODES = ua.ObjectIds, ua.StatusCodes
_ACTIVE = (AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED)
_LATCHED = (AlarmState.LATCHED_UNACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED)
_WAITING = (
    AlarmState.UNACKNOWLEDGED, AlarmState.RETURNED_UNACKNOWLEDGED, AlarmState.LATCHED_UNACKNOWLEDGED
)  # fmt: skip


class _Method(NamedTuple):
    """Method of a type: the act that it is, and the places of its arguments."""

    act: str
    event: int | None = None
    time: int | None = None
    comment: int | None = None


def _shelving(name: str, method: _Method) -> dict[ua.NodeId, _Method]:
    """Return both declarations of a method: in the state machine's type and in the alarm's."""
    return {
        ua.NodeId(getattr(_IDS, f"{owner}_{name}")): method
        for owner in ("ShelvedStateMachineType", "AlarmConditionType_ShelvingState")
    }


METHODS: Mapping[ua.NodeId, _Method] = {
    ua.NodeId(_IDS.AcknowledgeableConditionType_Acknowledge): _Method(ACKNOWLEDGE, event=0, comment=1),
    ua.NodeId(_IDS.AcknowledgeableConditionType_Confirm): _Method(RESET, event=0, comment=1),
    **_shelving("TimedShelve", _Method(SHELVE, time=0)),
    **_shelving("TimedShelve2", _Method(SHELVE, time=0, comment=1)),
    **_shelving("OneShotShelve", _Method(SHELVE)),
    **_shelving("OneShotShelve2", _Method(SHELVE, comment=0)),
    **_shelving("Unshelve", _Method(UNSHELVE)),
    **_shelving("Unshelve2", _Method(UNSHELVE, comment=0)),
}
REFRESH = ua.NodeId(_IDS.ConditionType_ConditionRefresh)
REFRESH_ONE = ua.NodeId(_IDS.ConditionType_ConditionRefresh2)
RESET_FIGURES = ua.NodeId(_IDS.AlarmMetricsType_Reset)


class Part(NamedTuple):
    """Variable or method that each condition has, by its path below it."""

    path: tuple[ua.QualifiedName, ...]
    declaration: Any
    reference: int
    kind: ua.NodeId | None
    data_type: ua.NodeId | None


@dataclass(slots=True)
class Condition:
    """Condition of a valve's alarm for one NE 107 status, as it is since ``at``.

    ``events`` are occurrences by EventId; ``shown`` is the last key while its monitor was heard.
    """

    node: ua.NodeId
    valve: str
    namur: Namur
    alarm: Alarm
    lost: bool = False
    over: bool = False
    at: datetime = NEVER
    shown: tuple[object, ...] = ()
    events: dict[bytes, int] = field(default_factory=dict)
    last_severity: int = 0

    @property
    def underlying(self) -> AlarmState:
        """State beneath a cover; one whose cause became another is over."""
        return AlarmState.NORMAL if self.over else _alarm_state(self.alarm.underlying or self.alarm.state)

    @property
    def retained(self) -> bool:
        """Whether an operator may still want to see it."""
        return self.underlying not in (AlarmState.NORMAL, AlarmState.UNKNOWN)

    @property
    def severity(self) -> int:
        """Severity of 1 to 1000."""
        return SEVERITIES.get(self.alarm.severity, 1)

    def key(self) -> tuple[object, ...]:
        """Return what clients are notified of when it changes."""
        alarm, stamp = self.alarm, self.alarm.header.stamp
        return (
            *(self.lost, self.over, alarm.state, alarm.underlying, alarm.severity, alarm.occurrence),
            *(alarm.cause, alarm.comment, stamp.sec, stamp.nanosec, alarm.shelved_until.sec),
        )

    def change(self) -> None:
        """Set the time of the change: by the monitor, else by the clock of this host.

        The monitor's time also makes an EventId that is the same after a restart.
        """
        key = self.key()
        said = moment(self.alarm.header.stamp) or moment(self.alarm.raised_at)
        noticed = said is None or self.over or self.lost or key == self.shown
        self.at = datetime.now(timezone.utc) if noticed or said is None else said
        self.shown = self.shown if self.lost else key

    def event_id(self) -> bytes:
        """Return the EventId of the last change, the same one in a refresh."""
        words = f"{self.node.Identifier}{self.key()}{self.at.isoformat()}"
        return hashlib.blake2b(words.encode(), digest_size=16).digest()


class Conditions:
    """Conditions of all valves below their nodes, with notifiers from server over machine to valve.

    Args:
        server: with its standard address space.
        index: of the namespace of nodes.
        machine: that is built.
        language: for clients that ask for none of ours.
        folder: of a path below Objects/Valves, made where it is missing.
        do: does an act; from any thread.
    """

    def __init__(
        self,
        server: Server,
        index: int,
        machine: Machine,
        language: Language,
        folder: Callable[[tuple[str, ...]], Awaitable[Any]],
        do: Callable[[Act], Future[Outcome]],
    ) -> None:
        self._server, self._index, self._language = server, index, language
        self._machine, self._folder, self._do = machine, folder, do
        self._kinds: dict[Namur, tuple[ua.NodeId, ...]] = {}
        self._parts: list[Part] = []
        self._valves: Any = None
        self._sources: dict[str, Any] = {}
        self._seen: dict[str, tuple[AlarmList, bool]] = {}
        self._current: dict[tuple[str, str], Condition] = {}
        self._known: dict[ua.NodeId, Condition] = {}

    async def build(self) -> None:
        """Make the machine a notifier; the folder of valves is one as well, for clients that know it."""
        health = ua.NodeId(DEVICE_HEALTH, self._machine.di)
        parents = [
            ua.NodeId(getattr(_IDS, name))
            for name in (
                *("InstrumentDiagnosticAlarmType", "OffNormalAlarmType", "DiscreteAlarmType"),
                *("AlarmConditionType", "AcknowledgeableConditionType", "ConditionType", "BaseEventType"),
            )
        ]
        for namur, number in TYPES.items():
            self._kinds[namur] = (ua.NodeId(number, self._machine.di), health, *parents)
        for kind in self._kinds[Namur.FAILURE]:  # the four types add nothing
            await self._declare((), kind)
        await self._notifier(self._server.nodes.server, self._server.get_node(self._machine.node))
        self._valves = await self._folder(())
        await self._valves.set_event_notifier([ua.EventNotifier.SubscribeToEvents])

    async def _declare(self, path: tuple[ua.QualifiedName, ...], node: ua.NodeId) -> None:
        """Collect all mandatory parts that ``node`` declares (OPC 10000-3, 6.4.4)."""
        for one in await self._server.get_node(node).get_references(
            _IDS.Aggregates, ua.BrowseDirection.Forward
        ):
            declaration, place = self._server.get_node(one.NodeId), (*path, one.BrowseName)
            rules = await declaration.get_references(_IDS.HasModellingRule, ua.BrowseDirection.Forward)
            mandatory = any(rule.NodeId == ua.NodeId(_IDS.ModellingRule_Mandatory) for rule in rules)
            if not mandatory or any(part.path == place for part in self._parts):
                continue
            part = Part(place, one.NodeId, one.ReferenceTypeId.Identifier, None, None)
            if one.NodeClass == ua.NodeClass.Variable:
                part = part._replace(kind=one.TypeDefinition, data_type=await declaration.read_data_type())
            self._parts.append(part)
            if part.kind is not None:
                await self._declare(place, one.NodeId)

    async def _notifier(self, above: Any, node: Any) -> None:
        await node.set_event_notifier([ua.EventNotifier.SubscribeToEvents])
        await above.add_reference(node, ua.ObjectIds.HasNotifier)

    async def update(self, valves: Iterable[HeardValve], now: float) -> int:
        """Notify clients of what changed at ``now`` (s, monotonic), oldest first; return how often."""
        changed: list[tuple[HeardValve, AlarmList, bool]] = []
        for valve in valves:
            if valve.alarms is None:
                continue
            lost = valve.condition(now) == NO_WORD
            listed, before = self._seen.get(valve.name, (None, False))
            if listed is not valve.alarms or lost is not before:
                changed.append((valve, valve.alarms, lost))
        sent = 0
        changed.sort(key=lambda one: (one[1].header.stamp.sec, one[1].header.stamp.nanosec))
        for valve, alarms, lost in changed:
            self._seen[valve.name] = alarms, lost
            for alarm in alarms.alarms[:MOST]:
                sent += await self._follow(valve.name, alarm, lost=lost)
            await asyncio.sleep(0)
        return sent

    async def _follow(self, valve: str, alarm: Alarm, *, lost: bool) -> int:
        namur = event_kind(alarm.kind).cause(alarm.cause).namur
        namur = namur if namur in TYPES else Namur.OUT_OF_SPECIFICATION
        sent, current = 0, self._current.get((valve, alarm.name))
        if current is not None and current.namur is not namur:
            if current.retained:
                current.over = True
                await self._notify(current)
                sent += 1
            current = None
        if current is None:
            current = await self._condition(valve, alarm, namur)
            self._current[valve, alarm.name] = current
            before, retained = None, False
        else:
            before, retained = current.key(), current.retained
        current.alarm, current.lost, current.over = alarm, lost, False
        self._machine.figures.hear(
            (valve, alarm.name),
            alarm.occurrence,
            alarm.raised_at.sec + 1e-9 * alarm.raised_at.nanosec,
            shown=alarm.state in _ACTIVE and not lost,
            active=current.underlying in _ACTIVE and not lost,
            waiting=current.underlying in _WAITING and not lost,
        )
        if current.key() == before or not (retained or current.retained):
            return sent
        await self._notify(current)
        current.last_severity = current.severity
        return sent + 1

    async def _condition(self, valve: str, alarm: Alarm, namur: Namur) -> Condition:
        node = ua.NodeId(f"{valve}.conditions.{alarm.name}.{namur.letter}", self._index)
        if node in self._known:
            return self._known[node]
        if valve not in self._sources:
            source = self._sources[valve] = await self._folder((valve,))
            await self._notifier(self._server.get_node(self._machine.node), source)
        source = self._sources[valve]
        name = ua.QualifiedName(f"{alarm.name} {namur.letter}", self._index)
        await self._machine.add(source.nodeid, name, self._kinds[namur][0], identity=node)
        await source.add_reference(node, _IDS.HasCondition)
        condition = self._known[node] = Condition(node, valve, namur, alarm)
        condition.change()
        condition.shown = ()  # no client was notified
        fields = self._fields(condition, self._language)
        for part in self._parts:
            *above, own = part.path
            parent = below(node, *(one.Name for one in above))
            if part.kind is None:  # a method is the type's
                await self._server.get_node(parent).add_reference(part.declaration, part.reference)
            else:
                value = fields["/".join(one.Name for one in part.path)]
                await self._machine.add(
                    parent, own, part.kind, part.reference, value=value, data_type=part.data_type
                )
        return condition

    def _fields(self, condition: Condition, language: Language) -> dict[str, ua.Variant]:
        source = self._sources[condition.valve].nodeid
        return fields_of(condition, source, self._kinds[condition.namur][0], language)

    async def _notify(self, condition: Condition) -> None:
        condition.change()
        condition.events[condition.event_id()] = condition.alarm.occurrence
        while len(condition.events) > MOST_EVENTS:
            del condition.events[next(iter(condition.events))]
        fields = self._fields(condition, self._language)
        for part in self._parts:
            names = [one.Name for one in part.path]
            if part.kind is not None:
                node = below(condition.node, *names)
                await self._machine.write(node, fields["/".join(names)], at=condition.at)
        for subscription, session, watches in self._server.iserver.watches():
            await self._hand(condition, subscription, session, watches)

    async def _hand(
        self, condition: Condition, subscription: Any, session: PlantSession, watches: Mapping[int, Watch]
    ) -> None:
        """Hand an event to those of ``watches`` that look at the valve or above."""
        notifiers = (
            *(self._sources[condition.valve].nodeid, self._valves.nodeid),
            *(self._machine.node, ua.NodeId(_IDS.Server)),
        )
        looking = {item: watch for item, watch in watches.items() if watch.notifier in notifiers}
        if not looking:
            return
        fields = self._fields(condition, session.language or self._language)
        for item, watch in looking.items():
            if watch.passes(fields, self._kinds[condition.namur]):
                await subscription.enqueue_event(item, watch.selected(fields), watch.queue)

    async def answer(self, session: PlantSession, request: Any) -> int:
        """Do what a method call asks for, acts for operators only; return the status code."""
        arguments = [one.Value for one in request.InputArguments or ()]
        if request.MethodId in (REFRESH, REFRESH_ONE):
            wanted = 1 + (request.MethodId == REFRESH_ONE)
            if len(arguments) != wanted or not all(isinstance(one, int) for one in arguments):
                return int(_CODES.BadInvalidArgument)
            return await self._refresh(session, *arguments)
        method = METHODS.get(request.MethodId)
        who = getattr(session.user, "name", None)
        if who is None or not (method or request.MethodId == RESET_FIGURES):
            return int(_CODES.BadUserAccessDenied)
        if method is None:
            if request.ObjectId != self._machine.figures_node:
                return int(_CODES.BadNodeIdUnknown)
            self._machine.figures = self._machine.figures.renewed()
            return int(_CODES.Good)
        condition = self._known.get(request.ObjectId)
        if condition is None:
            return int(_CODES.BadNodeIdUnknown)
        return await self._act(method, condition, arguments, who)

    async def _refresh(self, session: PlantSession, number: int, only: int | None = None) -> int:
        server = self._server.iserver
        subscription = server.subscription_service.subscriptions.get(number)
        if subscription is None or subscription.session_id != session.session_id:
            return int(_CODES.BadSubscriptionIdInvalid)
        watches = dict(server.watched.get(number, (session, {}))[1])
        if only is not None:
            if only not in watches:
                return int(_CODES.BadMonitoredItemIdInvalid)
            watches = {only: watches[only]}
        await self._frame(subscription, watches, _IDS.RefreshStartEventType)
        for condition in list(self._current.values()):
            if condition.retained:
                await self._hand(condition, subscription, session, watches)
        await self._frame(subscription, watches, _IDS.RefreshEndEventType)
        return int(_CODES.Good)

    async def _frame(self, subscription: Any, watches: Mapping[int, Watch], number: int) -> None:
        """Hand the beginning or end of a refresh to all items: no filter by the client holds it back."""
        now, kind = datetime.now(timezone.utc), ua.NodeId(number)
        words = ua.LocalizedText("refresh", ENGLISH.code)
        fields = _base(kind, ua.NodeId(_IDS.Server), "Server", now, words, 1)
        fields["EventId"] = ua.Variant(hashlib.blake2b(str(time.time_ns()).encode(), digest_size=16).digest())
        for item, watch in watches.items():
            await subscription.enqueue_event(item, watch.selected(fields), watch.queue)

    async def _act(self, method: _Method, condition: Condition, arguments: Sequence[Any], who: str) -> int:
        alarm = condition.alarm
        given: dict[str, Any] = {"act": method.act, "valve": condition.valve, "alarm": alarm.name, "who": who}
        wanted = [one for one in (method.event, method.time, method.comment) if one is not None]
        if len(arguments) != len(wanted):
            return int(_CODES.BadArgumentsMissing)
        if method.event is not None:
            if arguments[method.event] not in condition.events or condition.over:
                return int(_CODES.BadEventIdUnknown)
            given["occurrence"] = condition.events[arguments[method.event]]
        if method.act == ACKNOWLEDGE and condition.underlying not in _WAITING:
            return int(_CODES.BadConditionBranchAlreadyAcked)
        if method.act == RESET and condition.underlying not in _LATCHED:
            return int(_CODES.BadConditionBranchAlreadyConfirmed)
        if method.act == UNSHELVE and alarm.state != AlarmState.SHELVED:
            return int(_CODES.BadConditionNotShelved)
        if method.act == SHELVE:
            given["minutes"] = 0.0
            if method.time is not None:
                length = arguments[method.time]
                if not isinstance(length, int | float) or not 0.0 < length <= 1e3 * LONGEST_SHELF:
                    return int(_CODES.BadShelvingTimeOutOfRange)
                given["minutes"] = length / 60e3
        if method.comment is not None:
            said = arguments[method.comment]
            given["comment"] = (said.Text if isinstance(said, ua.LocalizedText) else said) or ""
        try:
            act = act_of(given, {condition.valve: frozenset((alarm.name,))})
        except ActRefusedError:
            return int(_CODES.BadInvalidArgument)
        outcome = await asyncio.wrap_future(self._do(act))
        return int(_CODES.Good if outcome.done else _CODES.BadInvalidState)


def fields_of(
    condition: Condition, source: ua.NodeId, kind: ua.NodeId, language: Language
) -> dict[str, ua.Variant]:
    """Return all fields of the event that shows ``condition`` as it is, by browse path.

    Args:
        condition: of a valve.
        source: node of the valve.
        kind: event type.
        language: of the message.
    """
    alarm, underlying, at = condition.alarm, condition.underlying, condition.at
    said = headline(from_event_message(alarm.event), language) if alarm.message else alarm.name
    fields = _base(
        kind, source, condition.valve, at, ua.LocalizedText(said, language.code), condition.severity
    )
    state = _alarm_state(alarm.state)
    shelved, end = state is AlarmState.SHELVED, alarm.shelved_until
    timed = shelved and end.sec
    left = max(0.0, end.sec + 1e-9 * end.nanosec - time.time()) if timed else math.nan
    acknowledged = moment(alarm.acknowledged_at)
    return fields | {
        "EventId": ua.Variant(condition.event_id()),
        "NodeId": ua.Variant(condition.node),
        "ConditionClassId": ua.Variant(ua.NodeId(_IDS.MaintenanceConditionClassType)),
        "ConditionClassName": _text("MaintenanceConditionClassType"),
        "ConditionName": ua.Variant(alarm.name),
        "BranchId": ua.Variant(ua.NodeId(), ua.VariantType.NodeId),
        "Retain": ua.Variant(condition.retained),
        "Quality": ua.Variant(ua.StatusCode(_CODES.BadNoCommunication if condition.lost else _CODES.Good)),
        "Quality/SourceTimestamp": ua.Variant(at),
        "LastSeverity": ua.Variant(condition.last_severity or condition.severity, ua.VariantType.UInt16),
        "LastSeverity/SourceTimestamp": ua.Variant(at),
        "Comment": _text(alarm.hidden_comment if alarm.hidden_by else alarm.comment),
        "Comment/SourceTimestamp": ua.Variant(moment(alarm.hidden_at) or acknowledged or at),
        "ClientUserId": ua.Variant(alarm.hidden_by or alarm.acknowledged_by),
        "InputNode": ua.Variant(ua.NodeId(), ua.VariantType.NodeId),
        "NormalState": ua.Variant(ua.NodeId(), ua.VariantType.NodeId),
        "SuppressedOrShelved": ua.Variant(state != underlying and not condition.over),
        "MaxTimeShelved": ua.Variant(1e3 * LONGEST_SHELF),
        **_state("EnabledState", "Enabled", "Disabled", on=True),
        **_state("ActiveState", "Active", "Inactive", on=underlying in _ACTIVE),
        **_state("AckedState", "Acknowledged", "Unacknowledged", on=underlying not in _WAITING),
        **_state("ConfirmedState", "Confirmed", "Unconfirmed", on=underlying not in _LATCHED),
        **_state("LatchedState", "Latched", "Not latched", on=underlying in _LATCHED),
        **_state("SuppressedState", "Suppressed", "Unsuppressed", on=state is AlarmState.SUPPRESSED),
        **_state("OutOfServiceState", "Out of service", "In service", on=state is AlarmState.OUT_OF_SERVICE),
        **_shelving_state(shelved=shelved, left=left),
    }


def _base(
    kind: ua.NodeId, source: ua.NodeId, name: str, at: datetime, message: ua.LocalizedText, severity: int
) -> dict[str, ua.Variant]:
    """Return the fields of BaseEventType but ``EventId``."""
    return {
        "EventType": ua.Variant(kind),
        "SourceNode": ua.Variant(source),
        "SourceName": ua.Variant(name),
        "Time": ua.Variant(at),
        "ReceiveTime": ua.Variant(datetime.now(timezone.utc)),
        "Message": ua.Variant(message),
        "Severity": ua.Variant(severity, ua.VariantType.UInt16),
    }


def _state(name: str, true: str, false: str, *, on: bool) -> dict[str, ua.Variant]:
    """Return a two-state variable; the standard words are English in every language."""
    return {name: _text(true if on else false), f"{name}/Id": ua.Variant(on)}


def _shelving_state(*, shelved: bool, left: float) -> dict[str, ua.Variant]:
    """Return the shelving's state; ``left`` s, NaN where no time is set."""
    name, number = "Unshelved", _IDS.ShelvedStateMachineType_Unshelved
    if shelved:
        name, number = "OneShotShelved", _IDS.ShelvedStateMachineType_OneShotShelved
    if math.isfinite(left):
        name, number = "TimedShelved", _IDS.ShelvedStateMachineType_TimedShelved
    return {
        "ShelvingState/CurrentState": _text(name),
        "ShelvingState/CurrentState/Id": ua.Variant(ua.NodeId(number)),
        "ShelvingState/UnshelveTime": ua.Variant(1e3 * left if math.isfinite(left) else 0.0),
    }


def _alarm_state(number: int) -> AlarmState:
    """Return the state with that number; one that a later version sends is unknown."""
    return AlarmState(number) if number in set(AlarmState) else AlarmState.UNKNOWN


def _text(words: str) -> ua.Variant:
    return ua.Variant(ua.LocalizedText(words, ENGLISH.code))


def moment(stamp: Any) -> datetime | None:
    """Return the time of a message's ``stamp``, ``None`` where it has none."""
    seconds = stamp.sec + 1e-9 * stamp.nanosec
    return datetime.fromtimestamp(seconds, timezone.utc) if seconds else None
