"""What every viewer shows of a valve, over histories of alarms and of what operators did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st
from spool_core.events.language import LANGUAGES
from spool_core.uncertainty import Quantity
from spool_monitor.alarm import AlarmRefusedError, Operator, maintain, reset, shelve, suppress, unshelve
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.event import Event, EventState, Severity
from spool_monitor.listener import NO_WORD, SILENT, WAITING, HeardValve
from spool_monitor.monitor_node import to_alarm_list
from spool_monitor.shown import ACTIVE, HIDDEN, PUT_ASIDE, STATES, in_order, shown
from spool_msgs.msg import Alarm, ValveHealth

NAMES = (
    ("friction_drift", "coulomb_force"), ("friction_drift", "viscous_coefficient"), ("resonance", ""),
    ("stale", "acceleration"), ("stuck_spool", ""),
)  # fmt: skip
SECOND = 1_000_000_000
ACTS = (
    "warn", "alarm", "clear", "acknowledge", "shelve", "unshelve", "serve", "return", "suppress", "show",
    "reset",
)  # fmt: skip


@dataclass
class Known:
    """What a person who watched the history knows of one alarm."""

    severity: int = 0
    seen_by: str = ""
    covers: dict[str, str] | None = None

    @property
    def hidden_by(self) -> str:
        covers = self.covers or {}
        return next((covers[one] for one in ("serve", "suppress", "shelve") if one in covers), "")


def play(steps: list[tuple[int, str, str]]) -> tuple[AlarmStore, dict[str, Known]]:
    """Return the store after ``steps`` (alarm, act, operator), and what they say of each alarm."""
    store, known = AlarmStore(), {}
    for moment, (number, act, who) in enumerate(steps, 1):
        kind, source = NAMES[number]
        name = f"{kind}/{source}".rstrip("/")
        own = known.setdefault(name, Known(covers={}))
        stamp, covers = moment * SECOND, own.covers
        assert covers is not None
        if act in ("warn", "alarm", "clear"):
            severity = Severity.ALARM if act == "alarm" else Severity.WARNING
            state = EventState.CLEARED if act == "clear" else EventState.RAISED
            store.update(Event(stamp, kind, state, severity, "", Quantity("x", "1", 0.2), source))
            if state is EventState.CLEARED:
                own.severity = 0
            else:
                own.seen_by = "" if severity > own.severity else own.seen_by
                own.severity = int(severity)
            continue
        operator = Operator(who, stamp, f"{who} says {moment}")
        do: dict[str, Callable[[str, Operator], object]] = {
            "acknowledge": store.acknowledge,
            "reset": lambda which, by: store.operate(which, reset, by),
            "serve": lambda which, by: store.operate(which, maintain, by, on=True),
            "return": lambda which, by: store.operate(which, maintain, by, on=False),
            "suppress": lambda which, by: store.operate(which, suppress, by, on=True),
            "show": lambda which, by: store.operate(which, suppress, by, on=False),
            "shelve": lambda which, by: store.operate(which, shelve, by, 3600.0),
            "unshelve": lambda which, by: store.operate(which, unshelve, by),
        }
        try:
            do[act](name, operator)
        except AlarmRefusedError:
            continue
        ends = {"return": "serve", "show": "suppress", "unshelve": "shelve"}
        if act in ends:
            covers.pop(ends[act])
        elif act in ends.values():
            covers[act] = who
        elif act == "acknowledge":
            own.seen_by = who
    return store, known


def heard(store: AlarmStore, level: int) -> HeardValve:
    message = to_alarm_list(store.shown, 0, "valve", LANGUAGES["en"])
    judgements = ["friction_drift: judged", "spring_change: judged"]
    health = ValveHealth(level=level, baseline=ValveHealth.BASELINE_FROZEN, judgements=judgements)
    return HeardValve("valve", health, 100.0, alarms=message)


STEPS = st.lists(
    st.tuples(st.integers(0, len(NAMES) - 1), st.sampled_from(ACTS), st.sampled_from(("Eva", "Jan", "Mia"))),
    max_size=25,
)


@given(STEPS, st.sampled_from((1, 2, 3, 4)))
def test_the_active_and_worst_is_spoken_of_and_every_name_stands_with_its_own_act(
    steps: list[tuple[int, str, str]], level: int
) -> None:
    store, known = play(steps)
    found = shown(heard(store, level), 100.5, 1_000_000.5)
    standing = {
        name: one
        for name, one in known.items()
        if one.severity and name in store.alarms and not one.hidden_by
    }
    assert found.state in STATES
    if standing:
        assert found.reason is not None
        assert found.reason.name in standing
        assert found.reason.severity == max(one.severity for one in standing.values())
        assert found.state in ("alarm", "stale", "warning")
        assert found.since == found.reason.raised_at.sec
    elif found.reason is not None:
        assert found.state == PUT_ASIDE
        assert found.reason.state in HIDDEN
        assert known[found.reason.name].hidden_by == found.reason.hidden_by
    for one in found.alarms:
        own = known[one.name]
        assert one.hidden_by == own.hidden_by
        assert one.acknowledged_by in ("", own.seen_by)
        assert one.comment.startswith(one.acknowledged_by)
        assert one.hidden_comment.startswith(one.hidden_by)
    assert found.waiting == sum(one.state in WAITING for one in found.alarms)
    places = [(one.state in HIDDEN, one.state not in ACTIVE) for one in found.alarms]
    assert [hidden for hidden, _ in places] == sorted(hidden for hidden, _ in places)
    visible = [over for hidden, over in places if not hidden]
    assert visible == sorted(visible)


def test_a_silent_monitor_has_no_reason_and_the_time_of_its_last_word() -> None:
    store, _ = play([(0, "alarm", "Eva")])
    found = shown(heard(store, ValveHealth.LEVEL_ALARM), 100.0 + SILENT + 7.5, 1_000_010.0)
    assert (found.state, found.reason, found.since) == (NO_WORD, None, 1_000_000.0)


def test_an_alarm_that_is_over_stands_behind_a_warning_that_stands() -> None:
    store, _ = play([(3, "alarm", "Eva"), (3, "clear", "Eva"), (0, "warn", "Eva")])
    found = shown(heard(store, ValveHealth.LEVEL_WARNING), 100.5, 1_000_000.0)
    assert found.reason is not None
    assert (found.state, found.reason.name) == ("warning", "friction_drift/coulomb_force")
    assert [one.state for one in found.alarms] == [
        Alarm.STATE_UNACKNOWLEDGED,
        Alarm.STATE_RETURNED_UNACKNOWLEDGED,
    ]


def test_the_valve_that_needs_somebody_most_comes_first() -> None:
    worn, silent = play([(0, "warn", "Eva")])[0], play([])[0]
    served = play([(0, "warn", "Eva"), (0, "serve", "Jan")])[0]
    warning = ValveHealth.LEVEL_WARNING
    levels = ((served, warning), (silent, ValveHealth.LEVEL_OK), (worn, warning))
    rows = [shown(heard(store, level), 100.5, 1_000_000.0) for store, level in levels]
    assert [one.state for one in in_order(rows)] == ["warning", "put_aside", "good"]
