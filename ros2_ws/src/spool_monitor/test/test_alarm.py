"""Every transition of an alarm: what shows, what lies beneath, what the operator's display does."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import pytest
from spool_monitor.alarms.alarm import (
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
    remove_from_service,
    reset,
    return_to_service,
    shelve,
    suppress,
    unshelve,
    unsuppress,
)
from spool_monitor.alarms.alarm_code import ALARMS, LATCHING, UNLISTED, Namur, code, namur
from spool_monitor.alarms.event import Event, EventState, Severity
from spool_stream.quantity import Quantity

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
ANNOUNCE, SILENCE, RETURN = (Action.ANNOUNCE,), (Action.SILENCE,), (Action.RETURN,)
REFUSED = "refused"

Change = Callable[[Alarm], Transition]


def event(state: EventState, severity: Severity) -> Event:
    quantity = Quantity("coulomb_force_change", "N", 0.2)
    return Event(NOW, "friction_drift", state, severity, "wear", quantity, "m", "coulomb_force")


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


#: State, input, whether it latches: state that follows and what the display does.
TABLE: dict[tuple[AlarmState, str, bool], tuple[AlarmState, tuple[Action, ...]] | str] = {
    (N, WARN, False): (U, ANNOUNCE),
    (N, GROW, False): (U, ANNOUNCE),
    (N, CLEAR, False): (N, ()),
    (N, ACKNOWLEDGE, False): REFUSED,
    (N, RESET, False): REFUSED,
    (U, WARN, False): (U, ()),
    (U, GROW, False): (U, ANNOUNCE),
    (U, CLEAR, False): (R, RETURN),
    (U, ACKNOWLEDGE, False): (A, SILENCE),
    (U, RESET, False): REFUSED,
    (A, WARN, False): (A, ()),
    (A, GROW, False): (U, ANNOUNCE),
    (A, CLEAR, False): (N, RETURN),
    (A, ACKNOWLEDGE, False): REFUSED,
    (A, RESET, False): REFUSED,
    (R, WARN, False): (U, ANNOUNCE),
    (R, GROW, False): (U, ANNOUNCE),
    (R, CLEAR, False): (R, ()),
    (R, ACKNOWLEDGE, False): (N, SILENCE),
    (R, RESET, False): REFUSED,
    (N, WARN, True): (U, ANNOUNCE),
    (N, GROW, True): (U, ANNOUNCE),
    (N, CLEAR, True): (N, ()),
    (N, ACKNOWLEDGE, True): REFUSED,
    (N, RESET, True): REFUSED,
    (U, WARN, True): (U, ()),
    (U, GROW, True): (U, ANNOUNCE),
    (U, CLEAR, True): (LU, RETURN),
    (U, ACKNOWLEDGE, True): (A, SILENCE),
    (U, RESET, True): REFUSED,
    (A, WARN, True): (A, ()),
    (A, GROW, True): (U, ANNOUNCE),
    (A, CLEAR, True): (LA, RETURN),
    (A, ACKNOWLEDGE, True): REFUSED,
    (A, RESET, True): REFUSED,
    (LU, WARN, True): (U, ANNOUNCE),
    (LU, GROW, True): (U, ANNOUNCE),
    (LU, CLEAR, True): (LU, ()),
    (LU, ACKNOWLEDGE, True): (LA, SILENCE),
    (LU, RESET, True): REFUSED,
    (LA, WARN, True): (U, ANNOUNCE),
    (LA, GROW, True): (U, ANNOUNCE),
    (LA, CLEAR, True): (LA, ()),
    (LA, ACKNOWLEDGE, True): REFUSED,
    (LA, RESET, True): (N, RETURN),
}
STATES = {False: (N, U, A, R), True: (N, U, A, LU, LA)}

#: Cover, input: cover that follows.
SHELVED, SUPPRESSED, SERVICED = "shelved", "suppressed", "out of service"
COVERS: dict[str, tuple[Change, str, bool | None]] = {
    # input: the change, the cover it is about, whether it lays it on; None: takes it off where it is there
    "shelve": (lambda alarm: shelve(alarm, OPERATOR, 60.0), SHELVED, True),
    "unshelve": (lambda alarm: unshelve(alarm, OPERATOR), SHELVED, False),
    "expire": (lambda alarm: expire(alarm, NOW + SECOND), SHELVED, None),
    "suppress": (lambda alarm: suppress(alarm, OPERATOR), SUPPRESSED, True),
    "unsuppress": (lambda alarm: unsuppress(alarm, OPERATOR), SUPPRESSED, False),
    "remove from service": (lambda alarm: remove_from_service(alarm, OPERATOR), SERVICED, True),
    "return to service": (lambda alarm: return_to_service(alarm, OPERATOR), SERVICED, False),
}
ALL_COVERS = [
    frozenset(some)
    for count in range(4)
    for some in itertools.combinations((SHELVED, SUPPRESSED, SERVICED), count)
]


def cover_of(alarm: Alarm) -> frozenset[str]:
    flags = {SHELVED: alarm.shelved, SUPPRESSED: alarm.suppressed, SERVICED: alarm.out_of_service}
    return frozenset(name for name, on in flags.items() if on)


def test_the_tables_are_complete() -> None:
    assert set(TABLE) == {
        (state, what, latching) for latching, states in STATES.items() for state in states for what in INPUTS
    }
    assert len(ALL_COVERS) == 8
    # raise stands in the table twice, for the same severity and for a higher one.
    assert len(INPUTS) - 1 + len(COVERS) == len(Input)


@pytest.mark.parametrize(("state", "what", "latching"), TABLE)
def test_transition(state: AlarmState, what: str, latching: bool) -> None:
    before = alarm(state, latching=latching)
    assert before.state is state
    expected = TABLE[state, what, latching]
    if isinstance(expected, str):
        with pytest.raises(AlarmRefusedError, match=r"^friction_drift/coulomb_force: "):
            INPUTS[what](before)
        return
    result = INPUTS[what](before)
    assert (result.after.state, result.actions) == expected
    assert result.before == before


@pytest.mark.parametrize("cover", ALL_COVERS[1:], ids="+".join)
@pytest.mark.parametrize(("state", "what", "latching"), TABLE)
def test_beneath_a_cover_it_goes_on_and_nothing_is_announced(
    state: AlarmState,
    what: str,
    latching: bool,
    cover: frozenset[str],
) -> None:
    before = alarm(state, latching=latching, cover=cover)
    expected = TABLE[state, what, latching]
    if isinstance(expected, str):
        with pytest.raises(AlarmRefusedError):
            INPUTS[what](before)
        return
    result = INPUTS[what](before)
    beneath, actions = expected
    if (state, what, latching) == (U, CLEAR, False):
        beneath = N  # what came and went behind a cover wants no acknowledgement
    assert result.after.underlying is beneath
    assert cover_of(result.after) == cover
    assert result.actions == (actions if what in (ACKNOWLEDGE, RESET) else ())


@pytest.mark.parametrize("cover", ALL_COVERS, ids=lambda cover: "+".join(cover) or "none")
@pytest.mark.parametrize("what", COVERS)
@pytest.mark.parametrize(
    ("state", "latching"), [(state, latching) for latching, states in STATES.items() for state in states]
)
def test_covers_are_laid_on_and_taken_off_one_by_one(
    state: AlarmState,
    latching: bool,
    what: str,
    cover: frozenset[str],
) -> None:
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
    with pytest.raises(AlarmRefusedError, match="has no end"):
        shelve(alarm(N), OPERATOR, 0.0)


@pytest.mark.parametrize("seconds", [-1.0, float("inf"), float("nan")])
def test_no_shelf_is_endless(seconds: float) -> None:
    with pytest.raises(AlarmRefusedError, match="no time to shelve for"):
        shelve(alarm(U), OPERATOR, seconds)


def test_a_shelf_ends_at_its_time_and_not_before() -> None:
    shelved = shelve(alarm(U), OPERATOR, 60.0).after
    assert not expire(shelved, NOW + 60 * SECOND - 1).changed
    assert expire(shelved, NOW + 60 * SECOND).after.state is U


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
    with pytest.raises(AlarmRefusedError, match="Eva has done it"):
        acknowledge(seen, OPERATOR)
    with pytest.raises(AlarmRefusedError, match="who: say who"):
        Operator("  ", NOW)


def test_a_newer_occurrence_is_not_acknowledged_unseen() -> None:
    first = INPUTS[WARN](alarm(N)).after
    grown = INPUTS[GROW](first).after
    assert (first.occurrence, grown.occurrence) == (1, 2)
    with pytest.raises(AlarmRefusedError, match="occurrence 1 is past, now it is 2"):
        acknowledge(grown, OPERATOR, occurrence=1)
    assert acknowledge(grown, OPERATOR, occurrence=2).after.state is A


def test_an_event_brings_severity_cause_value_and_times() -> None:
    late = replace(event(EventState.RAISED, Severity.ALARM), stamp=NOW + SECOND)
    first = INPUTS[WARN](alarm(N)).after
    grown = follow(first, late).after
    assert (grown.severity, grown.cause, grown.value, grown.unit) == (Severity.ALARM, "wear", 0.2, "N")
    assert (grown.raised_at, grown.changed_at) == (NOW, NOW + SECOND)
    assert INPUTS[WARN](grown).after.severity is Severity.ALARM


def test_codes_are_stable_and_tell_alarms_apart() -> None:
    """Plant systems rely on these numbers: add to them, never change them."""
    assert [code(kind) for kind in (
        "resonance", "friction_drift", "spring_change", "stuck_spool", "model_gap", "sensor_fault",
        "data_fault", "stale",
    )] == [100, 200, 300, 400, 500, 600, 700, 800]  # fmt: skip
    drift = ("wear", "oil_contamination", "oil_viscosity", "unknown")
    assert [code("friction_drift", cause) for cause in drift] == [201, 202, 203, 204]
    faults = ("dead", "clipping", "offset", "swapped", "scale")
    assert [code("sensor_fault", cause) for cause in faults] == [601, 602, 603, 604, 605]
    assert (code("spring_change", "softer"), code("spring_change", "stiffer")) == (301, 302)
    assert (code("stale", "acceleration"), code("stale", "estimate")) == (801, 802)
    assert code("resonance", "whatever") == 100
    assert code("no such kind") == UNLISTED[0] == 900
    numbers = [number for causes in ALARMS.values() for number, _ in causes.values()]
    assert len(set(numbers)) == len(numbers)
    assert set(LATCHING) <= set(ALARMS)


def test_the_status_after_ne_107_follows_the_condition() -> None:
    wear = INPUTS[WARN](alarm(N)).after
    assert (wear.namur, wear.namur.letter) == (Namur.MAINTENANCE_REQUIRED, "M")
    assert INPUTS[CLEAR](wear).after.namur is Namur.NORMAL
    assert Namur.NORMAL.letter == Namur.UNKNOWN.letter == ""
    letters = [namur(kind).letter for kind in ("sensor_fault", "resonance", "spring_change")]
    assert letters == ["F", "S", "M"]
    assert Namur.FAILURE > Namur.FUNCTION_CHECK > Namur.OUT_OF_SPECIFICATION > Namur.MAINTENANCE_REQUIRED
