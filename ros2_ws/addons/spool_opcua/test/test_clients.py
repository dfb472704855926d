"""What clients of the OPC UA server get: refusals, filters, changes of conditions, the address space."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import socket
import ssl
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, Server, ua
from asyncua.ua.ua_binary import struct_from_binary, uatcp_to_binary
from spool_core.events.language import ENGLISH
from spool_core.opcua_folder import CERTIFICATE, make_server
from spool_monitor.listener import HeardValve
from spool_msgs.msg import Alarm, AlarmList, ModelEstimate, Quantity, ValveHealth
from spool_opcua.alarms import Conditions
from spool_opcua.machine import Machine, Nameplate
from spool_opcua.opcua_node import NAMESPACE, AddressSpace
from spool_opcua.security import MOST_CONNECTIONS, PlantServer, Security
from spool_report.outputs import package_version

SILENCE, WEAR = "stale/acceleration", "friction_drift/coulomb_force"
OTHER = "friction_drift/viscous_coefficient"
CODES, OPERATOR = ua.StatusCodes, ua.FilterOperator
PATIENCE = 60.0
BEGAN = 1_790_000_000


class Served:
    """A server on a loop in a thread, and what it is fed with."""

    def __init__(self, security: Security | None = None) -> None:
        self.security = security
        self.loop = asyncio.new_event_loop()
        threading.Thread(target=self.loop.run_forever, daemon=True).start()
        self.url, self.log = "", [""]
        self.server, self.space, self.conditions = self.wait(self._made())

    def wait(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(PATIENCE)

    async def _made(self) -> tuple[Server, AddressSpace, Conditions]:
        server = PlantServer(self.security)
        await server.init()
        server.set_endpoint("opc.tcp://127.0.0.1:0")
        index = await server.register_namespace(NAMESPACE)
        machine = Machine(server, index, Nameplate("press 7"))
        await machine.build()
        space = AddressSpace(server, index, machine)
        conditions = Conditions(server, index, machine, ENGLISH, space.folder, lambda _: None)  # type: ignore[arg-type,return-value]
        await conditions.build()
        server.iserver.answer = conditions.answer
        await server.start()
        self.url = f"opc.tcp://127.0.0.1:{server.bserver.port}"
        return server, space, conditions

    def hear(self, *valves: HeardValve, now: float = 0.0) -> None:
        async def both() -> None:
            await self.space.update(valves, now)
            await self.conditions.update(valves, now)

        self.wait(both())

    def raw(self, sent: bytes = b"") -> socket.socket:
        host, port = self.url.removeprefix("opc.tcp://").split(":")
        one = socket.create_connection((host, int(port)), timeout=PATIENCE)
        with contextlib.suppress(ConnectionError):  # it may be refused while it sends
            one.sendall(sent)
        return one


@pytest.fixture(name="served", scope="module")
def _served() -> Iterator[Served]:
    made = Served()
    yield made
    made.wait(made.server.stop())
    made.loop.call_soon_threadsafe(made.loop.stop)


def error(one: socket.socket) -> ua.ErrorMessage:
    """Return the Error message that comes before the end of the connection."""
    received = b""
    while more := one.recv(65536):
        received += more
    one.close()
    assert received[:4] == b"ERRF"
    assert int.from_bytes(received[4:8], "little") == len(received)
    return struct_from_binary(ua.ErrorMessage, ua.utils.Buffer(received[8:]))


HELLO = uatcp_to_binary(ua.MessageType.Hello, ua.Hello(EndpointUrl="opc.tcp://localhost"))


def chunk(kind: bytes, content: bytes, size: int | None = None) -> bytes:
    return kind + (8 + len(content) if size is None else size).to_bytes(4, "little") + content


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", CODES.BadTcpMessageTypeInvalid),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03 TLS", CODES.BadTcpMessageTypeInvalid),
        (chunk(b"HELF", b"", 0), CODES.BadTcpMessageTypeInvalid),
        (chunk(b"HELF", b"no hello"), CODES.BadTcpMessageTypeInvalid),
        (chunk(b"MSGF", b"", 400_000_000), CODES.BadTcpMessageTooLarge),
        (chunk(b"MSGF", bytes(4_000_000), 400_000_000), CODES.BadTcpMessageTooLarge),
        (chunk(b"MSGF", bytes(40)), CODES.BadTcpSecureChannelUnknown),
        (chunk(b"OPNF", bytes(40)), CODES.BadSecurityChecksFailed),
        (chunk(b"OPNF", bytes(4) + b"\x08\0\0\0no polic" + b"\xff" * 8), CODES.BadSecurityChecksFailed),
    ],
)  # fmt: skip
def test_what_is_no_request_of_a_channel_is_answered_by_an_error_and_ends(
    served: Served, sent: bytes, code: int, caplog: pytest.LogCaptureFixture
) -> None:
    served.server.iserver.refusals._left = 10.0
    one = served.raw(sent)
    place = one.getsockname()[1]
    assert error(one).Error.value == code
    assert f"client 127.0.0.1:{place} refused" in caplog.text


def test_an_untrusted_client_is_told_no_more_than_that_and_logged_with_its_thumbprint(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    make_server(tmp_path / "own")
    make_server(tmp_path / "strange")
    strange = ssl.PEM_cert_to_DER_cert((tmp_path / "strange" / CERTIFICATE).read_text("ascii"))
    other = Served(Security.read(tmp_path / "own"))
    policy = b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256"
    parts = (len(one).to_bytes(4, "little") + one for one in (policy, strange, bytes(20)))
    one = other.raw(chunk(b"OPNF", bytes(4) + b"".join(parts) + bytes(256)))
    place = one.getsockname()[1]
    told = error(one)
    assert told.Error.value == CODES.BadSecurityChecksFailed
    assert "trust" not in told.Reason
    (line,) = [one.getMessage() for one in caplog.records if "refused" in one.getMessage()]
    assert f"client 127.0.0.1:{place} refused" in line
    assert "BadCertificateUntrusted" in line
    assert hashlib.sha1(strange).hexdigest() in line
    other.wait(other.server.stop())


def test_idle_connections_do_not_keep_clients_out(served: Served) -> None:
    async def read(client: Client) -> Any:
        return await client.nodes.server_state.read_value()

    async def work() -> None:
        async with Client(served.url, timeout=PATIENCE) as first:
            idle = [served.raw(HELLO if number % 2 else b"") for number in range(300)]
            async with Client(served.url, timeout=PATIENCE) as client:
                assert await read(client) == ua.ServerState.Running
            assert await read(first) == ua.ServerState.Running  # one with a session stays
            assert len(served.server.bserver.clients) <= MOST_CONNECTIONS
            assert error(idle[0]).Error.value == CODES.BadTcpServerTooBusy
            for one in idle:
                one.close()

    asyncio.run(work())


def alarm(name: str = SILENCE, *, at: int = BEGAN, state: int = Alarm.STATE_UNACKNOWLEDGED) -> Alarm:
    kind, _, _ = name.partition("/")
    one = Alarm(name=name, kind=kind, code=801, state=state, underlying=state, severity=2, occurrence=1)
    one.header.stamp.sec = at
    return one


def heard(*alarms: Alarm, at: float = 0.0, name: str = "valve_1") -> HeardValve:
    numbers = [Quantity(name="mass", unit="kg", value=0.1, validity=Quantity.VALIDITY_VALID)]
    estimate = ModelEstimate(parameters=numbers)
    return HeardValve(name, ValveHealth(), at, estimate, AlarmList(alarms=list(alarms)))


FIELDS = (
    *("EventId", "EventType", "ConditionName", "Time", "Retain", "Severity", "Quality", "Message"),
    *("Comment", "ClientUserId"),
)


class Listened:
    """A client's subscription to events."""

    def __init__(self, client: Client) -> None:
        self.client, self.events = client, list[Any]()

    def event_notification(self, event: Any) -> None:
        self.events.append(event)

    async def watch(self, where: ua.ContentFilter | None = None) -> Any:
        """Create an item of events at the server with the filter ``where``; return the answer."""
        self.subscription = await self.client.create_subscription(20, self)
        clauses = [
            ua.SimpleAttributeOperand(
                ua.NodeId(ua.ObjectIds.BaseEventType), [ua.QualifiedName(name)], ua.AttributeIds.Value
            )
            for name in FIELDS
        ]  # fmt: skip
        item = ua.MonitoredItemCreateRequest(
            ua.ReadValueId(self.client.nodes.server.nodeid, ua.AttributeIds.EventNotifier),
            ua.MonitoringMode.Reporting,
            ua.MonitoringParameters(1, 0, ua.EventFilter(clauses, where or ua.ContentFilter()), 0, True),
        )
        given = ua.CreateMonitoredItemsParameters(
            self.subscription.subscription_id, ua.TimestampsToReturn.Both, [item]
        )
        (result,) = await self.client.uaclient.create_monitored_items(given)
        if result.StatusCode.is_good():
            known = self.subscription._monitored_items[1] = type("Item", (), {})()
            known.mfilter = item.RequestedParameters.Filter
            known.server_handle, known.client_handle = result.MonitoredItemId, 1
        return result

    async def refresh(self) -> list[Any]:
        """Return the events of conditions that a refresh brings."""
        self.events.clear()
        number = ua.Variant(self.subscription.subscription_id, ua.VariantType.UInt32)
        kind = self.client.get_node(ua.ObjectIds.ConditionType)
        await kind.call_method("0:ConditionRefresh", number)
        end = ua.NodeId(ua.ObjectIds.RefreshEndEventType)
        await until(lambda: any(one.EventType == end for one in self.events))
        return [one for one in self.events if one.ConditionName]


async def until(met: Callable[[], Any]) -> None:
    end = time.monotonic() + PATIENCE
    while not met():
        assert time.monotonic() < end
        await asyncio.sleep(0.01)


def connected(served: Served, work: Callable[[Listened], Awaitable[None]]) -> None:
    async def run() -> None:
        async with Client(served.url, timeout=PATIENCE) as client:
            await work(Listened(client))

    asyncio.run(run())


def test_a_silence_and_its_end_are_events_with_their_own_id_and_time(served: Served) -> None:
    async def work(one: Listened) -> None:
        served.hear(heard(alarm()))
        await one.watch()
        (before,) = await one.refresh()
        one.events.clear()
        served.hear(heard(alarm()), now=100.0)
        served.hear(heard(alarm()), now=101.0)  # still silent: nothing changed
        served.hear(heard(alarm(), at=102.0), now=102.0)
        served.hear(heard(alarm(), at=102.0), now=200.0)
        served.hear(heard(alarm(), at=202.0), now=202.0)
        await until(lambda: len(one.events) == 4)
        lost = [event.Quality.value == CODES.BadNoCommunication for event in one.events]
        assert lost == [True, False, True, False]
        identities = [event.EventId for event in (before, *one.events)]
        times = [event.Time for event in (before, *one.events)]
        assert len(set(identities)) == 5
        assert times == sorted(times)
        assert times[0].timestamp() == BEGAN
        assert abs(times[-1].timestamp() - time.time()) < PATIENCE
        (again,) = await one.refresh()
        assert (again.EventId, again.Time) == (identities[-1], times[-1])

    connected(served, work)


def test_comment_and_user_of_an_event_are_of_the_same_act(served: Served) -> None:
    async def work(one: Listened) -> None:
        kept = alarm(OTHER, state=Alarm.STATE_ACKNOWLEDGED)
        kept.acknowledged_by, kept.comment = "anna", "part is ordered"
        shelved = alarm(OTHER, at=BEGAN + 1, state=Alarm.STATE_SHELVED)
        shelved.acknowledged_by, shelved.comment, shelved.hidden_by = "anna", "part is ordered", "ben"
        await one.watch()
        for state in (kept, shelved, kept):  # acknowledged, shelved without a comment, unshelved
            served.hear(heard(state, name="valve_5"))
        await until(lambda: len(one.events) == 3)
        told = [(event.ClientUserId, event.Comment.Text or "") for event in one.events]
        assert told == [("anna", "part is ordered"), ("ben", ""), ("anna", "part is ordered")]

    connected(served, work)


def test_a_server_that_starts_again_gives_an_alarm_the_event_id_that_it_had(served: Served) -> None:
    async def identity(place: Served) -> bytes:
        found = []

        async def work(one: Listened) -> None:
            await one.watch()
            found.extend(event.EventId for event in await one.refresh() if event.ConditionName == WEAR)

        async with Client(place.url, timeout=PATIENCE) as client:
            await work(Listened(client))
        return bytes(found[0])

    other = Served()
    served.hear(heard(alarm(WEAR), name="valve_9"))
    other.hear(HeardValve("valve_9", alarms=AlarmList(alarms=[alarm(WEAR)])))  # its alarms come first
    other.hear(heard(alarm(WEAR), name="valve_9"))
    assert asyncio.run(identity(served)) == asyncio.run(identity(other))
    other.wait(other.server.stop())


def literal(value: Any) -> ua.LiteralOperand:
    return ua.LiteralOperand(ua.Variant(value))


def selected(*path: str) -> ua.SimpleAttributeOperand:
    names = [ua.QualifiedName(name) for name in path]
    return ua.SimpleAttributeOperand(ua.NodeId(ua.ObjectIds.BaseEventType), names, ua.AttributeIds.Value)


def where(*elements: tuple[ua.FilterOperator, list[Any]]) -> ua.ContentFilter:
    return ua.ContentFilter([ua.ContentFilterElement(*one) for one in elements])


def of_type(number: int) -> tuple[ua.FilterOperator, list[Any]]:
    return OPERATOR.OfType, [literal(ua.NodeId(number))]


CONDITION, ALARM, DIALOG = (
    getattr(ua.ObjectIds, name) for name in ("ConditionType", "AlarmConditionType", "DialogConditionType")
)
UNSUPPORTED = CODES.BadFilterOperatorUnsupported
BOTH = OPERATOR.And, [ua.ElementOperand(1), ua.ElementOperand(2)]


@pytest.mark.parametrize(
    ("wanted", "seen"),
    [
        (where(BOTH, of_type(CONDITION), of_type(ALARM)), True),
        (where(BOTH, of_type(ALARM), of_type(CONDITION)), True),
        (where(BOTH, of_type(ALARM), of_type(DIALOG)), False),
        (where((OPERATOR.Or, BOTH[1]), of_type(ALARM), of_type(DIALOG)), True),
        (where((OPERATOR.Not, [ua.ElementOperand(1)]), of_type(ALARM)), False),
        (where((OPERATOR.Equals, [selected("EventType"), literal(ua.NodeId(ALARM))])), False),
        (where((OPERATOR.Equals, [selected("ActiveState", "Id"), literal(True)])), True),
        (where((OPERATOR.Equals, [selected("ActiveState", "Id"), literal(False)])), False),
        (where((OPERATOR.GreaterThanOrEqual, [selected("Severity"), literal(800)])), True),
        (where((OPERATOR.InList, [selected("SourceName"), literal("valve_1"), literal("b")])), True),
        (where((OPERATOR.GreaterThan, [selected("Nothing"), literal(1)])), False),
        (
            where((OPERATOR.Not, [ua.ElementOperand(1)]), (OPERATOR.LessThan, [literal("a"), literal(1)])),
            False,
        ),
        (where(*((OPERATOR.Or, 2 * [ua.ElementOperand(n)]) for n in range(1, 60)), of_type(ALARM)), True),
    ],
)
def test_filters_let_pass_what_they_say(served: Served, wanted: ua.ContentFilter, *, seen: bool) -> None:
    async def work(one: Listened) -> None:
        served.hear(heard(alarm()))
        assert (await one.watch(wanted)).StatusCode.is_good()
        assert bool([event for event in await one.refresh() if event.ConditionName == SILENCE]) is seen

    connected(served, work)


@pytest.mark.parametrize(
    ("wanted", "code"),
    [
        (where((OPERATOR.Like, [selected("SourceName"), literal("valve%")])), UNSUPPORTED),
        (where((OPERATOR.Cast, [selected("Severity"), literal(ua.NodeId(6))])), UNSUPPORTED),
        (where((OPERATOR.BitwiseAnd, [selected("Severity"), literal(1)])), UNSUPPORTED),
        (where((OPERATOR.InView, [literal(ua.NodeId(85))])), UNSUPPORTED),
        (where((OPERATOR.And, [literal(True)])), CODES.BadFilterOperandCountMismatch),
        (where((OPERATOR.Not, [ua.ElementOperand(0)])), CODES.BadFilterOperandInvalid),
        (where((OPERATOR.Not, [ua.ElementOperand(7)])), CODES.BadFilterOperandInvalid),
        (where((OPERATOR.OfType, [selected("EventType")])), CODES.BadFilterOperandInvalid),
    ],
)  # fmt: skip
def test_filters_that_cannot_be_evaluated_are_refused_when_they_are_made(
    served: Served, wanted: ua.ContentFilter, code: int
) -> None:
    async def work(one: Listened) -> None:
        result = await one.watch(wanted)
        assert result.StatusCode.value == code
        (told,) = result.FilterResult.WhereClauseResult.ElementResults
        assert told.StatusCode.value == code

    connected(served, work)


def test_values_are_not_watched_with_a_filter_that_is_not_applied(served: Served) -> None:
    async def work(one: Listened) -> None:
        subscription = await one.client.create_subscription(20, one)
        node = one.client.nodes.server_state
        with pytest.raises(ua.uaerrors.BadMonitoredItemFilterUnsupported):
            await subscription.deadband_monitor(node, 1.0, deadbandtype=2)
        assert await subscription.deadband_monitor(node, 1.0, deadbandtype=1)

    connected(served, work)


async def declared(client: Client, kind: Any, path: tuple[str, ...] = ()) -> set[tuple[str, ...]]:
    """Return the paths of all mandatory parts that a type and those above declare, by the standard alone."""
    found: set[tuple[str, ...]] = set()
    forward = ua.BrowseDirection.Forward
    for one in await kind.get_references(ua.ObjectIds.Aggregates, forward):
        node = client.get_node(one.NodeId)
        rules = await node.get_references(ua.ObjectIds.HasModellingRule, forward)
        if any(rule.BrowseName.Name == "Mandatory" for rule in rules):
            place = (*path, one.BrowseName.to_string())
            found.add(place)
            if one.NodeClass != ua.NodeClass.Method:
                found |= await declared(client, node, place)
    if not path:
        above = await kind.get_referenced_nodes(ua.ObjectIds.HasSubtype, ua.BrowseDirection.Inverse)
        for one in above:
            found |= await declared(client, one)
    return found


def test_conditions_have_all_mandatory_parts_with_the_state_that_events_say(served: Served) -> None:
    async def work(one: Listened) -> None:
        served.hear(heard(alarm(), alarm(WEAR, state=Alarm.STATE_ACKNOWLEDGED)))
        await one.watch()
        await one.refresh()
        index = await one.client.get_namespace_index(NAMESPACE)
        valve = one.client.get_node(ua.NodeId("valve_1", index))
        conditions = await valve.get_referenced_nodes(ua.ObjectIds.HasCondition, ua.BrowseDirection.Forward)
        assert len(conditions) >= 2
        for node in conditions:
            kind = one.client.get_node(await node.read_type_definition())
            wanted = await declared(one.client, kind)
            assert len(wanted) >= 33
            for path in wanted:
                await node.get_child(list(path))
            name = await (await node.get_child("0:ConditionName")).read_value()
            event = [each for each in one.events if each.ConditionName == name][-1]
            for said in ("EventId", "Retain", "Severity", "Time", "Message"):
                value = await (await node.get_child(f"0:{said}")).read_value()
                assert value == getattr(event, said)

    connected(served, work)


def test_own_nodes_are_named_in_the_own_namespace_and_values_have_times(served: Served) -> None:
    """Namespace 0 is left to names that a type declares (OPC 10000-3, 5.2.4)."""

    async def work(one: Listened) -> None:
        served.hear(heard(alarm()))
        index = await one.client.get_namespace_index(NAMESPACE)
        todo, seen, foreign, timeless = [one.client.nodes.objects], set(), [], []
        while todo:
            for child in await todo.pop().get_references(
                ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward
            ):
                if child.NodeId.NamespaceIndex != index or child.NodeId in seen:
                    if child.NodeId.NamespaceIndex and child.NodeId not in seen:
                        todo.append(one.client.get_node(child.NodeId))
                        seen.add(child.NodeId)
                    continue
                seen.add(child.NodeId)
                node = one.client.get_node(child.NodeId)
                todo.append(node)
                if child.BrowseName.NamespaceIndex == 0:
                    foreign.append((child.NodeId.Identifier, child.BrowseName.Name))
                if child.NodeClass == ua.NodeClass.Variable:
                    value = await node.read_data_value(raise_on_bad_status=False)
                    if value.SourceTimestamp is None and ".estimate." in child.NodeId.Identifier:
                        timeless.append(child.NodeId.Identifier)
        standard = {"EngineeringUnits", "EURange", "CurrentState", "Id", "Rate", "Reset"}
        own = [pair for pair in foreign if pair[1] not in standard and "conditions" not in pair[0]]
        assert [pair for pair in own if "AlarmMetrics" not in pair[0]] == []
        assert timeless == []
        assert len(seen) > 50

    connected(served, work)


def test_an_inventory_finds_this_suite_with_its_version(served: Served) -> None:
    async def work(one: Listened) -> None:
        built = await one.client.get_node(ua.ObjectIds.Server_ServerStatus_BuildInfo).read_value()
        assert (built.ProductName, built.SoftwareVersion) == ("spool valves", package_version())
        assert built.ProductUri.startswith("urn:spool-suite")
        (name,) = await one.client.get_node(ua.ObjectIds.Server_ServerArray).read_value()
        (server,) = await one.client.find_servers()
        assert name == server.ApplicationUri
        assert server.ProductUri == built.ProductUri
        assert server.ApplicationName.Text == "spool valves"
        for words in (name, *await one.client.get_namespace_array(), str(built), str(server)):
            assert "freeopcua" not in words.lower()

    connected(served, work)
