"""Alarms as OPC UA conditions: clients find, receive, refresh and acknowledge them, but only as operators."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, Node, ua
from spool_core.opcua_folder import keep_operator, make_server, trust
from spool_msgs.msg import AlarmList, ValveHealth

from .conftest import PATIENCE, Process, System
from .opcua import OPERATOR, free_port, identity, listens, secured, subscribed, until

SILENCE = "stale/acceleration"
DI = "http://opcfoundation.org/UA/DI/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"
NAMESPACE = "urn:spool-suite:valves"


@dataclass
class Plant:
    """A monitor whose valve is silent, a secured OPC UA server, and certificates of two clients."""

    system: System
    port: int
    server: Process
    folder: Path
    trusted: tuple[Path, Path]
    untrusted: tuple[Path, Path]

    @property
    def url(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.port}"

    def client(self, who: tuple[Path, Path], *policy: str, **user: str) -> Awaitable[Client]:
        return secured(self.url, self.folder, who, *policy, **user)


@pytest.fixture(scope="module", name="plant")
def _plant(
    make_system: Callable[[Path], AbstractContextManager[System]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Plant]:
    folder = tmp_path_factory.mktemp("opcua")
    own = folder / "security"
    make_server(own)
    keep_operator(own, *OPERATOR.values())
    trusted, untrusted = (asyncio.run(identity(folder / name)) for name in ("trusted", "untrusted"))
    trust(own, trusted[0])
    with make_system(tmp_path_factory.mktemp("conditions")) as system:
        port = free_port()
        alarms = system.listen(AlarmList, "/valve_1/alarms", latched=True)
        health = system.listen(ValveHealth, "/valve_1/health", latched=True)
        system.start("monitor", latched_kinds="[stale]")
        system.start("estimator")
        plate = {"machine": "press_7", "serial_number": "A-12"}
        server = system.start("opcua", namespace="", port=port, security_folder=own, **plate)
        listeners = partial(system.node.count_subscribers, "/valve_1/estimate")
        system.until(lambda: listeners() >= 2, "monitor and server listen")
        source = system.start("simulator", excitation="multisine", wait_for_subscribers=2)
        system.until(lambda: health.heard and health.last.level == ValveHealth.LEVEL_OK, "data are judged")
        source.kill()
        system.until(lambda: alarms.heard and SILENCE in _names(alarms.last), "the monitor misses its data")
        system.until(lambda: listens(port), "the server starts")
        yield Plant(system, port, server, own, trusted, untrusted)


def _names(message: AlarmList) -> list[str]:
    return [one.name for one in message.alarms if one.state != one.STATE_NORMAL]


def test_a_client_that_knows_the_standard_finds_conditions_and_gets_them_late(plant: Plant) -> None:
    """It begins at the server and knows types of OPC 10000-9 and DI, none of our names."""

    async def work() -> None:
        async with await plant.client(plant.trusted, "Aes256Sha256RsaPss") as client:
            forward = ua.BrowseDirection.Forward
            notifier = client.nodes.server
            for _ in ("machine", "valve"):
                below = partial(notifier.get_referenced_nodes, ua.ObjectIds.HasNotifier, forward)
                (notifier,) = await until(below, "a notifier below")
            valve = notifier

            async def conditions() -> Any:
                return await valve.get_referenced_nodes(ua.ObjectIds.HasCondition, forward)

            kinds = [await one.read_type_definition() for one in await until(conditions, "conditions")]
            index, own = [await client.get_namespace_index(uri) for uri in (DI, NAMESPACE)]
            names = [await client.get_node(one).read_browse_name() for one in kinds]
            assert {(one.Name, one.NamespaceIndex) for one in names} <= {
                (f"{name}AlarmType", index)
                for name in ("Failure", "CheckFunction", "OffSpec", "MaintenanceRequired")
            }
            folder = await client.nodes.objects.get_child(f"{own}:Valves")  # for those that knew it before
            for node in (client.nodes.server, folder, valve):
                subscription, heard = await subscribed(client, node)
                event = await heard.first(SILENCE)
                assert event.EventType in kinds
                assert getattr(event, "ActiveState/Id") is True
                assert event.Retain is True
                assert event.SourceNode == valve.nodeid
                heard.events.clear()
                kind = client.get_node(ua.ObjectIds.ConditionType)
                number = ua.UInt32(subscription.subscription_id)
                await kind.call_method("0:ConditionRefresh2", number, ua.UInt32(heard.item))
                again = await heard.first(SILENCE)
                assert again.EventId == event.EventId
                await subscription.delete()

    asyncio.run(work())


def test_a_client_finds_machine_and_valves_by_the_types_of_opc_40001(plant: Plant) -> None:
    """It knows OPC 40001-1, DI and the codes of UNECE, none of our names."""

    async def work() -> None:
        async with await plant.client(plant.trusted) as client:
            machinery, di = [await client.get_namespace_index(uri) for uri in (MACHINERY, DI)]

            async def parts(node: Node, kind: int) -> list[Node]:
                """Return what ``node`` has of that type of Machinery."""
                found = await node.get_children()
                kinds = [await one.read_type_definition() for one in found]
                wanted = ua.NodeId(kind, machinery)
                return [one for one, its in zip(found, kinds, strict=True) if its == wanted]

            async def value(node: Node, *path: str) -> Any:
                return (await (await node.get_child(list(path))).read_data_value(False)).Value.Value

            listed = await client.get_node(ua.NodeId(1001, machinery)).get_children()
            machines = [one for one in listed if await parts(one, 1012)]
            (identified,) = await parts(machines[0], 1012)
            assert len(machines) == 1
            assert (await machines[0].read_display_name()).Text == "press_7"
            assert await value(identified, f"{di}:SerialNumber") == "A-12"
            (components,) = await parts(machines[0], 1006)
            (valve,) = [one for one in await components.get_children() if await parts(one, 1005)]
            notifiers = partial(machines[0].get_referenced_nodes, ua.ObjectIds.HasNotifier)
            assert valve in await until(notifiers, "the valve notifies")
            health = f"{machinery}:Monitoring", f"{machinery}:Health", f"{di}:DeviceHealth"
            for node in (machines[0], valve):

                async def failed(node: Node = node) -> bool:
                    return bool(await value(node, *health) == 1)

                await until(failed, "no data come")
            (monitoring,) = await parts(valve, 1014)
            process = await monitoring.get_child(f"{machinery}:Process")

            async def known() -> bool:
                units = [await value(one, "0:EngineeringUnits") for one in await process.get_children()]
                codes = {one.UnitId.to_bytes(3, "big").strip(b"\0") for one in units}
                return {b"HTZ", b"NEW", b"4P", b"C58", b"C62"} <= codes

            await until(known, "all values")
            for one in await process.get_children():
                assert await one.read_type_definition() == ua.NodeId(ua.ObjectIds.AnalogUnitType)
            (state,) = await parts(machines[0], 1002)
            shown = await (await state.get_child("0:CurrentState")).read_data_value(False)
            assert not shown.StatusCode.is_good()  # whether a silent valve moves is not known

    asyncio.run(work())


async def _figure(figures: Any, name: str) -> Any:
    return await (await figures.get_child(f"0:{name}")).read_value()


def test_only_the_operator_acts_on_an_alarm_and_on_the_figures_and_sees_it_end_and_come_again(
    plant: Plant,
) -> None:
    acknowledge = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
    shelve = ua.NodeId(ua.ObjectIds.AlarmConditionType_ShelvingState_TimedShelve)
    confirm = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Confirm)
    unshelve = ua.NodeId(ua.ObjectIds.ShelvedStateMachineType_Unshelve)
    reset = ua.NodeId(ua.ObjectIds.AlarmMetricsType_Reset)
    said = ua.LocalizedText("seen from the control room", "en")
    alarms = plant.system.listen(AlarmList, "/valve_1/alarms", latched=True)

    async def work() -> None:
        async with (
            await plant.client(plant.trusted) as onlooker,
            await plant.client(plant.trusted, **OPERATOR) as operator,
        ):
            _, heard = await subscribed(operator, operator.nodes.server)
            shown = await heard.first(SILENCE)
            (machine,) = await operator.nodes.server.get_referenced_nodes(
                ua.ObjectIds.HasNotifier, ua.BrowseDirection.Forward
            )
            kinds = [(one, await one.read_type_definition()) for one in await machine.get_children()]
            (figures,) = [one for one, kind in kinds if kind == ua.NodeId(ua.ObjectIds.AlarmMetricsType)]
            for node, method, arguments in (
                (shown.NodeId, acknowledge, (shown.EventId, said)),
                (shown.NodeId, confirm, (shown.EventId, said)),
                (shown.NodeId, shelve, (60e3,)),
                (shown.NodeId, unshelve, ()),
                (figures.nodeid, reset, ()),
                (onlooker.nodes.server.nodeid, "0:GetMonitoredItems", (ua.UInt32(1),)),
            ):
                with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                    await onlooker.get_node(node).call_method(method, *arguments)
            condition = operator.get_node(shown.NodeId)
            with pytest.raises(ua.uaerrors.BadEventIdUnknown):
                await condition.call_method(acknowledge, b"none of its events", said)
            with pytest.raises(ua.uaerrors.BadConditionBranchAlreadyConfirmed):  # its cause is there
                await condition.call_method(confirm, shown.EventId, said)
            await condition.call_method(acknowledge, shown.EventId, said)
            await heard.first(SILENCE, lambda one: getattr(one, "AckedState/Id") is True)
            with pytest.raises(ua.uaerrors.BadConditionBranchAlreadyAcked):
                await condition.call_method(acknowledge, shown.EventId, said)
            source = plant.system.start("simulator", excitation="multisine", wait_for_subscribers=2)
            try:
                over = await heard.first(SILENCE, lambda one: getattr(one, "ActiveState/Id") is False)
                assert (over.Retain, getattr(over, "ConfirmedState/Id")) == (True, False)
                await condition.call_method(confirm, over.EventId, said)
                await heard.first(SILENCE, lambda one: one.Retain is False)
                figure = partial(_figure, figures)
                before = await figure("StartTime")
                await figures.call_method(reset)

                async def renewed() -> bool:
                    return bool(await figure("StartTime") > before)

                await until(renewed, "the figures begin again")
                assert await figure("AlarmCount") == 0
                heard.events.clear()
            finally:
                source.kill()
            again = await heard.first(SILENCE, lambda one: getattr(one, "ActiveState/Id") is True)
            assert again.EventId not in (shown.EventId, over.EventId)
            assert (again.Retain, getattr(again, "AckedState/Id")) == (True, False)
            await until(lambda: figure("AlarmCount"), "it is counted")
            assert await figure("MaximumAlarmRate") == await figure("CurrentAlarmRate") >= 1.0

    asyncio.run(work())

    def noted() -> bool:
        return any(
            (one.name, one.acknowledged_by, one.state) == (SILENCE, "anna", one.STATE_ACKNOWLEDGED)
            for message in alarms.messages
            for one in message.alarms
        )

    plant.system.until(noted, "the monitor knows who it was")


def test_untrusted_certificates_wrong_passwords_and_open_channels_get_nothing(plant: Plant) -> None:
    async def work() -> None:
        refused = (ua.UaError, ConnectionError, TimeoutError, asyncio.TimeoutError)
        untrusted = await plant.client(plant.untrusted, **OPERATOR)
        untrusted.uaclient._timeout = 5.0
        with pytest.raises(refused):
            await untrusted.connect()
        wrong = await plant.client(plant.trusted, **OPERATOR | {"password": "a wrong secret"})
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            await wrong.connect()
        open_one = Client(plant.url, timeout=5.0)
        with pytest.raises(refused):
            await open_one.connect()
        endpoints = await Client(plant.url, timeout=PATIENCE).connect_and_get_server_endpoints()
        assert {one.SecurityMode for one in endpoints} == {ua.MessageSecurityMode.SignAndEncrypt}
        assert len({one.SecurityPolicyUri for one in endpoints}) == 2

    asyncio.run(work())
    assert plant.server.alive
    assert "Traceback" not in plant.server.said


def test_a_network_address_without_encryption_is_refused(plant: Plant) -> None:
    process = plant.system.start("opcua", namespace="other", port=free_port(), address="0.0.0.0")
    plant.system.until(lambda: not process.alive or "needs encryption" in process.said, "it is refused")
    assert "needs encryption: set security_folder" in process.said
