"""One spelling: every display shows the same headline of an alarm, and the fields behind it."""

from __future__ import annotations

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
from spool_msgs.msg import AlarmList
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
