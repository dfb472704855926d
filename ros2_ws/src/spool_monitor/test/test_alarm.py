"""Every transition of an alarm: what shows, what lies beneath, what the operator's display does."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.uncertainty import Quantity
from spool_monitor.alarm import (
    Action,
    Alarm,
    AlarmRefusedError,
    AlarmState,
    Input,
    Operator,
    Transition,
    acknowledge,
    expire,
    follow,
    maintain,
    reset,
    shelve,
    suppress,
    unshelve,
)
from spool_monitor.detectors import event_kind
from spool_monitor.event import Event, EventState, Namur, Severity

SECOND = 1_000_000_000
NOW = 100 * SECOND
OPERATOR = Operator("Eva", NOW, "on my way")

N, U, A, R, LU, LA = (
    AlarmState.NORMAL,
    AlarmState.UNACKNOWLEDGED,
    AlarmState.ACKNOWLEDGED,
    AlarmState.RETURNED_UNACKNOWLEDGED,
    AlarmState.LATCHED_UNACKNOWLEDGED,
    AlarmState.LATCHED_ACKNOWLEDGED,
)
SILENCE, RETURN = (Action.SILENCE,), (Action.RETURN,)

Change = Callable[[Alarm], Transition]


def event(state: EventState, severity: Severity) -> Event:
    quantity = Quantity("coulomb_force_change", "N", 0.2)
    return Event(NOW, "friction_drift", state, severity, "wear", quantity, "coulomb_force", 201)


def raised(severity: Severity) -> Change:
    return lambda alarm: follow(alarm, event(EventState.RAISED, severity))


#: What can happen; an alarm here is a warning, so ALARM makes it grow.
WARN, GROW = "raise", "raise higher"
CLEAR, ACKNOWLEDGE, RESET = "clear", "acknowledge", "reset"
INPUTS: dict[str, Change] = {
    WARN: raised(Severity.WARNING),
    GROW: raised(Severity.ALARM),
    CLEAR: lambda alarm: follow(alarm, event(EventState.CLEARED, alarm.severity)),
    ACKNOWLEDGE: lambda alarm: acknowledge(alarm, OPERATOR),
    RESET: lambda alarm: reset(alarm, OPERATOR),
}


def alarm(state: AlarmState, *, latching: bool = False, cover: frozenset[str] = frozenset()) -> Alarm:
    """Return a warning in ``state`` under ``cover``; only what latches can be in a latched state."""
    return Alarm(
        "friction_drift",
        "coulomb_force",
        latching=latching,
        active=state in (U, A),
        acknowledged=state in (N, A, LA),
        latched=state in (LU, LA),
        severity=Severity.WARNING,
        shelved="shelved" in cover,
        shelved_at=NOW - SECOND if "shelved" in cover else 0,
        shelved_until=NOW + SECOND if "shelved" in cover else 0,
        suppressed="suppressed" in cover,
        out_of_service="out of service" in cover,
    )


#: Announced again: unacknowledged.
NEW = (U, (Action.ANNOUNCE,))

#: The standard's table by state and latch: what follows each of INPUTS, None where it is refused.
TABLE: dict[tuple[AlarmState, bool], tuple[tuple[AlarmState, tuple[Action, ...]] | None, ...]] = {
    # raise, raise higher, clear, acknowledge, reset
    (N, False): (NEW, NEW, (N, ()), None, None),
    (U, False): ((U, ()), NEW, (R, RETURN), (A, SILENCE), None),
    (A, False): ((A, ()), NEW, (N, RETURN), None, None),
    (R, False): (NEW, NEW, (R, ()), (N, SILENCE), None),
    (N, True): (NEW, NEW, (N, ()), None, None),
    (U, True): ((U, ()), NEW, (LU, RETURN), (A, SILENCE), None),
    (A, True): ((A, ()), NEW, (LA, RETURN), None, None),
    (LU, True): (NEW, NEW, (LU, ()), (LA, SILENCE), None),
    (LA, True): (NEW, NEW, (LA, ()), None, (N, RETURN)),
}

SHELVED, SUPPRESSED, SERVICED = "shelved", "suppressed", "out of service"
COVERS: dict[str, tuple[Change, str, bool | None]] = {
    # input: the change, the cover it is about, whether it lays it on; None: takes it off where it is there
    "shelve": (lambda alarm: shelve(alarm, OPERATOR, 60.0), SHELVED, True),
    "unshelve": (lambda alarm: unshelve(alarm, OPERATOR), SHELVED, False),
    "expire": (lambda alarm: expire(alarm, NOW + SECOND), SHELVED, None),
    "suppress": (lambda alarm: suppress(alarm, OPERATOR, on=True), SUPPRESSED, True),
    "unsuppress": (lambda alarm: suppress(alarm, OPERATOR, on=False), SUPPRESSED, False),
    "remove from service": (lambda alarm: maintain(alarm, OPERATOR, on=True), SERVICED, True),
    "return to service": (lambda alarm: maintain(alarm, OPERATOR, on=False), SERVICED, False),
}
ALL_COVERS = [  # every subset of the three
    frozenset(some)
    for count in range(4)
    for some in itertools.combinations((SHELVED, SUPPRESSED, SERVICED), count)
]


def cover_of(alarm: Alarm) -> frozenset[str]:
    flags = {SHELVED: alarm.shelved, SUPPRESSED: alarm.suppressed, SERVICED: alarm.out_of_service}
    return frozenset(name for name, on in flags.items() if on)


def test_every_input_is_tried() -> None:
    # raise stands in the table twice, for the same severity and for a higher one.
    assert len(INPUTS) - 1 + len(COVERS) == len(Input)
    assert {len(row) for row in TABLE.values()} == {len(INPUTS)}


# The cases are fewer than the examples, so all are tried.
@settings(max_examples=600)
@given(st.sampled_from(list(TABLE)), st.sampled_from(list(INPUTS)), st.sampled_from(ALL_COVERS))
def test_an_alarm_follows_the_standard_and_is_announced_only_where_nothing_covers_it(
    at: tuple[AlarmState, bool], what: str, cover: frozenset[str]
) -> None:
    state, latching = at
    before = alarm(state, latching=latching, cover=cover)
    assert before.underlying is state
    expected = TABLE[at][list(INPUTS).index(what)]
    if expected is None:
        with pytest.raises(AlarmRefusedError, match=r"^friction_drift/coulomb_force: "):
            INPUTS[what](before)
        return
    result = INPUTS[what](before)
    follows, actions = expected
    if cover and (state, what, latching) == (U, CLEAR, False):
        follows = N  # what came and went behind a cover wants no acknowledgement
    assert result.before == before
    assert result.after.underlying is follows
    assert cover_of(result.after) == cover
    assert result.actions == (actions if not cover or what in (ACKNOWLEDGE, RESET) else ())


@settings(max_examples=600)
@given(st.sampled_from(list(TABLE)), st.sampled_from(list(COVERS)), st.sampled_from(ALL_COVERS))
def test_covers_are_laid_on_and_taken_off_one_by_one(
    at: tuple[AlarmState, bool], what: str, cover: frozenset[str]
) -> None:
    state, latching = at
    change, about, on = COVERS[what]
    before = alarm(state, latching=latching, cover=cover)
    there = about in cover
    refused = on is not None and on is there and what != "shelve"  # shelving again sets a new end
    if refused:
        with pytest.raises(AlarmRefusedError, match=about if on else "service|shelved|suppressed"):
            change(before)
        return
    result = change(before)
    assert result.after.underlying is state
    wanted = cover | {about} if on else cover - {about}
    assert cover_of(result.after) == wanted
    shown = [SERVICED, SUPPRESSED, SHELVED]
    names = [AlarmState.OUT_OF_SERVICE, AlarmState.SUPPRESSED, AlarmState.SHELVED]
    top = next((name for flag, name in zip(shown, names, strict=True) if flag in wanted), state)
    assert result.after.state is top
    if wanted and not cover:
        assert result.actions == (Action.HIDE,)
    elif cover and not wanted:
        due = state in (U, R, LU)
        assert result.actions == ((Action.SHOW, Action.ANNOUNCE) if due else (Action.SHOW,))
    else:
        assert result.actions == ()


def test_a_shelf_until_it_is_over_ends_with_the_condition() -> None:
    before = shelve(alarm(A), OPERATOR, 0.0).after
    assert before.state is AlarmState.SHELVED
    assert not expire(before, NOW + 10**6 * SECOND).changed
    over = INPUTS[CLEAR](before)
    assert over.after.state is N
    assert over.actions == (Action.SHOW,)
    with pytest.raises(AlarmRefusedError, match="cannot be shelved until it is over"):
        shelve(alarm(N), OPERATOR, 0.0)


def test_a_clock_set_back_does_not_lengthen_a_shelf() -> None:
    shelved = shelve(alarm(U), OPERATOR, 60.0).after
    assert expire(shelved, NOW - 1).after.state is U


def test_shelving_again_sets_a_new_end() -> None:
    once = shelve(alarm(U), OPERATOR, 60.0).after
    later = Operator("Eva", NOW + 30 * SECOND)
    assert shelve(once, later, 60.0).after.shelved_until == NOW + 90 * SECOND


def test_who_acknowledged_what_when_and_why_is_kept() -> None:
    seen = acknowledge(alarm(U), OPERATOR).after
    assert (seen.acknowledged_by, seen.acknowledged_at, seen.comment) == ("Eva", NOW, "on my way")
    with pytest.raises(AlarmRefusedError, match="Eva acknowledged it"):
        acknowledge(seen, OPERATOR)
    with pytest.raises(AlarmRefusedError, match="'who' is required"):
        Operator("  ", NOW)


def test_an_acknowledgement_belongs_to_one_occurrence() -> None:
    again = INPUTS[WARN](INPUTS[CLEAR](acknowledge(alarm(U), OPERATOR).after).after).after
    assert (again.acknowledged_by, again.acknowledged_at, again.comment) == ("", 0, "")


def test_each_name_and_comment_stands_with_its_own_act() -> None:
    seen = acknowledge(alarm(U), OPERATOR).after
    jan, mia = Operator("Jan", NOW + SECOND, "pump test"), Operator("Mia", NOW + 2 * SECOND, "new seal")
    shelved = shelve(seen, jan, 600.0).after
    served = maintain(shelved, mia, on=True).after
    assert (served.acknowledged_by, served.comment) == ("Eva", "on my way")
    assert (shelved.hidden_by, served.hidden_by) == (jan, mia)
    assert maintain(served, OPERATOR, on=False).after.hidden_by == jan
    assert unshelve(shelved, OPERATOR).after.hidden_by is None


def test_a_newer_occurrence_is_not_acknowledged_unseen() -> None:
    first = INPUTS[WARN](alarm(N)).after
    grown = INPUTS[GROW](first).after
    assert (first.occurrence, grown.occurrence) == (1, 2)
    with pytest.raises(AlarmRefusedError, match="occurrence 1 is not current; look at number 2 first"):
        acknowledge(grown, OPERATOR, occurrence=1)
    assert acknowledge(grown, OPERATOR, occurrence=2).after.state is A


def test_an_event_brings_severity_cause_value_and_times() -> None:
    late = replace(event(EventState.RAISED, Severity.ALARM), stamp=NOW + SECOND)
    first = INPUTS[WARN](alarm(N)).after
    grown = follow(first, late).after
    assert (grown.severity, grown.cause, grown.event) == (Severity.ALARM, "wear", late)
    assert (grown.raised_at, grown.changed_at) == (NOW, NOW + SECOND)


def test_an_alarm_that_eases_to_a_warning_waits_for_no_operator_again() -> None:
    late = replace(event(EventState.RAISED, Severity.WARNING), stamp=NOW + SECOND)
    seen = acknowledge(INPUTS[GROW](alarm(N)).after, OPERATOR).after
    eased = follow(seen, late)
    assert (eased.after.severity, eased.after.acknowledged, eased.actions) == (Severity.WARNING, True, ())
    assert (eased.after.raised_at, eased.after.changed_at) == (seen.raised_at, NOW + SECOND)


def test_the_status_after_ne_107_follows_the_condition() -> None:
    wear = INPUTS[WARN](alarm(N)).after
    assert (wear.namur, wear.namur.letter) == (Namur.MAINTENANCE_REQUIRED, "M")
    assert INPUTS[CLEAR](wear).after.namur is Namur.NORMAL
    assert Namur.NORMAL.letter == Namur.UNKNOWN.letter == ""
    letters = [event_kind(kind).namur.letter for kind in ("sensor_fault", "resonance", "spring_change")]
    assert letters == ["F", "S", "M"]
    assert Namur.FAILURE > Namur.FUNCTION_CHECK > Namur.OUT_OF_SPECIFICATION > Namur.MAINTENANCE_REQUIRED


@pytest.mark.parametrize("seconds", [-1.0, 604801.0, 1e12, 1e300, float("inf"), float("nan")])
def test_an_alarm_is_shelved_for_a_week_at_most(seconds: float) -> None:
    with pytest.raises(AlarmRefusedError, match=r"use 0 to 604800 s \(7 days\), or suppress the alarm"):
        shelve(alarm(AlarmState.UNACKNOWLEDGED, latching=False, cover=frozenset()), OPERATOR, seconds)
