"""Machine and its valves as OPC 40001-1 (Machinery) describes them, on the official types.

Nodes of the valves are those below Objects/Valves: a valve and each of its values is one node in two places.
Objects are made without asyncua's copy of a type, which takes 100 times as long. Figures of alarms are
those of AlarmMetricsType (OPC 10000-9, 9.2), counted from the messages of the valves.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

from asyncua import Server, ua
from spool_core.events.language import ENGLISH
from spool_monitor.alarm_statistics import PEAK_SPAN
from spool_monitor.event import Namur
from spool_monitor.listener import ENDS, NO_WORD, HeardValve, moves

#: Type files of the OPC Foundation, in the order in which they need each other.
TYPES = ("Di", "IA", "Machinery")
DI, MACHINERY = "http://opcfoundation.org/UA/DI/", "http://opcfoundation.org/UA/Machinery/"
#: Numbers of OPC 40001-1, release 1.04.1, and of DI 1.04: types, states and the folder of machines.
_MACHINES, _COMPONENTS, _MONITORING = 1001, 1006, 1014
_MACHINE_IDENTIFICATION, _COMPONENT_IDENTIFICATION = 1012, 1005
_ITEM_STATE, _NOT_AVAILABLE, _NOT_EXECUTING, _EXECUTING = 1002, 5005, 5007, 5006
_HAS_HEALTH, _HEALTH_ENUMERATION = 15051, 6244
#: DeviceHealthEnumeration of DI (OPC 10000-100, 4.5.4).
HEALTH = {
    Namur.NORMAL: 0,
    Namur.FAILURE: 1,
    Namur.FUNCTION_CHECK: 2,
    Namur.OUT_OF_SPECIFICATION: 3,
    Namur.MAINTENANCE_REQUIRED: 4,
}
#: Common codes of UNECE recommendation 20 and what people read, by the suite's units.
UNITS: Mapping[str, tuple[str, str, str]] = {
    "1": ("C62", "1", "one"),
    "1/s": ("C97", "s⁻¹", "reciprocal second"),
    "Hz": ("HTZ", "Hz", "hertz"),
    "N": ("NEW", "N", "newton"),
    "N/m": ("4P", "N/m", "newton per metre"),
    "N s/m": ("C58", "N·s/m", "newton second per metre"),
    "Pa": ("PAL", "Pa", "pascal"),
    "deg C": ("CEL", "°C", "degree Celsius"),
    "kg": ("KGM", "kg", "kilogram"),
    "m": ("MTR", "m", "metre"),
    "m/s": ("MTS", "m/s", "metre per second"),
    "m/s^2": ("MSK", "m/s²", "metre per second squared"),
    "s": ("SEC", "s", "second"),
}
_UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
_IDS, _CODES, _KIND, _MASK = ua.ObjectIds, ua.StatusCodes, ua.VariantType, ua.NodeAttributesMask
#: Attributes of a variable: with all of those that asyncua adds by itself it takes twice the memory.
_ATTRIBUTES = (
    *(_MASK.DisplayName, _MASK.Value, _MASK.DataType, _MASK.ValueRank),
    *(_MASK.AccessLevel, _MASK.UserAccessLevel, _MASK.Historizing),
)


#: Attributes that nobody writes and that many nodes have alike: kept for each node they take half the memory.
_ALIKE = (
    *(ua.AttributeIds.NodeClass, ua.AttributeIds.BrowseName, ua.AttributeIds.DisplayName),
    *(ua.AttributeIds.DataType, ua.AttributeIds.ValueRank, ua.AttributeIds.Historizing),
    *(ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel),
)


class Nameplate(NamedTuple):
    """Names of the machine that its owner gives; empty where it is not known."""

    name: str
    manufacturer: str = ""
    serial_number: str = ""
    product_uri: str = ""


class Machine:
    """Machine with its valves as components, their health and values, and the figures of its alarms.

    Args:
        server: with its standard address space.
        index: of the namespace of nodes.
        nameplate: of the machine.

    Attributes:
        node: of the machine, known once it is built.
        figures: of the alarms of all valves; their node is ``figures_node``.
    """

    def __init__(self, server: Server, index: int, nameplate: Nameplate) -> None:
        self._server, self._index, self._nameplate = server, index, nameplate
        self.node = ua.NodeId(":machine", index)  # a valve's name has no colon
        self.figures_node = ua.NodeId(":machine.AlarmMetrics", index)
        self.figures = AlarmFigures()
        self.di = self.machinery = 0
        self._written: dict[ua.NodeId, object] = {}
        self._alike: dict[tuple[int, object], Any] = {}

    async def build(self) -> None:
        """Load the types, and add the machine."""
        importer = logging.getLogger("asyncua.common.xmlimporter")
        level = importer.level
        importer.setLevel(logging.ERROR)  # it warns of a data type of DI that nobody uses here
        for name in TYPES:
            path = Path(__file__).with_name("vendor") / f"Opc.Ua.{name}.NodeSet2.xml"
            await self._server.import_xml(path)
        importer.setLevel(level)
        self.di = await self._server.get_namespace_index(DI)
        self.machinery = await self._server.get_namespace_index(MACHINERY)
        plate = self._nameplate
        await self.add(
            ua.NodeId(_MACHINES, self.machinery), ua.QualifiedName(plate.name, self._index),
            _IDS.BaseObjectType, _IDS.Organizes, identity=self.node,
        )  # fmt: skip
        uri = {"ProductInstanceUri": plate.product_uri}
        parts = [
            await self._identification(self.node, _MACHINE_IDENTIFICATION, plate, uri),
            await self._part(self.node, "Components", _COMPONENTS),
            await self._part(self.node, "MachineryItemState", _ITEM_STATE),
            await self._monitoring(self.node),
        ]
        blocks = await self.add(self.node, self._of("MachineryBuildingBlocks"), _IDS.FolderType)
        for part in parts:
            await self._refer(blocks, part, _IDS.HasAddIn)
        status = await self.add(below(self.node, "Monitoring"), self._of("Status"), _IDS.FolderType)
        await self._refer(status, below(self.node, "MachineryItemState"), _IDS.HasComponent)
        words = ua.Variant(ua.LocalizedText("NotAvailable", ENGLISH.code))
        state = await self.add(
            below(self.node, "MachineryItemState"), ua.QualifiedName("CurrentState"),
            _IDS.FiniteStateVariableType, value=words,
        )  # fmt: skip
        await self._property(state, "Id", ua.Variant(ua.NodeId(_NOT_AVAILABLE, self.machinery)))
        await self.add(self.node, ua.QualifiedName("AlarmMetrics", self._index), _IDS.AlarmMetricsType)
        await self._refer(self.figures_node, ua.NodeId(_IDS.AlarmMetricsType_Reset), _IDS.HasComponent)
        for name, figure in self.figures.values().items():
            made = await self.add(
                self.figures_node, ua.QualifiedName(name),
                _IDS.AlarmRateVariableType if figure.minutes else _IDS.BaseDataVariableType,
                value=figure.value, data_type=ua.NodeId(figure.data_type),
            )  # fmt: skip
            if figure.minutes:
                await self._property(made, "Rate", ua.Variant(figure.minutes, _KIND.UInt16))

    async def join(self, name: str, valve: Any) -> None:
        """Make the folder ``valve`` a component of the machine."""
        node = valve.nodeid
        await self._refer(below(self.node, "Components"), node, _IDS.HasComponent)
        await self._identification(node, _COMPONENT_IDENTIFICATION, Nameplate(name), {})
        await self._monitoring(node)
        await self.add(below(node, "Monitoring"), self._of("Process"), _IDS.FolderType)

    async def measure(self, valve: str, variable: ua.NodeId, unit: str) -> None:
        """Add the ``variable`` of a valve to its process values, with its unit."""
        code, shown, meaning = UNITS.get(unit, ("", unit, unit))
        known = ua.EUInformation(
            _UNECE if code else "urn:spool-suite:units",
            int.from_bytes(code.encode(), "big") if code else -1,
            ua.LocalizedText(shown, ENGLISH.code),
            ua.LocalizedText(meaning, ENGLISH.code),
        )
        await self._property(variable, "EngineeringUnits", ua.Variant(known), ua.NodeId(_IDS.EUInformation))
        process = below(ua.NodeId(valve, self._index), "Monitoring", "Process")
        await self._refer(process, variable, _IDS.HasComponent)

    async def limit(self, variable: ua.NodeId, low: float, high: float) -> None:
        """State the range of normal operation of ``variable``: the monitor warns beyond it."""
        node = below(variable, "EURange")
        value = ua.Variant(ua.Range(low, high))
        if node not in self._written:
            await self._property(variable, "EURange", value, ua.NodeId(_IDS.Range))
        await self.write(node, value)

    async def update(self, valves: Iterable[HeardValve], now: float) -> None:
        """Bring health, state and figures up to date at ``now`` (s, monotonic)."""
        heard = list(valves)
        worst, gone, states = Namur.UNKNOWN, False, set()
        for valve in heard:
            number = 0 if valve.health is None else valve.health.namur
            known = Namur(number) if number in set(Namur) else Namur.UNKNOWN
            silent = valve.condition(now) == NO_WORD
            await self._health(ua.NodeId(valve.name, self._index), known, lost=silent)
            gone |= silent
            if not silent:
                worst = max(worst, known)
                states.add(None if valve.health is None else moves(valve.health))
        await self._health(self.node, worst, lost=gone and worst is Namur.UNKNOWN, partly=gone)
        await self._state(states)
        for name, figure in self.figures.values().items():
            await self.write(below(self.figures_node, name), figure.value)

    async def add(
        self,
        parent: ua.NodeId,
        name: ua.QualifiedName,
        kind: int | ua.NodeId,
        reference: int = _IDS.HasComponent,
        *,
        identity: ua.NodeId | None = None,
        value: ua.Variant | None = None,
        data_type: ua.NodeId | None = None,
    ) -> ua.NodeId:
        """Add an object, or with ``value`` a variable that clients may read, and return its id."""
        identity = identity or below(parent, name.Name)
        shown = ua.LocalizedText(name.Name, ENGLISH.code)
        attributes: Any = ua.ObjectAttributes(
            DisplayName=shown, SpecifiedAttributes=_MASK.DisplayName | _MASK.EventNotifier
        )
        if value is not None:
            attributes = ua.VariableAttributes(
                SpecifiedAttributes=sum(_ATTRIBUTES), DisplayName=shown,
                Value=value, ValueRank=ua.ValueRank.Scalar,
                DataType=data_type or ua.NodeId(value.VariantType.value),
                AccessLevel=ua.AccessLevel.CurrentRead.mask, UserAccessLevel=ua.AccessLevel.CurrentRead.mask,
            )  # fmt: skip
        item = ua.AddNodesItem(
            ParentNodeId=parent, ReferenceTypeId=ua.NodeId(reference), RequestedNewNodeId=identity,
            BrowseName=name, NodeAttributes=attributes,
            NodeClass=ua.NodeClass.Object if value is None else ua.NodeClass.Variable,
            TypeDefinition=ua.NodeId(kind) if isinstance(kind, int) else kind,
        )  # fmt: skip
        for result in await self._server.iserver.isession.add_nodes([item]):
            result.StatusCode.check()
        own = self._server.iserver.aspace[identity].attributes
        for number in _ALIKE:
            if number in own:
                known = str(own[number].value.Value.Value)
                own[number] = self._alike.setdefault((number, known), own[number])
        return identity

    async def _property(
        self, node: ua.NodeId, name: str, value: ua.Variant, kind: ua.NodeId | None = None, index: int = 0
    ) -> None:
        named = ua.QualifiedName(name, index)
        await self.add(node, named, _IDS.PropertyType, _IDS.HasProperty, value=value, data_type=kind)

    def _of(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self.machinery)

    async def _refer(self, node: ua.NodeId, other: ua.NodeId, reference: int) -> None:
        await self._server.get_node(node).add_reference(other, reference)

    async def _part(self, node: ua.NodeId, name: str, kind: int) -> ua.NodeId:
        return await self.add(node, self._of(name), ua.NodeId(kind, self.machinery), _IDS.HasAddIn)

    async def _identification(
        self, node: ua.NodeId, kind: int, plate: Nameplate, more: Mapping[str, str]
    ) -> ua.NodeId:
        name = ua.QualifiedName("Identification", self.di)
        made = await self.add(node, name, ua.NodeId(kind, self.machinery), _IDS.HasAddIn)
        names = {"Manufacturer": plate.manufacturer, "SerialNumber": plate.serial_number}
        for key, words in {**names, **more, "ComponentName": plate.name}.items():
            text = key in ("Manufacturer", "ComponentName")
            value = ua.Variant(ua.LocalizedText(words, ENGLISH.code) if text else words)
            await self._property(made, key, value, index=self.di)
        return made

    async def _monitoring(self, node: ua.NodeId) -> ua.NodeId:
        made = await self._part(node, "Monitoring", _MONITORING)
        health = await self.add(made, self._of("Health"), _IDS.FolderType)
        await self._refer(health, ua.NodeId(_HAS_HEALTH, self.di), _IDS.HasInterface)
        await self.add(
            health, ua.QualifiedName("DeviceHealth", self.di), _IDS.BaseDataVariableType,
            value=ua.Variant(0, _KIND.Int32), data_type=ua.NodeId(_HEALTH_ENUMERATION, self.di),
        )  # fmt: skip
        return made

    async def _health(self, node: ua.NodeId, known: Namur, *, lost: bool, partly: bool = False) -> None:
        code = _CODES.UncertainSubNormal if partly else _CODES.Good
        code = _CODES.BadWaitingForInitialData if known is Namur.UNKNOWN else code
        value = ua.Variant(HEALTH.get(known, 0), _KIND.Int32)
        place = below(node, "Monitoring", "Health", "DeviceHealth")
        await self.write(place, value, _CODES.BadNoCommunication if lost else code)

    async def _state(self, states: set[bool | None]) -> None:
        """Show what the machine does: it executes where a valve moves, by what of each is known."""
        name, number, code = "NotAvailable", _NOT_AVAILABLE, _CODES.BadWaitingForInitialData
        if True in states:
            name, number, code = "Executing", _EXECUTING, _CODES.Good
        elif states == {False}:
            name, number, code = "NotExecuting", _NOT_EXECUTING, _CODES.Good
        elif not states:
            code = _CODES.BadNoCommunication
        place = below(self.node, "MachineryItemState", "CurrentState")
        await self.write(place, ua.Variant(ua.LocalizedText(name, ENGLISH.code)), code)
        await self.write(below(place, "Id"), ua.Variant(ua.NodeId(number, self.machinery)), code)

    async def write(
        self, node: ua.NodeId, value: ua.Variant, code: int = _CODES.Good, at: datetime | None = None
    ) -> None:
        """Write where something changed; ``at`` is the source's time, else it is now."""
        if self._written.get(node) == (value, code, at):
            return
        self._written[node], now = (value, code, at), datetime.now(timezone.utc)
        full = ua.DataValue(value, ua.StatusCode(code), at or now, ServerTimestamp=now)
        await self._server.write_attribute_value(node, full)


def below(node: ua.NodeId, *names: str) -> ua.NodeId:
    """Return the id of what is below ``node`` by that path."""
    return ua.NodeId(".".join((node.Identifier, *names)), node.NamespaceIndex)


def ends_of(valve: HeardValve, parameter: str) -> tuple[float, float] | None:
    """Return the values between which the monitor does not warn of ``parameter``, where both are known."""
    low, high = (valve.bound(parameter, end) for end in ENDS)
    return None if low is None or high is None else (low, high)


class Figure(NamedTuple):
    """Value with its data type; ``minutes`` that a rate is over, 0 of what is no rate."""

    value: ua.Variant
    data_type: int
    minutes: int = 0


class Seen(NamedTuple):
    """What is known of an alarm: announcements, and since when it is active and unacknowledged, s."""

    occurrence: int
    since: tuple[float | None, ...]


@dataclass(slots=True)
class AlarmFigures:
    """Figures since the start of the server or the last reset, by this host's clock.

    Announcements are counted as in :mod:`spool_monitor.alarm_statistics`: of alarms that are not put aside.
    """

    start: float = field(default_factory=time.time)
    _began: float = field(default_factory=time.monotonic)
    _count: int = 0
    _peak: int = 0
    _longest: tuple[float, ...] = (0.0, 0.0)
    _stamps: deque[float] = field(default_factory=deque)
    _seen: dict[tuple[str, str], Seen] = field(default_factory=dict)

    def renewed(self) -> AlarmFigures:
        """Return figures that begin now; alarms that are active are so from now on."""
        new = AlarmFigures(_began=time.monotonic())
        for key, (occurrence, since) in self._seen.items():
            now = tuple(None if moment is None else new._began for moment in since)
            new._seen[key] = Seen(occurrence, now)
        return new

    def hear(
        self,
        key: tuple[str, str],
        occurrence: int,
        raised: float,
        *,
        shown: bool,
        active: bool,
        waiting: bool,
    ) -> None:
        """Count the alarm ``key`` (valve and name).

        Args:
            key: valve and name.
            occurrence: how often it was announced.
            raised: time of the last announcement, s since 1970.
            shown: whether it is active and not put aside.
            active: whether its cause is there.
            waiting: whether nobody acknowledged it.
        """
        now = time.monotonic()
        before = self._seen.get(key)
        if before is None:
            new = int(raised >= self.start)
        else:
            new = occurrence - before.occurrence if occurrence >= before.occurrence else 1
        if shown and new:
            self._count += new
            self._stamps.extend([now] * new)
            self._forget(now)
            self._peak = max(self._peak, len(self._stamps))
        self._longest = self._lasted(now, before)
        began = (None, None) if before is None or new else before.since
        since = (
            (now if moment is None else moment) if holds else None
            for moment, holds in zip(began, (active, waiting), strict=True)
        )
        self._seen[key] = Seen(occurrence, tuple(since))

    def _lasted(self, now: float, *alarms: Seen | None) -> tuple[float, ...]:
        """Return the longest times so far, s; those of ``alarms`` last until ``now``."""
        return tuple(
            max((longest, *(now - since for since in some if since is not None)))
            for longest, some in zip(
                self._longest,
                zip((None, None), *(one.since for one in alarms if one), strict=True),
                strict=True,
            )
        )

    def values(self) -> dict[str, Figure]:
        """Return the figures by their names in the standard; durations in ms."""
        now = time.monotonic()
        self._forget(now)
        active, waiting = self._lasted(now, *self._seen.values())
        # As long as nobody waited for a whole span, its rate is what came so far.
        average = self._count * PEAK_SPAN / max(PEAK_SPAN, now - self._began)

        def rate(value: float) -> Figure:
            return Figure(ua.Variant(round(value, 3), _KIND.Double), _IDS.Double, round(PEAK_SPAN / 60.0))

        def duration(seconds: float) -> Figure:
            return Figure(ua.Variant(1e3 * float(round(seconds)), _KIND.Double), _IDS.Duration)

        return {
            "AlarmCount": Figure(ua.Variant(self._count, _KIND.UInt32), _IDS.UInt32),
            "StartTime": Figure(ua.Variant(datetime.fromtimestamp(self.start, timezone.utc)), _IDS.UtcTime),
            "MaximumActiveState": duration(active),
            "MaximumUnAck": duration(waiting),
            "CurrentAlarmRate": rate(len(self._stamps)),
            "MaximumAlarmRate": rate(self._peak),
            "MaximumReAlarmCount": Figure(ua.Variant(0, _KIND.UInt32), _IDS.UInt32),
            "AverageAlarmRate": rate(average),
        }

    def _forget(self, now: float) -> None:
        while self._stamps and now - self._stamps[0] >= PEAK_SPAN:
            self._stamps.popleft()
