"""What OPC UA clients get of messages whose values all differ, and what their methods ask of the monitor."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from spool_core.node import qos
from spool_core.opcua_folder import keep_operator
from spool_msgs.msg import Alarm, AlarmList, ModelEstimate, Quantity, ValveHealth
from spool_msgs.srv import AcknowledgeAlarm, ResetAlarms, ShelveAlarm
from spool_tools.operations.opcua_certificate import make_server, trust

EPOCH, PATIENCE = 1_790_000_000, 180.0
OPERATOR, PASSWORD = "anna", "a good secret"
NAME = "friction_drift/coulomb_force"
#: Value of each parameter, none of them the default.
GIVEN = {
    "address": "127.0.0.2", "machine": "press 7", "manufacturer": "Acme", "serial_number": "A-12",
    "product_uri": "urn:acme:a-12", "language": "de",
}  # fmt: skip


def at(second: float) -> datetime:
    return datetime.fromtimestamp(EPOCH + second, timezone.utc)


@dataclass
class Served:
    """The node with all of its parameters, a stand-in of the monitor, and a client's certificate."""

    folder: Path
    port: int
    publish: Callable[..., None]
    asked: list[Any] = field(default_factory=list)

    async def client(self, *languages: str, operator: bool = False) -> Any:
        """Return a client that is not connected yet."""
        from asyncua import Client, ua  # noqa: PLC0415 - slow to load
        from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256  # noqa: PLC0415

        client = Client(f"opc.tcp://{GIVEN['address']}:{self.port}", timeout=PATIENCE)
        client.application_uri = "urn:test:client"
        names = ("client.der", "client.pem")
        await client.set_security(
            SecurityPolicyBasic256Sha256, *(str(self.folder.parent / name) for name in names),
            server_certificate=str(self.folder / "server.cert.pem"),
            mode=ua.MessageSecurityMode.SignAndEncrypt,
        )  # fmt: skip
        client.set_locale(list(languages))
        if operator:
            client.set_user(OPERATOR)
            client.set_password(PASSWORD)
        return client


async def _identity(folder: Path) -> Path:
    from asyncua.crypto.cert_gen import setup_self_signed_certificate  # noqa: PLC0415 - slow to load
    from cryptography.x509.oid import ExtendedKeyUsageOID  # noqa: PLC0415

    certificate = folder / "client.der"
    await setup_self_signed_certificate(
        folder / "client.pem",
        certificate,
        "urn:test:client",
        "localhost",
        [ExtendedKeyUsageOID.CLIENT_AUTH],
        {},
    )
    return certificate


@pytest.fixture(scope="module", name="served")
def _served(
    claim_domain: Callable[[], AbstractContextManager[int]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Served]:
    from spool_view.opcua_node import OpcUaNode  # noqa: PLC0415 - slow to load

    folder = tmp_path_factory.mktemp("served") / "security"
    make_server(folder)
    keep_operator(folder, OPERATOR, PASSWORD)
    trust(folder, asyncio.run(_identity(folder.parent)))
    with claim_domain() as number, socket.socket() as probe:
        probe.bind((GIVEN["address"], 0))
        port = probe.getsockname()[1]
        probe.close()
        rclpy.init(domain_id=number)
        node = OpcUaNode()
        node.alone = False
        other = Context()
        rclpy.init(context=other, domain_id=number)
        monitor = rclpy.create_node("monitor", namespace="/valve_1", context=other)
        kinds = {"alarms": AlarmList, "health": ValveHealth, "estimate": ModelEstimate}
        publishers = {
            name: monitor.create_publisher(kind, f"/valve_1/{name}", qos.state())
            for name, kind in kinds.items()
        }

        def publish(**messages: Any) -> None:
            for name, message in messages.items():
                publishers[name].publish(message)

        served = Served(folder, port, publish)

        def answer(request: Any, response: Any) -> Any:
            served.asked.append(request)
            response.success = True
            return response

        monitor.create_service(AcknowledgeAlarm, "~/acknowledge_alarm", answer)
        monitor.create_service(ShelveAlarm, "~/shelve_alarm", answer)
        monitor.create_service(ResetAlarms, "~/reset_alarms", answer)
        monitor.create_service(GetState, "~/get_state", lambda _, response: response)
        values = {**GIVEN, "security_folder": str(folder), "port": port}
        assert set(values) == {one.name for one in node.PARAMETERS}
        node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        assert (
            node.trigger_configure()
            == node.trigger_activate()
            == rclpy.lifecycle.TransitionCallbackReturn.SUCCESS
        )
        ended = threading.Event()
        executors = [SingleThreadedExecutor(context=one) for one in (node.context, other)]

        def spin(executor: SingleThreadedExecutor) -> None:
            while not ended.is_set():
                executor.spin_once(timeout_sec=0.05)

        threads = [threading.Thread(target=spin, args=(one,)) for one in executors]
        for executor, one, thread in zip(executors, (node, monitor), threads, strict=True):
            executor.add_node(one)
            thread.start()
        yield served
        ended.set()
        for executor, thread in zip(executors, threads, strict=True):
            thread.join()
            executor.shutdown()
        node.trigger_shutdown()
        node.destroy_node()
        monitor.destroy_node()
        rclpy.shutdown(context=other)
        rclpy.shutdown()


class Heard:
    """Events that a client got."""

    def __init__(self) -> None:
        self.events: list[Any] = []

    def event_notification(self, event: Any) -> None:
        self.events.append(event)


async def until(met: Callable[[], Any], what: str) -> Any:
    end = time.monotonic() + PATIENCE
    while not (found := met()):
        assert time.monotonic() < end, f"waited in vain: {what}"
        await asyncio.sleep(0.02)
    return found


async def event_of(client: Any, publish: Callable[[], None], met: Callable[[Any], bool]) -> Any:
    """Return the first event of the alarm that is ``met`` once ``publish`` was called."""
    from asyncua import ua  # noqa: PLC0415 - slow to load

    heard = Heard()
    subscription = await client.create_subscription(20, heard)
    await subscription.subscribe_alarms_and_conditions(client.nodes.server, ua.ObjectIds.AlarmConditionType)
    publish()
    found = await until(
        lambda: next((one for one in heard.events if one.ConditionName == NAME and met(one)), None),
        "an event",
    )
    await subscription.delete()
    return found


async def read(client: Any, *names: str) -> list[Any]:
    """Return what nodes of the server's own namespace hold, once they are there."""
    from asyncua import ua  # noqa: PLC0415 - slow to load

    index = await client.get_namespace_index("urn:spool-suite:valves")
    found = []
    for name in names:
        end, node = time.monotonic() + PATIENCE, client.get_node(ua.NodeId(name, index))
        while True:
            try:
                found.append(await node.read_data_value(raise_on_bad_status=False))
                break
            except ua.UaError:
                assert time.monotonic() < end, f"waited in vain: {name}"
                await asyncio.sleep(0.1)
    return found


def test_clients_see_every_parameter_of_the_node(served: Served) -> None:
    names = ("Manufacturer", "SerialNumber", "ProductInstanceUri", "ComponentName")

    async def work() -> None:
        async with await served.client() as client:
            plate = await read(client, *(f":machine.Identification.{name}" for name in names))
            found = [getattr(one.Value.Value, "Text", one.Value.Value) for one in plate]
            assert found == [
                GIVEN[one] for one in ("manufacturer", "serial_number", "product_uri", "machine")
            ]
            endpoints = await client.get_endpoints()
            assert {one.EndpointUrl.split("/")[2] for one in endpoints} == {
                f"{GIVEN['address']}:{served.port}"
            }
            assert {one.ServerCertificate for one in endpoints} == {endpoints[0].ServerCertificate} != {b""}

    asyncio.run(work())


def test_a_client_reads_every_value_of_an_alarm_a_health_and_an_estimate(
    served: Served, distinct_alarm: Alarm
) -> None:
    def number(name: str, unit: str, value: float) -> Quantity:
        return Quantity(name=name, unit=unit, value=value, standard_deviation=value / 8, validity=1)

    health = ValveHealth(
        level=ValveHealth.LEVEL_WARNING, namur=ValveHealth.NAMUR_FUNCTION_CHECK, summary="wears",
        active=["resonance", "wear"], dominant_frequency=number("dominant_frequency", "Hz", 24.0),
        amplification=number("amplification", "1", 2.0), viscous_drift=number("viscous_drift", "", 0.5),
        coulomb_drift=number("coulomb_drift", "", 0.25),
    )  # fmt: skip
    health.header.stamp.sec = EPOCH + 8
    estimate = ModelEstimate(
        parameters=[number("mass", "kg", 0.125)], natural_frequency=number("natural_frequency", "Hz", 28.0),
        damping_ratio=number("damping_ratio", "1", 0.0625), residual=number("residual", "1", 0.03125),
    )  # fmt: skip
    estimate.header.stamp.sec = EPOCH + 9
    alarm: dict[str, Any] = {
        "state": "shelved", "severity": 1, "code": 201, "cause": "wear", "acknowledged by": "Eva",
        "parameter": "coulomb_force", "unit": "N", "causes": "wear, unknown", "probabilities": "0.7, 0.25",
        "urgency": "soon", "advice": 201, "subject": "spool", "note": "a remark", "value": 0.71, "low": 0.62,
        "high": 0.83, "baseline": 0.51, "change": 0.20, "limit": 0.66, "false alarm interval": 3.6e6,
        "time to limit": 8.64e4, "began": at(1).isoformat(timespec="milliseconds"),
    }  # fmt: skip
    numbers = {
        "health": {
            "dominant_frequency [Hz]": 24.0, "amplification": 2.0, "viscous_drift": 0.5, "coulomb_drift": 0.25
        },
        "estimate": {
            "mass [kg]": 0.125, "natural_frequency [Hz]": 28.0, "damping_ratio": 0.0625, "residual": 0.03125
        },
    }  # fmt: skip
    expected = {
        "valve_1.condition": ("warning", None),
        "valve_1.health.level": (ValveHealth.LEVEL_WARNING, at(8)),
        "valve_1.health.ne107": ("function check", at(8)),
        "valve_1.health.summary": ("wears", at(8)),
        "valve_1.health.active": ("resonance, wear", at(8)),
        **{f"valve_1.alarms.{NAME}.{name}": (value, at(5.25)) for name, value in alarm.items()},
        **{
            f"valve_1.{group}.{name}{end}": (value / divisor, at(8 if group == "health" else 9))
            for group, values in numbers.items()
            for name, value in values.items()
            for end, divisor in (("", 1), (" standard deviation", 8))
        },
    }

    async def work() -> None:
        async with await served.client() as client:
            end = time.monotonic() + PATIENCE
            while True:
                served.publish(health=health, estimate=estimate, alarms=AlarmList(alarms=[distinct_alarm]))
                values = await read(client, *expected)
                found = [(one.Value.Value, one.SourceTimestamp) for one in values]
                found = [(value, stamp and stamp.replace(tzinfo=timezone.utc)) for value, stamp in found]
                if found == list(expected.values()):
                    break
                assert time.monotonic() < end, (dict(zip(expected, found, strict=True)), expected)
            (text,) = await read(client, f"valve_1.alarms.{NAME}.message")
            assert text.Value.Value.startswith("Reibung")  # as the parameter "language" says

    asyncio.run(work())


def fields(event: Any) -> dict[str, Any]:
    """Return the fields of an event in plain words."""
    plain = {}
    for name, value in event.get_event_props_as_fields_dict().items():
        found = value.Value
        found = getattr(found, "Text", found)
        found = getattr(found, "name", found)
        plain[name] = found.replace(tzinfo=timezone.utc) if isinstance(found, datetime) else found
    return plain


#: Fields of an event by their names; times are of the seconds of the message's stamps.
CONDITION = {
    "SourceName": "valve_1", "ConditionName": NAME, "Severity": 834, "LastSeverity": 500, "Quality": "Good",
    "Time": at(5.25), "Quality/SourceTimestamp": at(5.25), "LastSeverity/SourceTimestamp": at(5.25),
    "Comment": "wait for the part", "Comment/SourceTimestamp": at(4), "ClientUserId": "Eva", "Retain": True,
    "ConditionClassName": "MaintenanceConditionClassType", "MaxTimeShelved": 604_800e3,
    "SuppressedOrShelved": True, "EnabledState": "Enabled", "EnabledState/Id": True,
    "ActiveState": "Active", "ActiveState/Id": True, "AckedState": "Acknowledged", "AckedState/Id": True,
    "ConfirmedState": "Confirmed", "ConfirmedState/Id": True, "LatchedState": "Not latched",
    "LatchedState/Id": False, "SuppressedState": "Unsuppressed", "SuppressedState/Id": False,
    "OutOfServiceState": "In service", "OutOfServiceState/Id": False,
    "ShelvingState/CurrentState": "TimedShelved",
}  # fmt: skip


def test_every_field_of_a_condition_is_that_of_the_alarm(served: Served, distinct_alarm: Alarm) -> None:
    def publish() -> None:
        served.publish(health=ValveHealth(), alarms=AlarmList(alarms=[distinct_alarm]))

    distinct_alarm.comment = "before"

    async def work() -> None:
        async with await served.client() as client:
            await event_of(
                client, publish, lambda one: one.Comment.Text == "before" and one.Quality.is_good()
            )
            distinct_alarm.severity, distinct_alarm.comment = 2, "wait for the part"
            event = await event_of(client, publish, lambda one: one.Severity == 834)
            found = fields(event)
            assert {name: found[name] for name in CONDITION} == CONDITION
            left = distinct_alarm.shelved_until.sec - time.time()
            assert left < 1e-3 * found["ShelvingState/UnshelveTime"] < left + PATIENCE
            (kind,) = await client.get_node(event.EventType).get_referenced_nodes(45, 1, includesubtypes=True)
            assert (await kind.read_browse_name()).Name == "DeviceHealthDiagnosticAlarmType"
            assert event.NodeId.Identifier == f"valve_1.conditions.{NAME}.M"  # wear asks for maintenance

    asyncio.run(work())


def test_a_condition_has_the_states_of_the_standard(served: Served, distinct_alarm: Alarm) -> None:
    names = [
        f"{name}State/Id"
        for name in ("Active", "Acked", "Confirmed", "Latched", "Suppressed", "OutOfService")
    ]
    states = {
        ("UNACKNOWLEDGED", ""): (True, False, True, False, False, False, "Unshelved", True),
        ("ACKNOWLEDGED", ""): (True, True, True, False, False, False, "Unshelved", True),
        ("RETURNED_UNACKNOWLEDGED", ""): (False, False, True, False, False, False, "Unshelved", True),
        ("LATCHED_UNACKNOWLEDGED", ""): (False, False, False, True, False, False, "Unshelved", True),
        ("LATCHED_ACKNOWLEDGED", ""): (False, True, False, True, False, False, "Unshelved", True),
        ("SHELVED", "LATCHED_ACKNOWLEDGED"): (False, True, False, True, False, False, "OneShotShelved", True),
        ("SUPPRESSED", "ACKNOWLEDGED"): (True, True, True, False, True, False, "Unshelved", True),
        ("OUT_OF_SERVICE", "UNACKNOWLEDGED"): (True, False, True, False, False, True, "Unshelved", True),
        ("NORMAL", ""): (False, True, True, False, False, False, "Unshelved", False),
    }
    distinct_alarm.shelved_until.sec = 0

    async def work() -> None:
        async with await served.client() as client:
            for (state, underlying), expected in states.items():
                distinct_alarm.state = getattr(Alarm, f"STATE_{state}")
                distinct_alarm.underlying = getattr(Alarm, f"STATE_{underlying or state}")
                distinct_alarm.comment = said = f"{state} over {underlying}"
                listed = AlarmList(alarms=[distinct_alarm])
                event = fields(
                    await event_of(
                        client,
                        lambda listed=listed: served.publish(alarms=listed),
                        lambda one, said=said: one.Comment.Text == said,
                    )
                )
                found = *(event[name] for name in names), event["ShelvingState/CurrentState"], event["Retain"]
                assert found == expected, said

    asyncio.run(work())


@pytest.mark.parametrize(
    ("languages", "headline"),
    [(["pl-PL"], "Dryf tarcia"), (["fr-FR", "en-US", "pl"], "Friction drift"), (["fr-FR"], "Reibungsdrift")],
)
def test_a_client_gets_alarms_in_its_language_or_in_that_of_the_node(
    served: Served, distinct_alarm: Alarm, languages: list[str], headline: str
) -> None:
    distinct_alarm.comment = said = str(languages)

    async def work() -> None:
        async with await served.client(*languages) as client:
            event = await event_of(
                client,
                lambda: served.publish(alarms=AlarmList(alarms=[distinct_alarm])),
                lambda one: one.Comment.Text == said,
            )
            assert event.Message.Text.startswith(headline)

    asyncio.run(work())


def test_methods_of_the_standard_ask_the_monitor_for_the_same(served: Served, distinct_alarm: Alarm) -> None:
    """Durations are ms for the client and s for the monitor."""
    from asyncua import ua  # noqa: PLC0415 - slow to load

    distinct_alarm.state = distinct_alarm.underlying = Alarm.STATE_LATCHED_UNACKNOWLEDGED
    distinct_alarm.occurrence, distinct_alarm.comment = 9, "before methods"
    who = {"alarm": NAME, "who": OPERATOR}
    said = ua.LocalizedText("seen", "en")

    async def work() -> None:
        async with await served.client(operator=True) as client:
            publish = lambda: served.publish(alarms=AlarmList(alarms=[distinct_alarm]))  # noqa: E731
            event = await event_of(client, publish, lambda one: one.Comment.Text == "before methods")
            condition, served.asked[:] = client.get_node(event.NodeId), []
            for name, arguments in (
                ("AcknowledgeableConditionType_Acknowledge", (event.EventId, said)),
                ("AcknowledgeableConditionType_Confirm", (event.EventId, said)),
                ("AlarmConditionType_ShelvingState_TimedShelve", (90e3,)),
                ("ShelvedStateMachineType_OneShotShelve2", (said,)),
            ):
                await condition.call_method(ua.NodeId(getattr(ua.ObjectIds, name)), *arguments)
            distinct_alarm.state, distinct_alarm.comment = Alarm.STATE_SHELVED, "on the shelf"
            await event_of(client, publish, lambda one: one.Comment.Text == "on the shelf")
            await condition.call_method(ua.NodeId(ua.ObjectIds.ShelvedStateMachineType_Unshelve))
            with pytest.raises(ua.uaerrors.BadShelvingTimeOutOfRange):
                await condition.call_method(
                    ua.NodeId(ua.ObjectIds.ShelvedStateMachineType_TimedShelve), 604_800_001.0
                )

    asyncio.run(work())
    assert served.asked == [
        AcknowledgeAlarm.Request(**who, occurrence=9, comment="seen"),
        ResetAlarms.Request(**who, comment="seen"),
        ShelveAlarm.Request(**who, shelved=True, duration=90.0),
        ShelveAlarm.Request(**who, shelved=True, duration=0.0, comment="seen"),
        ShelveAlarm.Request(**who, shelved=False),
    ]
