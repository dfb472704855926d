"""Node ``opcua``: an OPC UA server with state and alarms of all valves.

Nothing comes in through it but what operators do to alarms, where it has a security folder with operators.

Node ids are strings made of names, so that a client that stored them finds them after a restart:
``ns=2;s=valve_1.health.level``. Quality is the status code: ``Good``, ``UncertainLastUsableValue`` (held),
``BadWaitingForInitialData``, ``BadNoCommunication`` (nothing is heard).
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import math
import threading
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from typing import Any, ClassVar

from asyncua import Server, ua
from spool_core.errors import InputError
from spool_core.events.language import ENGLISH, Language
from spool_core.events.sentences import details, headline, language_of
from spool_core.node.managed_node import ManagedNode
from spool_core.node.messages import from_event_message
from spool_core.node.parameters import LANGUAGE, NodeParameter, Value
from spool_core.node.service_calls import ServiceCalls
from spool_core.system import expanded
from spool_monitor.alarm import AlarmState
from spool_monitor.event import Namur
from spool_monitor.listener import NO_WORD, HeardValve, Listener
from spool_msgs.msg import Alarm, Quantity
from spool_view.acts import Act, Outcome, do

from spool_opcua.alarms import MOST, Conditions, moment
from spool_opcua.machine import Machine, Nameplate, ends_of
from spool_opcua.security import PlantServer, Security

#: s between updates of the address space, looks for valves that joined, fetches of their health and looks
#: at their alarms, and steps of an operator's act.
PERIOD, LOOK, FETCH, CALL = 0.5, 1.0, 0.2, 0.1
#: s that the server may take to start.
START = 20.0
LOOPBACK = "127.0.0.1"

NAMESPACE = "urn:spool-suite:valves"
#: Characters of a line of asyncua's log: part of it is what a client sent.
MOST_LINE = 300
_NAMUR = {one.value: one.name.lower().replace("_", " ") for one in Namur}
#: Numbers of an event that are variables of its alarm.
_FACTS = ("value", "low", "high", "baseline", "change", "limit", "false_alarm_interval", "time_to_limit")
_QUALITY = {
    Quantity.VALIDITY_VALID: ua.StatusCodes.Good,
    Quantity.VALIDITY_HELD: ua.StatusCodes.UncertainLastUsableValue,
    Quantity.VALIDITY_UNKNOWN: ua.StatusCodes.BadWaitingForInitialData,
    Quantity.VALIDITY_IMPLAUSIBLE: ua.StatusCodes.UncertainEngineeringUnitsExceeded,
}


#: Everything that asyncua logs.
_ASYNCUA = logging.getLogger("asyncua")


class _OneLine(logging.Handler):
    """Handler that gives warnings and errors to ``say``, without the traces that asyncua adds to refusals."""

    def __init__(self, say: Callable[[str], object]) -> None:
        super().__init__(logging.WARNING)
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        self._say(" ".join(f"{record.getMessage()} {error or ''}".split())[:MOST_LINE])


class OpcUaNode(ManagedNode):
    """Node ``opcua``: messages of all valves of this ROS domain, for OPC UA clients on this host."""

    PARAMETERS: ClassVar = (
        NodeParameter(
            "address", LOOPBACK,
            "Listening address; any but loopback needs security_folder.",
            structural=True,
        ),
        NodeParameter(
            "security_folder", "",
            "Folder made by ./spool secure --opcua, with the certificates and operators; channels are "
            "signed and encrypted then. Empty: neither.",
            structural=True,
        ),
        NodeParameter("port", 4840, "TCP port.", "", 1, 65535, structural=True),
        NodeParameter(
            "machine", "machine", "Name of the machine that clients see in Objects/Machines.", structural=True
        ),
        NodeParameter("manufacturer", "", "Manufacturer of the machine.", structural=True),
        NodeParameter("serial_number", "", "Serial number of the machine.", structural=True),
        NodeParameter(
            "product_uri", "", "URI of this machine (ProductInstanceUri, OPC 40001-1).", structural=True
        ),
        LANGUAGE,
    )  # fmt: skip

    def __init__(self, **options: Any) -> None:
        super().__init__("opcua", **options)
        self._listener: Listener | None = None
        self._language = ENGLISH
        self._thread: threading.Thread | None = None
        self._server: Server | None = None
        self._space: AddressSpace | None = None
        self._conditions: Conditions | None = None
        self._calls: ServiceCalls | None = None
        self._updates: dict[str, Future[int]] = {}
        self._log: logging.Handler | None = None

    def configure(self) -> None:
        """Start the server.

        Raises:
            InputError: the address can't be listened on, or the server does not start in time.
        """
        self._loop = asyncio.new_event_loop()
        self._log = _OneLine(self.get_logger().warning)
        _ASYNCUA.addHandler(self._log)
        _ASYNCUA.propagate = False
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        address, port, folder = map(self.value, ("address", "port", "security_folder"))
        self._language = language_of(self.value(LANGUAGE.name))
        security = Security.read(expanded(folder)) if folder else None
        try:
            serving = asyncio.wait_for(self._serve(address, port, security), START)
            asyncio.run_coroutine_threadsafe(serving, self._loop).result()
        except (OSError, asyncio.TimeoutError) as error:
            said = getattr(error, "strerror", "") or str(error) or f"no server in {START:g} s, machine busy"
            raise InputError(f"port {port}: {said}: set another port, or try again") from error
        access = "read only, not encrypted"
        if security is not None:
            names = ", ".join(sorted(security.operators)) or "nobody"
            access = f"encrypted, {len(security.trusted)} trusted clients; operators: {names}"
        self.get_logger().info(f"serving opc.tcp://{address}:{port}, {access}")

    def refuse_change(self, changes: dict[str, Value]) -> str | None:
        """Refuse what is no address, and the network where no channel is encrypted."""
        address = str(changes.get("address", self.value("address")))
        try:
            loopback = ipaddress.ip_address(address).is_loopback
        except ValueError:
            return f"address: {address!r} is no IP address, e.g. {LOOPBACK}"
        if not loopback and not changes.get("security_folder", self.value("security_folder")):
            needs = "a network needs encryption: set security_folder (./spool secure --opcua)"
            return f"address {address}: {needs}"
        return None

    async def _serve(self, address: str, port: int, security: Security | None) -> None:
        server = PlantServer(security)
        await server.init()
        host = f"[{address}]" if ":" in address else address
        server.set_endpoint(f"opc.tcp://{host}:{port}")
        index = await server.register_namespace(NAMESPACE)
        names = ("machine", "manufacturer", "serial_number", "product_uri")
        machine = Machine(server, index, Nameplate(*map(self.value, names)))
        await machine.build()
        space = AddressSpace(server, index, machine, self._language)
        conditions = Conditions(server, index, machine, self._language, space.folder, self._do)
        await conditions.build()
        server.iserver.answer = conditions.answer
        await server.start()
        self._server, self._space, self._conditions = server, space, conditions

    def activate(self) -> None:
        """Listen to every valve, those that join later as well."""
        self._listener = Listener(self)
        self._calls = ServiceCalls(self)
        self.every(CALL, self._calls.work, steady=True)
        self.every(LOOK, self._listener.look, steady=True)
        self.every(FETCH, self._listener.fetch, steady=True)
        self.every(LOOK, self._listener.sample_bounds, steady=True)
        assert self._space is not None
        assert self._conditions is not None
        self.every(PERIOD, partial(self._work, "variables", self._space.update), steady=True)
        # Apart: a pass over all variables takes much longer.
        self.every(FETCH, partial(self._work, "conditions", self._conditions.update), steady=True)

    def deactivate(self) -> None:
        """Listen to no valve any more."""
        for one in (self._listener, self._calls):
            if one is not None:
                one.close()
        self._listener = self._calls = None

    def cleanup(self) -> None:
        """Stop the server."""
        self.deactivate()  # activating may have failed half-way
        for update in self._updates.values():
            update.cancel()
        self._updates.clear()
        if self._server is not None:
            asyncio.run_coroutine_threadsafe(self._server.stop(), self._loop).result(5.0)
        self._server = self._space = self._conditions = None
        if self._thread is not None:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(timeout=5.0)
        self._thread = None
        if self._log is not None:
            _ASYNCUA.removeHandler(self._log)
        self._log = None

    def _work(self, what: str, update: Callable[[list[HeardValve], float], Coroutine[Any, Any, int]]) -> None:
        """Pass the listener's data to ``update`` on the server's thread, unless the last call still runs."""
        assert self._listener is not None
        last = self._updates.get(what)
        if last is not None and not last.done():
            return
        if last is not None and last.exception() is not None:
            self.get_logger().error(f"the {what} were not updated: {last.exception()}")
        work = update(list(self._listener.valves.values()), time.monotonic())
        self._updates[what] = asyncio.run_coroutine_threadsafe(work, self._loop)

    def _do(self, act: Act) -> Future[Outcome]:
        """Ask for ``act``; called by the server's thread."""
        if self._calls is None:
            refused: Future[Outcome] = Future()
            refused.set_result(Outcome(False, "the node is not active"))
            return refused
        return do(self._calls, act)


@dataclass(frozen=True, slots=True)
class Item:
    """Variable of a valve: its place below the valve, value, quality and the source's time.

    One with a ``unit`` is a process value, of the parameter ``parameter``.
    """

    path: tuple[str, ...]
    value: str | float | int | bool
    quality: int
    time: datetime | None
    unit: str = ""
    parameter: str = ""


class AddressSpace:
    """Variables of all valves; a write happens only where value, quality or time changed."""

    def __init__(self, server: Server, index: int, machine: Machine, language: Language = ENGLISH) -> None:
        """Fill ``server`` below Objects/Valves, in the namespace ``index``; alarms speak ``language``.

        Valves become components of ``machine``, which is built.
        """
        self._server, self._index, self._language = server, index, language
        self._machine = machine
        self._folders: dict[tuple[str, ...], Any] = {}
        self._written: dict[tuple[str, ...], Item] = {}

    async def update(self, valves: Iterable[HeardValve], now: float) -> int:
        """Bring all variables up to date at ``now`` (s, monotonic); return how many were written."""
        written, heard = 0, list(valves)
        for valve in heard:
            for item in items_of(valve, now, self._language):
                if self._written.get(item.path) == item:
                    continue
                value, identity = ua.Variant(item.value), ua.NodeId(".".join(item.path), self._index)
                if item.path not in self._written:
                    folder = await self.folder(item.path[:-1])
                    kind = ua.ObjectIds.AnalogUnitType if item.unit else ua.ObjectIds.BaseDataVariableType
                    named = ua.QualifiedName(item.path[-1], self._index)
                    await self._machine.add(folder.nodeid, named, kind, identity=identity, value=value)
                    if item.unit:
                        await self._machine.measure(valve.name, identity, item.unit)
                if item.unit and (ends := ends_of(valve, item.parameter)):
                    await self._machine.limit(identity, *ends)
                await self._machine.write(identity, value, item.quality, item.time)
                self._written[item.path] = item
                written += 1
            await asyncio.sleep(0)  # alarms and clients do not wait for all valves
        await self._machine.update(heard, now)
        return written

    async def folder(self, path: tuple[str, ...]) -> Any:
        """Return the folder ``path`` below Objects/Valves, which is made where it is missing."""
        if path not in self._folders:
            parent = await self.folder(path[:-1]) if path else self._server.get_objects_node()
            *_, name = path or ("Valves",)
            identity = ua.NodeId(".".join(path) or name, self._index)
            self._folders[path] = await parent.add_folder(identity, ua.QualifiedName(name, self._index))
            if len(path) == 1:
                await self._machine.join(name, self._folders[path])
        return self._folders[path]


def items_of(valve: HeardValve, now: float, language: Language = ENGLISH) -> Iterator[Item]:
    """Yield what plant systems see of ``valve`` at ``now`` (s, monotonic)."""
    name, condition = valve.name, valve.condition(now)
    silent = condition == NO_WORD
    yield Item((name, "condition"), condition.replace("_", " "), ua.StatusCodes.Good, None)
    health = valve.health
    if health is not None:
        at = moment(health.header.stamp)
        good = ua.StatusCodes.BadNoCommunication if silent else ua.StatusCodes.Good
        for key, value in (
            ("level", int(health.level)),
            ("ne107", _NAMUR.get(health.namur, "unknown")),
            ("summary", health.summary),
            ("active", ", ".join(health.active)),
        ):
            yield Item((name, "health", key), value, good, at)
        own = (health.dominant_frequency, health.amplification, health.viscous_drift, health.coulomb_drift)
        yield from _numbers(name, "health", own, at, lost=silent)
    if (estimate := valve.estimate) is not None:
        at = moment(estimate.header.stamp)
        own = (*estimate.parameters, estimate.natural_frequency, estimate.damping_ratio, estimate.residual)
        yield from _numbers(name, "estimate", own, at, lost=silent)
    if valve.alarms is not None:
        shown = valve.alarms.alarms[:MOST]
        folders = {alarm.name: alarm for alarm in shown}
        # Where a name stands for several alarms, the first one shows: it waits for an operator, or is worst.
        for alarm in shown:
            parent = alarm.name
            while parent := parent.rpartition("/")[0]:
                folders.setdefault(parent, alarm)
        for folder, alarm in folders.items():
            yield from _alarm((name, "alarms", folder), alarm, language, lost=silent)


def _numbers(
    valve: str, group: str, quantities: Iterable[Quantity], at: datetime | None, *, lost: bool
) -> Iterator[Item]:
    for one in list(quantities)[:MOST]:
        quality = ua.StatusCodes.BadNoCommunication if lost else _QUALITY.get(one.validity)
        quality = ua.StatusCodes.BadWaitingForInitialData if quality is None else quality
        key = one.name if one.unit in ("", "1") else f"{one.name} [{one.unit}]"
        yield Item((valve, group, key), _finite(one.value), quality, at, one.unit or "1", one.name)
        yield Item((valve, group, f"{key} standard deviation"), _finite(one.standard_deviation), quality, at)


def _finite(value: float) -> float:
    """Return ``value``, 0 for what is not a number: its quality says that it is not known."""
    return float(value) if math.isfinite(value) else 0.0


def _alarm(place: tuple[str, ...], alarm: Alarm, language: Language, *, lost: bool) -> Iterator[Item]:
    at = moment(alarm.header.stamp) or moment(alarm.raised_at)
    quality = ua.StatusCodes.BadNoCommunication if lost else ua.StatusCodes.Good
    unknown = ua.StatusCodes.BadNoCommunication if lost else ua.StatusCodes.BadWaitingForInitialData
    event = from_event_message(alarm.event)
    facts = event.facts
    values: dict[str, str | int | float] = {
        "state": AlarmState(alarm.state).name.lower().replace("_", " "),
        "severity": int(alarm.severity),
        "code": int(alarm.code),
        "cause": alarm.cause,
        "message": headline(event, language) if alarm.message else "",
        "details": "\n".join(map(str, details(event, language))) if alarm.message else "",
        "acknowledged by": alarm.acknowledged_by,
        "parameter": facts.parameter,
        "unit": facts.unit if facts.parameter else "",
        "causes": ", ".join(facts.causes),
        "probabilities": ", ".join(f"{one:.3g}" for one in facts.probabilities),
        "urgency": facts.urgency.name.lower(),
        "advice": facts.advice,
        "subject": facts.subject,
        "note": facts.note,
        **{key.replace("_", " "): getattr(facts, key) for key in _FACTS},
    }
    for key, value in values.items():
        known = not isinstance(value, float) or math.isfinite(value)
        own = (value if known else 0.0), (quality if known else unknown)
        yield Item((*place, key), *own, at)
    began = 1e-9 * facts.began
    text = datetime.fromtimestamp(began, timezone.utc).isoformat(timespec="milliseconds") if began else ""
    yield Item((*place, "began"), text, quality, at)
