from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity
from spool_monitor.alarm import AlarmRefusedError, AlarmState, Operator, reset, shelve, suppress, unshelve
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.detectors import event_kind
from spool_monitor.event import Condition, Event, EventState, Facts, Severity
from spool_monitor.monitor import Monitor

SECOND = 1_000_000_000
CONDITIONS = (
    Condition(event_kind("resonance"), 0.5, 1.0),
    Condition(event_kind("friction_drift"), 2.0, 3.0, "viscous_coefficient"),
    Condition(event_kind("friction_drift"), 2.0, 3.0, "coulomb_force"),
    Condition(event_kind("stuck_spool"), 2.0, 3.0),
)
RAISED, CLEARED = EventState.RAISED, EventState.CLEARED


def store() -> AlarmStore:
    made = AlarmStore()
    made.expect(CONDITIONS)
    return made


def event(name: str, state: EventState, stamp: int = 1, severity: Severity = Severity.WARNING) -> Event:
    kind, _, source = name.partition("/")
    return Event(
        stamp, kind, state, severity, "", Quantity("x", "1"), source, facts=Facts("x", "1", float(stamp))
    )


def eva(stamp: int = 5) -> Operator:
    return Operator("Eva", stamp)


def states(of: AlarmStore) -> dict[str, AlarmState]:
    return {name: alarm.state for name, alarm in of.alarms.items() if alarm.state is not AlarmState.NORMAL}


def test_two_conditions_of_a_kind_are_two_alarms() -> None:
    alarms = store()
    alarms.update(event("friction_drift/coulomb_force", RAISED))
    alarms.update(event("friction_drift/viscous_coefficient", RAISED))
    alarms.update(event("friction_drift/coulomb_force", CLEARED))
    assert states(alarms) == {
        "friction_drift/coulomb_force": AlarmState.RETURNED_UNACKNOWLEDGED,
        "friction_drift/viscous_coefficient": AlarmState.UNACKNOWLEDGED,
    }


def test_one_a_kind_or_all_can_be_named() -> None:
    alarms = store()
    for name in alarms.alarms:
        alarms.update(event(name, RAISED))
    assert len(alarms.acknowledge("friction_drift/coulomb_force", eva())) == 1
    # Of the kind's two only one still waits.
    (only,) = alarms.acknowledge("friction_drift", eva())
    assert only.after.name == "friction_drift/viscous_coefficient"
    assert len(alarms.acknowledge("", eva())) == 2
    with pytest.raises(AlarmRefusedError, match="all 4 alarms refuse this"):
        alarms.acknowledge("", eva())


def test_what_there_is_not_is_refused_with_what_there_is() -> None:
    with pytest.raises(AlarmRefusedError, match="no alarm 'wear'; there are: friction_drift/coulomb_force, "):
        store().acknowledge("wear", eva())


def test_any_expected_alarm_can_be_put_aside_before_it_comes() -> None:
    alarms = store()
    alarms.operate("resonance", suppress, eva(), on=True)
    assert alarms.update(event("resonance", RAISED)).actions == ()
    assert states(alarms) == {"resonance": AlarmState.SUPPRESSED}


def test_time_ends_the_shelves_that_are_due() -> None:
    alarms = store()
    alarms.operate("resonance", shelve, eva(), 10.0)
    alarms.operate("friction_drift", shelve, eva(), 20.0)
    assert alarms.advance(5 + 10 * SECOND - 1) == []
    (ended,) = alarms.advance(5 + 10 * SECOND)
    assert ended.after.name == "resonance"
    assert len(alarms.advance(5 + 20 * SECOND)) == 2


def test_those_that_wait_for_an_operator_are_shown_first() -> None:
    alarms = store()
    for stamp, name in enumerate(alarms.alarms, 1):
        high = name.startswith("stuck")
        alarms.update(event(name, RAISED, stamp, Severity.ALARM if high else Severity.WARNING))
    alarms.acknowledge("friction_drift/viscous_coefficient", eva())
    alarms.operate("resonance", shelve, eva(), 10.0)
    assert [alarm.name for alarm in alarms.shown] == [
        "stuck_spool",
        "friction_drift/coulomb_force",
        "friction_drift/viscous_coefficient",
        "resonance",
    ]


@pytest.mark.parametrize(
    "content", [None, 5, [{}], [{"kind": "resonance", "value": 1.0, "severity": 9}], [{"value": None}], ["x"]]
)
def test_what_cannot_be_read_is_refused_and_changes_nothing(content: object) -> None:
    alarms = store()
    before = dict(alarms.alarms)
    with pytest.raises(InputError, match="the kept alarms can't be read:"):
        alarms.load(content)
    assert alarms.alarms == before


def test_one_unreadable_alarm_costs_no_other_its_latch() -> None:
    before = store()
    before.update(event("stuck_spool", RAISED))
    before.update(event("stuck_spool", CLEARED))
    content = [{"kind": "resonance", "value": 1.0, "severity": 9}, *before.dump()]
    after = store()
    with pytest.raises(InputError, match=r"1 of \d+ of the kept alarms can't be read"):
        after.load(content)
    assert after.alarms["stuck_spool"].latched


def test_what_a_later_version_adds_to_an_alarm_is_left_out() -> None:
    before = store()
    before.update(event("stuck_spool", RAISED))
    after = store()
    after.load([{**entry, "colour": "red"} for entry in before.dump()])
    assert after.alarms["stuck_spool"].active


def test_of_two_stores_the_later_change_of_each_alarm_counts() -> None:
    ours, theirs = store(), store()
    ours.update(replace(event("stuck_spool", RAISED), stamp=1 * SECOND))
    theirs.update(replace(event("stuck_spool", RAISED), stamp=1 * SECOND))
    theirs.acknowledge("stuck_spool", eva(2 * SECOND))
    ours.update(replace(event("resonance", RAISED), stamp=3 * SECOND))
    ours.join(theirs.dump())
    assert ours.alarms["stuck_spool"].acknowledged
    assert ours.alarms["resonance"].active


def test_a_kind_that_latches_no_more_is_let_go() -> None:
    before = store()
    before.update(event("stuck_spool", RAISED))
    before.update(event("stuck_spool", CLEARED))
    assert states(before) == {"stuck_spool": AlarmState.LATCHED_UNACKNOWLEDGED}
    after = AlarmStore(latching=())
    after.load(before.dump())
    assert states(after) == {"stuck_spool": AlarmState.RETURNED_UNACKNOWLEDGED}


NAMES = [condition.name for condition in CONDITIONS]


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["warn", "alarm", "clear", "ack", "reset", "shelve", "unshelve", "on", "off"]),
            st.sampled_from([*NAMES, "", "friction_drift"]),
            st.integers(0, 100),
        ),
        max_size=60,
    )
)
def test_whatever_happens_it_survives_a_restart_unchanged(steps: list[tuple[str, str, int]]) -> None:
    alarms = store()
    for what, name, stamp in steps:
        operator = eva(stamp * SECOND)
        name_of_one = name if name in NAMES else NAMES[0]
        try:
            if what in ("warn", "alarm"):
                severity = Severity.WARNING if what == "warn" else Severity.ALARM
                alarms.update(event(name_of_one, RAISED, stamp, severity))
            elif what == "clear":
                alarms.update(event(name_of_one, CLEARED, stamp))
            elif what == "ack":
                alarms.acknowledge(name, operator)
            elif what == "reset":
                alarms.operate(name, reset, operator)
            elif what == "shelve":
                alarms.operate(name, shelve, operator, 10.0)
            elif what == "unshelve":
                alarms.operate(name, unshelve, operator)
            else:
                alarms.operate(name, suppress, operator, on=what == "on")
        except AlarmRefusedError:
            continue
        alarms.advance(stamp * SECOND)
    again = store()
    again.load(json.loads(json.dumps(alarms.dump(), allow_nan=False)))
    assert list(again.alarms) == list(alarms.alarms)
    for name, alarm in alarms.alarms.items():
        kept = again.alarms[name]
        assert repr(kept) == repr(alarm)  # NaN is not equal to itself
    assert len(alarms.alarms) == len(CONDITIONS)


def test_alarms_of_an_earlier_version_are_taken_up() -> None:
    sentence = "Coulomb force rose by 0.250 N; what to do: take an oil sample"
    earlier = {
        "kind": "friction_drift", "active": True, "acknowledged": False, "severity": 2, "cause": "wear",
        "message": sentence, "value": 0.25, "unit": "N", "occurrence": 1, "raised_at": 5, "changed_at": 5,
    }  # fmt: skip
    alarms = store()
    alarms.load([earlier])
    event = alarms.alarms["friction_drift/viscous_coefficient"].event
    assert event is not None
    assert (event.text, event.quantity.value, event.code) == (sentence, 0.25, 201)


@pytest.mark.parametrize(
    ("kind", "source", "cause", "facts", "name"),
    [
        ("friction_drift", "", "wear", Facts("viscous_coefficient"), "friction_drift/viscous_coefficient"),
        ("sensor_fault", "sensor_dead", "dead", Facts(subject="spool"), "sensor_fault/sensor_dead/spool"),
        ("data_fault", "", "lost", Facts("faulty_blocks"), "data_fault/lost"),
        ("data_fault", "outliers", "outliers", Facts(subject="body"), "data_fault/outliers/body"),
    ],
)
def test_an_alarm_that_stood_for_several_faults_is_taken_up_as_that_of_its_last_one(
    kind: str, source: str, cause: str, facts: Facts, name: str
) -> None:
    earlier, now, monitor = AlarmStore(), AlarmStore(), Monitor()
    raised = Event(5, kind, RAISED, Severity.ALARM, cause, Quantity("", "1"), source, facts=facts)
    earlier.update(raised)
    now.expect(monitor.conditions)
    now.load(earlier.dump())
    now.restore(monitor.conditions)
    assert [one.name for one in now.alarms.values() if one.active] == [name]
    assert [one.name for one in monitor.conditions if one.active is not None] == [name]
