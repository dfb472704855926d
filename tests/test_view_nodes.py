"""What clients of OPC UA, plotters and browsers get of messages whose values all differ."""

from __future__ import annotations

import asyncio
import json
import socket
import time
import urllib.request
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from lifecycle_msgs.srv import GetState
from spool_core.events.event import Event, EventState, Facts, Severity, Urgency
from spool_core.events.language import ENGLISH
from spool_core.node.messages import to_event_message, to_time
from spool_core.opcua_folder import keep_operator, make_server, trust
from spool_core.uncertainty import Quantity as Measured
from spool_core.uncertainty import Validity
from spool_monitor.state_database import FILE
from spool_msgs.msg import Alarm, AlarmList, ModelEstimate, Quantity, ValveHealth
from spool_msgs.srv import AcknowledgeAlarm, ResetAlarms, ShelveAlarm
from spool_opcua.opcua_node import OpcUaNode
from spool_view.page_node import PageNode
from spool_view.view import alarms_of

from .clocked import PATIENCE, Domains, clocked
from .opcua import OPERATOR, free_port, identity, listens, secured, subscribed, until

#: s since 1970, of which each stamp of a message lies some seconds more.
EPOCH = 1_790_000_000
NAME = "friction_drift/coulomb_force"


def stamp(second: float) -> Any:
    return to_time(EPOCH * 10**9 + round(second * 1e9))


def at(second: float) -> datetime:
    return datetime.fromtimestamp(EPOCH + second, timezone.utc)


#: Numbers of messages by name: unit, value and standard deviation.
PARAMETERS = {"mass": ("kg", 0.2, 0.01), "stiffness": ("N/m", 1700.0, 20.0)}
ESTIMATE = {
    "natural_frequency": ("Hz", 28.0, 1.0), "damping_ratio": ("1", 0.3, 0.02), "residual": ("1", 0.04, 0.003),
    "excitation": ("m/s^2", 5.0, 0.4), "relative_displacement": ("m", 6e-4, 5e-5),
    "oil_temperature": ("deg C", 70.0, 6.0),
}  # fmt: skip
HEALTH = {
    "viscous_drift": ("", 0.8, 0.07), "coulomb_drift": ("", 0.9, 0.08),
    "dominant_frequency": ("Hz", 10.0, 0.9), "amplification": ("1", 1.1, 0.1),
}  # fmt: skip


def quantities(values: dict[str, tuple[str, float, float]]) -> dict[str, Quantity]:
    return {
        name: Quantity(name=name, unit=unit, value=value, standard_deviation=deviation, validity=1)
        for name, (unit, value, deviation) in values.items()
    }


def estimate() -> ModelEstimate:
    found = ModelEstimate(parameters=[*quantities(PARAMETERS).values()], **quantities(ESTIMATE))
    found.header.stamp, found.header.frame_id = stamp(9), "valve of the estimate"
    return found


def health() -> ValveHealth:
    found = ValveHealth(
        level=ValveHealth.LEVEL_WARNING, namur=ValveHealth.NAMUR_FUNCTION_CHECK, summary="wears",
        active=["resonance", "wear"], **quantities(HEALTH),
    )  # fmt: skip
    found.header.stamp, found.header.frame_id = stamp(8), "valve of the health"
    return found


@pytest.fixture(name="alarm")
def _alarm() -> Alarm:
    """Return an acknowledged alarm on the shelf."""
    facts = Facts(
        "coulomb_force", "N", 0.71, 0.62, 0.83, 0.51, 0.20, 0.66, (EPOCH + 1) * 10**9, ("wear", "unknown"),
        (0.7, 0.25), 3.6e6, Urgency.SOON, 8.64e4, 201, "spool", "a remark",
    )  # fmt: skip
    judged = Measured("coulomb_force", "N", 0.72, 0.05, Validity.VALID)
    event = Event(
        (EPOCH + 2) * 10**9, "friction_drift", EventState.RAISED, Severity.ALARM, "wear", judged,
        "coulomb_force", 249, facts,
    )  # fmt: skip
    one = Alarm(
        name="friction_drift/coulomb_force", kind="friction_drift", cause="wear", code=201,
        namur=ValveHealth.NAMUR_FAILURE, state=Alarm.STATE_SHELVED, underlying=Alarm.STATE_ACKNOWLEDGED,
        severity=1, occurrence=5, value=0.73, unit="N", event=to_event_message(event, "press 7", ENGLISH),
        raised_at=stamp(3), acknowledged_at=stamp(4), acknowledged_by="Eva",
        comment="wait for the part", shelved_until=stamp(100_000_006),
    )  # fmt: skip
    one.header.stamp = stamp(5.25)
    one.message = one.event.message
    return one


# Clients of OPC UA.

#: Value of each parameter of the server's node, none of them the default.
GIVEN = {
    "address": "127.0.0.2", "machine": "press 7", "manufacturer": "Acme", "serial_number": "A-12",
    "product_uri": "urn:acme:a-12", "language": "de",
}  # fmt: skip


@dataclass
class Served:
    """The node with all of its parameters and a stand-in of the monitor; ``client`` makes a client."""

    port: int
    client: Callable[..., Awaitable[Client]]
    publish: dict[str, Callable[[Any], None]]
    asked: list[Any] = field(default_factory=list)

    def answer(self, request: Any, response: Any) -> Any:
        self.asked.append(request)
        response.success = True
        return response

    async def show(self, client: Client, alarm: Alarm, comment: str, met: Any = lambda _: True) -> Any:
        """Publish an alarm with this comment; return the event that ``client`` gets of it."""
        alarm.comment = comment
        subscription, heard = await subscribed(client, client.nodes.server)
        self.publish["alarms"](AlarmList(alarms=[alarm]))
        event = await heard.first(NAME, lambda one: one.Comment.Text == comment and met(one))
        await subscription.delete()
        return event


@pytest.fixture(scope="module", name="served")
def _served(claim_domain: Domains, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("served")
    security, who = folder / "security", asyncio.run(identity(folder / "client"))
    make_server(security)
    keep_operator(security, *OPERATOR.values())
    trust(security, who[0])
    values = {**GIVEN, "security_folder": str(security), "port": free_port(GIVEN["address"])}
    assert set(values) == {one.name for one in OpcUaNode.PARAMETERS}
    url = f"opc.tcp://{GIVEN['address']}:{values['port']}"
    with clocked(claim_domain, "valve_1") as nodes:
        kinds = {"alarms": AlarmList, "health": ValveHealth, "estimate": ModelEstimate}
        publish = {name: nodes.offer(kind, name, latched=True) for name, kind in kinds.items()}
        made = Served(values["port"], lambda **options: secured(url, security, who, **options), publish)
        for kind, name in (
            (AcknowledgeAlarm, "acknowledge_alarm"), (ShelveAlarm, "shelve_alarm"),
            (ResetAlarms, "reset_alarms"),
        ):  # fmt: skip
            nodes.observer.create_service(kind, f"monitor/{name}", made.answer)
        nodes.observer.create_service(GetState, "monitor/get_state", lambda _, response: response)
        nodes.start(OpcUaNode, use_sim_time=False, **values)
        with nodes.spinning():
            yield made


async def read(client: Client, *names: str) -> list[Any]:
    """Return what nodes of the server's own namespace hold, once they are there."""
    index = await client.get_namespace_index("urn:spool-suite:valves")

    async def value(name: str) -> Any:
        try:
            return await client.get_node(ua.NodeId(name, index)).read_data_value(raise_on_bad_status=False)
        except ua.UaError:
            return None

    return [await until(lambda name=name: value(name), name) for name in names]


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
            own = f"{GIVEN['address']}:{served.port}"
            assert {one.EndpointUrl.split("/")[2] for one in endpoints} == {own}
            assert {one.ServerCertificate for one in endpoints} == {endpoints[0].ServerCertificate} != {b""}

    asyncio.run(work())


def test_a_client_reads_every_value_of_an_alarm_a_health_and_an_estimate(
    served: Served, alarm: Alarm
) -> None:
    values: dict[str, Any] = {
        "state": "shelved", "severity": 1, "code": 201, "cause": "wear", "acknowledged by": "Eva",
        "parameter": "coulomb_force", "unit": "N", "causes": "wear, unknown", "probabilities": "0.7, 0.25",
        "urgency": "soon", "advice": 201, "subject": "spool", "note": "a remark", "value": 0.71, "low": 0.62,
        "high": 0.83, "baseline": 0.51, "change": 0.20, "limit": 0.66, "false alarm interval": 3.6e6,
        "time to limit": 8.64e4, "began": at(1).isoformat(timespec="milliseconds"),
    }  # fmt: skip
    own = {name: ESTIMATE[name] for name in ("natural_frequency", "damping_ratio", "residual")}
    expected = {
        "valve_1.condition": ("warning", None),
        "valve_1.health.level": (ValveHealth.LEVEL_WARNING, at(8)),
        "valve_1.health.ne107": ("function check", at(8)),
        "valve_1.health.summary": ("wears", at(8)),
        "valve_1.health.active": ("resonance, wear", at(8)),
        **{f"valve_1.alarms.{NAME}.{name}": (value, at(5.25)) for name, value in values.items()},
    }
    for group, second, numbers in (("health", 8, HEALTH), ("estimate", 9, PARAMETERS | own)):
        for name, (unit, value, deviation) in numbers.items():
            key = f"valve_1.{group}.{name}" + (f" [{unit}]" if unit not in ("", "1") else "")
            expected |= {key: (value, at(second)), f"{key} standard deviation": (deviation, at(second))}

    async def work() -> None:
        async with await served.client() as client:

            async def shown() -> bool:
                for name, message in (
                    ("health", health()), ("estimate", estimate()), ("alarms", AlarmList(alarms=[alarm])),
                ):  # fmt: skip
                    served.publish[name](message)
                found = [(one.Value.Value, one.SourceTimestamp) for one in await read(client, *expected)]
                utc = [(value, time and time.replace(tzinfo=timezone.utc)) for value, time in found]
                # The condition is this host's finding: its time is when it was found.
                return dict(zip(expected, [(utc[0][0], None), *utc[1:]], strict=True)) == expected

            await until(shown, str(expected))
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


def test_every_field_of_a_condition_is_that_of_the_alarm(served: Served, alarm: Alarm) -> None:
    async def work() -> None:
        async with await served.client() as client:
            served.publish["health"](ValveHealth())
            await served.show(client, alarm, "before", lambda one: one.Quality.is_good())
            alarm.severity = 2
            event = await served.show(client, alarm, "wait for the part")
            found = fields(event)
            assert {name: found[name] for name in CONDITION} == CONDITION
            left = alarm.shelved_until.sec - time.time()
            assert left < 1e-3 * found["ShelvingState/UnshelveTime"] < left + PATIENCE
            (kind,) = await client.get_node(event.EventType).get_referenced_nodes(45, 1, includesubtypes=True)
            assert (await kind.read_browse_name()).Name == "DeviceHealthDiagnosticAlarmType"
            assert event.NodeId.Identifier == f"valve_1.conditions.{NAME}.M"  # wear asks for maintenance

    asyncio.run(work())


def test_a_condition_has_the_states_of_the_standard(served: Served, alarm: Alarm) -> None:
    names = ("Active", "Acked", "Confirmed", "Latched", "Suppressed", "OutOfService")
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
    alarm.shelved_until.sec = 0

    async def work() -> None:
        async with await served.client() as client:
            for (state, underlying), expected in states.items():
                alarm.state = getattr(Alarm, f"STATE_{state}")
                alarm.underlying = getattr(Alarm, f"STATE_{underlying or state}")
                event = fields(await served.show(client, alarm, f"{state} over {underlying}"))
                found = [event[f"{name}State/Id"] for name in names]
                assert (*found, event["ShelvingState/CurrentState"], event["Retain"]) == expected, state

    asyncio.run(work())


@pytest.mark.parametrize(
    ("languages", "headline"),
    [(["pl-PL"], "Dryf tarcia"), (["fr-FR", "en-US", "pl"], "Friction drift"), (["fr-FR"], "Reibungsdrift")],
)
def test_a_client_gets_alarms_in_its_language_or_in_that_of_the_node(
    served: Served, alarm: Alarm, languages: list[str], headline: str
) -> None:
    async def work() -> None:
        async with await served.client(languages=languages) as client:
            event = await served.show(client, alarm, str(languages))
            assert event.Message.Text.startswith(headline)

    asyncio.run(work())


def test_methods_of_the_standard_ask_the_monitor_for_the_same(served: Served, alarm: Alarm) -> None:
    """Durations are ms for the client and s for the monitor."""
    alarm.state = alarm.underlying = Alarm.STATE_LATCHED_UNACKNOWLEDGED
    alarm.occurrence = 9
    who = {"alarm": NAME, "who": OPERATOR["name"]}
    said = ua.LocalizedText("seen", "en")

    async def work() -> None:
        async with await served.client(**OPERATOR) as client:
            event = await served.show(client, alarm, "before methods")
            condition, served.asked[:] = client.get_node(event.NodeId), []
            for name, arguments in (
                ("AcknowledgeableConditionType_Acknowledge", (event.EventId, said)),
                ("AcknowledgeableConditionType_Confirm", (event.EventId, said)),
                ("AlarmConditionType_ShelvingState_TimedShelve", (90e3,)),
                ("ShelvedStateMachineType_OneShotShelve2", (said,)),
            ):
                await condition.call_method(ua.NodeId(getattr(ua.ObjectIds, name)), *arguments)
            alarm.state = Alarm.STATE_SHELVED
            await served.show(client, alarm, "on the shelf")
            await condition.call_method(ua.NodeId(ua.ObjectIds.ShelvedStateMachineType_Unshelve))
            too_long = ua.NodeId(ua.ObjectIds.ShelvedStateMachineType_TimedShelve), 604_800_001.0
            with pytest.raises(ua.uaerrors.BadShelvingTimeOutOfRange):
                await condition.call_method(*too_long)

    asyncio.run(work())
    assert served.asked == [
        AcknowledgeAlarm.Request(**who, occurrence=9, comment="seen"),
        ResetAlarms.Request(**who, comment="seen"),
        ShelveAlarm.Request(**who, shelved=True, duration=90.0),
        ShelveAlarm.Request(**who, shelved=True, duration=0.0, comment="seen"),
        ShelveAlarm.Request(**who, shelved=False),
    ]


async def attacks(client: Client) -> list[str]:
    """Try to change something in every way that the protocol has; return what was let through."""
    index = await client.get_namespace_index("urn:spool-suite:valves")
    level, valves = (client.get_node(ua.NodeId(name, index)) for name in ("valve_1.health.level", "Valves"))
    tries: dict[str, Callable[[], Any]] = {
        "write a value": lambda: level.write_value(1),
        "make it writable": level.set_writable,
        "add a folder": lambda: valves.add_folder(index, "mine"),
        "delete the valves": lambda: client.delete_nodes([valves], recursive=True),
        "call a method": lambda: client.nodes.server.call_method("0:GetMonitoredItems", ua.UInt32(1)),
    }
    through = []
    for name, attempt in tries.items():
        try:
            await attempt()
        except (ua.UaError, ConnectionError, TimeoutError):
            continue
        through.append(name)
    return through


def test_without_security_clients_of_this_host_see_quality_and_change_nothing(claim_domain: Domains) -> None:
    port = free_port()
    administrator = Client(f"opc.tcp://127.0.0.1:{port}", timeout=PATIENCE)
    administrator.set_user("admin")

    async def work() -> None:
        async with Client(f"opc.tcp://127.0.0.1:{port}", timeout=PATIENCE) as client:

            async def quality(wanted: str) -> bool:
                (found,) = await read(client, "valve_1.health.level")
                return bool(found.StatusCode.name == wanted)

            publish(health())
            await until(lambda: quality("Good"), "the level is known")
            await until(lambda: quality("BadNoCommunication"), "the monitor is missed")
            assert await attacks(client) == []
        with pytest.raises(ua.UaError):
            await administrator.connect()

    with clocked(claim_domain, "valve_1") as nodes:
        publish = nodes.offer(ValveHealth, "health", latched=True)
        nodes.start(OpcUaNode, use_sim_time=False, port=port)
        with nodes.spinning():
            asyncio.run(work())
            assert [listens(port, address) for address in ("127.0.0.1", own_address())] == [True, False]


def own_address() -> str:
    """Return an address of this host that is not loopback's own, as the network would use it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return "127.0.0.2"
        address = str(probe.getsockname()[0])
    return "127.0.0.2" if address == "127.0.0.1" else address


# Browsers.


def test_browsers_get_every_value_of_an_alarm(alarm: Alarm) -> None:
    (found,) = alarms_of(AlarmList(alarms=[alarm]))
    texts = found.pop("texts")
    assert found == {
        "name": "friction_drift/coulomb_force", "code": 201, "kind": "friction_drift", "cause": "wear",
        "state": "shelved", "underlying": "acknowledged", "severity": "warning", "letter": "F", "urgency": 3,
        "parameter": "coulomb_force", "common": False, "occurrence": 5, "raised": 1_790_000_003,
        "acknowledged": 1_790_000_004, "by": "Eva", "comment": "wait for the part", "hidden": None,
        "shelved_until": 1_890_000_006,
    }  # fmt: skip
    assert texts["en"]["headline"] == "Friction drift (spool): Coulomb force 0.71 N, limit 0.66 N"
    assert [texts[code]["title"] for code in ("en", "de", "pl")] == [
        "Friction drift",
        "Reibungsdrift",
        "Dryf tarcia",
    ]


def test_each_parameter_of_the_page_changes_what_browsers_get(claim_domain: Domains, tmp_path: Path) -> None:
    """Without them: loopback and the usual folder, all valves, read only, no metrics, the token for all."""
    keep_operator(tmp_path / "secure", "Eva", "correct horse")
    port = free_port("127.0.0.2")
    values = {
        "address": "127.0.0.2", "port": port, "operator": True, "metrics": True, "valves": ["valve_2"],
        "state_folder": str(tmp_path / "own"), "security_folder": str(tmp_path / "secure"),
    }  # fmt: skip
    url = f"http://127.0.0.2:{port}"
    assert set(values) == {one.name for one in PageNode.PARAMETERS}

    def get(path: str, body: bytes | None = None, **headers: str) -> str:
        with urllib.request.urlopen(urllib.request.Request(url + path, body, headers)) as answer:
            return str(answer.read().decode())

    with clocked(claim_domain, "pages") as nodes:
        messages = {"valve_1/health": health(), "valve_2/health": health(), "valve_2/estimate": estimate()}
        sent = [
            (nodes.offer(type(message), f"/{topic}", latched=True), message)
            for topic, message in messages.items()
        ]
        nodes.start(PageNode, use_sim_time=False, **values)

        def metrics() -> str:
            for publish, message in sent:
                publish(message)
            nodes.settle()
            return get("/metrics")

        nodes.until(lambda: listens(port, "127.0.0.2"), "the page is served")
        nodes.until(lambda: 'spool_valve_namur_status{valve="valve_2"}' in metrics(), "the metrics")
        assert "valve_1" not in metrics()
        nodes.until(
            lambda: 'parameter="stiffness",bound="high"' in metrics(), "estimates, its page is closed"
        )
        given = json.dumps({"who": "Eva", "token": "correct horse"}).encode()
        headers = {"origin": url, "content-type": "application/json"}
        assert json.loads(get("/operator", given, **headers))["token"]
        assert [one.name for one in (tmp_path / "own" / "web_page").iterdir()] == ["operator_log.jsonl"]


def test_a_valve_that_has_not_spoken_since_the_page_started_has_its_condition(
    claim_domain: Domains, tmp_path: Path
) -> None:
    """It has a file in the monitors' state folder, and no monitor runs."""
    kept = tmp_path / "press" / "left" / "monitor" / FILE
    kept.parent.mkdir(parents=True)
    kept.touch()
    port = free_port()
    with clocked(claim_domain, "pages") as nodes:
        nodes.start(PageNode, use_sim_time=False, port=port, metrics=True, state_folder=str(tmp_path))
        nodes.until(lambda: listens(port), "the page is served")
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as answer:
            lines = answer.read().decode().splitlines()
    assert 'spool_valve_condition{valve="press/left"} 6' in lines
    assert "spool_valves 0" in lines
