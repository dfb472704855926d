"""One spelling: every display shows the same headline of an alarm, and the fields behind it."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest
from spool_bag.information import Timeline
from spool_core.events.event import Event, EventState, Facts
from spool_core.events.language import LANGUAGES, Language
from spool_core.events.sentences import details, headline
from spool_core.uncertainty import Quantity, Validity
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.detectors import KINDS
from spool_monitor.event import Condition, EventKind, Finding, Severity
from spool_monitor.listener import HeardValve
from spool_monitor.monitor_node import to_alarm_list
from spool_msgs.msg import AlarmList, ValveHealth
from spool_report.runs.record_replay import Clock, event_dictionary
from spool_tools.operations.valve_rows import alarm_details, alarm_row, event_line
from spool_view.view import alarms_of

STAMP = 1_700_000_000_000_000_000
FACTS = Facts(
    "coulomb_force", "N", 0.35, 0.339, 0.361, 0.1, 0.25, 0.2, STAMP - 6_000_000_000,
    causes=("wear", "oil_viscosity"), probabilities=(0.75, 0.25), false_alarm_interval=3.6e6,
    time_to_limit=600.0,
)  # fmt: skip


def raised(kind: EventKind, cause: str) -> Event:
    quantity = Quantity("coulomb_force_change", "N", 0.25, 0.007, Validity.VALID)
    (event,) = Condition(kind, 0.0, 0.0).judge(
        Finding(STAMP, Severity.WARNING, False, cause, quantity, FACTS)
    )
    return event


def published(event: Event, language: Language) -> AlarmList:
    store = AlarmStore()
    store.update(event)
    return to_alarm_list(store.shown, STAMP, "valve_1", language)


@pytest.mark.parametrize("language", LANGUAGES.values(), ids=LANGUAGES)
@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.name)
def test_message_terminal_page_report_and_opc_ua_show_the_same_headline(
    kind: EventKind, language: Language
) -> None:
    from spool_opcua.opcua_node import items_of  # noqa: PLC0415 - slow to load

    for cause in [one.name for one in kind.causes] or [""]:
        event = raised(kind, cause)
        said = headline(event, language)
        # The monitor speaks English here: every display composes the sentence itself.
        heard = published(event, LANGUAGES["en"])
        (alarm,) = heard.alarms
        assert published(event, language).alarms[0].message == said
        assert alarm_row(alarm, language)[-1].plain == said
        assert event_line(alarm.event, language) == f"warning: {said}"
        (entry,) = alarms_of(heard)
        assert entry["texts"][language.code]["headline"] == said
        valve = HeardValve("valve_1", alarms=heard)
        shown = {item.path: item.value for item in items_of(valve, 0.0, language)}
        assert shown["valve_1", "alarms", alarm.name, "message"] == said
        assert event_dictionary(event, Clock(Timeline(), STAMP), language)["message"] == said
        lines = [str(one) for one in details(event, language)]
        assert alarm_details(alarm, language) == lines
        assert [f"{label}: {text}" for label, text in entry["texts"][language.code]["details"]] == lines
        assert shown["valve_1", "alarms", alarm.name, "details"] == "\n".join(lines)


def test_the_opc_ua_server_serves_the_fields_of_an_alarm() -> None:
    from asyncua import Client, Server, ua  # noqa: PLC0415 - slow to load
    from spool_opcua.machine import Machine, Nameplate  # noqa: PLC0415 - slow to load
    from spool_opcua.opcua_node import NAMESPACE, AddressSpace  # noqa: PLC0415 - slow to load

    alarms = published(raised(KINDS["friction_drift"], "wear"), LANGUAGES["en"])

    async def served() -> dict[str, Any]:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        server = Server()
        await server.init()
        server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
        index = await server.register_namespace(NAMESPACE)
        async with server:
            health = ValveHealth(level=ValveHealth.LEVEL_WARNING)  # its monitor is heard
            valve = HeardValve("valve_1", health=health, alarms=alarms)
            machine = Machine(server, index, Nameplate("press 7"))
            await machine.build()
            await AddressSpace(server, index, machine).update([valve], 0.0)
            async with Client(f"opc.tcp://127.0.0.1:{port}", watchdog_intervall=60) as client:
                folder = client.get_node(ua.NodeId("valve_1.alarms.friction_drift", index))
                found = {}
                for node in await folder.get_children():
                    value = await node.read_data_value(raise_on_bad_status=False)
                    found[(await node.read_browse_name()).Name] = value.Value.Value
                return found

    found = asyncio.run(served())
    assert found["message"] == "Friction drift (wear): Coulomb force 0.350 N, limit 0.200 N"
    for name in ("value", "low", "high", "baseline", "change", "limit", "unit", "parameter"):
        assert found[name] == getattr(FACTS, name), name
    assert (found["causes"], found["probabilities"]) == ("wear, oil_viscosity", "0.75, 0.25")
    assert (found["false alarm interval"], found["time to limit"]) == (3.6e6, 600.0)
    assert (found["urgency"], found["advice"]) == ("planned", 201)
    assert found["began"] == "2023-11-14T22:13:14.000+00:00"


def test_an_event_that_ended_is_shown_everywhere_as_over() -> None:
    kind = KINDS["resonance"]
    condition = Condition(kind, 0.0, 0.0)
    nothing = Quantity("amplification", "1")
    facts = Facts("amplification", "1", 1.2, limit=1.8)
    condition.judge(Finding(STAMP, Severity.WARNING, False, "", nothing, facts))
    (event,) = condition.judge(Finding(STAMP + 1, None, True, "", nothing, facts))
    assert event.state is EventState.CLEARED
    assert headline(event) == "Resonance ended: amplification 1.2, limit 1.8"


def test_opc_ua_shows_each_alarm_by_its_name_and_the_first_of_them_by_what_their_names_begin_with() -> None:
    from spool_opcua.opcua_node import items_of  # noqa: PLC0415 - slow to load

    store, quantity = AlarmStore(), Quantity("coulomb_force_change", "N", 0.25, 0.007, Validity.VALID)
    for source, severity in (("coulomb_force", Severity.ALARM), ("viscous_coefficient", Severity.WARNING)):
        condition = Condition(KINDS["friction_drift"], 0.0, 0.0, source)
        for event in condition.judge(Finding(STAMP, severity, False, "wear", quantity, FACTS)):
            store.update(event)
    heard = to_alarm_list(store.shown, STAMP, "valve_1", LANGUAGES["en"])
    items = items_of(HeardValve("valve_1", alarms=heard), 0.0, LANGUAGES["en"])
    shown = {one.path[2]: one.value for one in items if one.path[1] == "alarms" and one.path[3] == "severity"}
    assert shown == {
        "friction_drift/coulomb_force": 2, "friction_drift/viscous_coefficient": 1, "friction_drift": 2,
    }  # fmt: skip
