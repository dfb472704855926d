from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.events.event import Facts, Urgency
from spool_core.events.sentences import details
from spool_core.uncertainty import Quantity
from spool_monitor.detectors import KINDS, event_kind
from spool_monitor.event import Condition, Event, EventCause, EventKind, EventState, Finding, Severity

SECOND = 1_000_000_000
NOTHING = Quantity("amplification", "1")
RAISED, CLEARED = EventState.RAISED, EventState.CLEARED
WARNING, ALARM = Severity.WARNING, Severity.ALARM

#: What is indicated: quiet, between both thresholds, warning, alarm; with whether it counts as released.
QUIET, BETWEEN, WARN, ALARMING = (None, True), (None, False), (WARNING, False), (ALARM, False)
#: The same below the deadband of an alarm.
EASED, OVER = (WARNING, False, True), (None, True, True)
What = tuple[Severity | None, bool] | tuple[Severity | None, bool, bool]


def judge(condition: Condition, seconds: float, what: What, cause: str = "") -> list[Event]:
    indicated, released, *eased = what
    finding = Finding(round(seconds * SECOND), indicated, released, cause, NOTHING, eased=any(eased))
    return condition.judge(finding)


def course(*steps: tuple[float, What]) -> list[tuple[float, EventState, Severity]]:
    condition = Condition(event_kind("resonance"), on_delay=0.5, off_delay=1.0)
    events = [event for seconds, what in steps for event in judge(condition, seconds, what)]
    return [(event.stamp / SECOND, event.state, event.severity) for event in events]


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        pytest.param([(0.0, QUIET), (9.0, QUIET)], [], id="quiet"),
        pytest.param([(0.0, WARN), (0.49, WARN)], [], id="shorter than the on delay"),
        pytest.param([(0.0, WARN), (0.5, WARN), (9.0, WARN)], [(0.5, RAISED, WARNING)], id="on delay"),
        pytest.param([(0.0, WARN), (0.4, QUIET), (0.5, WARN), (0.9, WARN)], [], id="interrupted by quiet"),
        pytest.param(
            [(0.0, WARN), (0.4, BETWEEN), (0.5, WARN), (0.9, WARN)], [], id="interrupted by between"
        ),
        pytest.param([(0.0, BETWEEN), (9.0, BETWEEN)], [], id="between never raises"),
        pytest.param(
            [(0.0, WARN), (0.5, WARN), (1.0, BETWEEN), (9.0, BETWEEN)],
            [(0.5, RAISED, WARNING)],
            id="between never clears",
        ),
        pytest.param(
            [(0.0, WARN), (0.5, WARN), (1.0, QUIET), (1.9, QUIET)],
            [(0.5, RAISED, WARNING)],
            id="off too short",
        ),
        pytest.param(
            [(0.0, WARN), (0.5, WARN), (1.0, QUIET), (2.0, QUIET), (9.0, QUIET)],
            [(0.5, RAISED, WARNING), (2.0, CLEARED, WARNING)],
            id="off delay",
        ),
        pytest.param(
            [(0.0, WARN), (0.5, WARN), (1.0, QUIET), (1.5, BETWEEN), (2.0, QUIET), (2.9, QUIET)],
            [(0.5, RAISED, WARNING)],
            id="the off delay starts again after between",
        ),
        pytest.param(
            [(0.0, WARN), (0.5, WARN), (1.0, QUIET), (1.5, WARN), (2.0, QUIET), (2.9, QUIET)],
            [(0.5, RAISED, WARNING)],
            id="the off delay starts again after an indication",
        ),
        pytest.param(
            [
                (0.0, WARN),
                (0.5, WARN),
                (0.6, ALARMING),
                (0.7, WARN),
                (1.2, ALARMING),
                (1.6, ALARMING),
                (9.0, WARN),
            ],
            [(0.5, RAISED, WARNING)],
            id="looks at a higher severity that are shorter than the on delay",
        ),
        pytest.param(
            [(0.0, WARN), (0.5, WARN), (0.6, ALARMING), (1.1, ALARMING), (1.2, WARN), (1.8, ALARMING)],
            [(0.5, RAISED, WARNING), (1.1, RAISED, ALARM)],
            id="a higher severity after the on delay and once",
        ),
        pytest.param(
            [(0.0, WARN), (0.4, ALARMING), (0.5, ALARMING), (0.8, ALARMING), (0.9, ALARMING)],
            [(0.5, RAISED, WARNING), (0.9, RAISED, ALARM)],
            id="a warning first where the alarm did not hold as long",
        ),
        pytest.param(
            [(0.0, ALARMING), (0.5, ALARMING), (1.0, WARN), (2.0, QUIET), (3.0, QUIET)],
            [(0.5, RAISED, ALARM), (3.0, CLEARED, ALARM)],
            id="an alarm that weakens stays one above its deadband",
        ),
        pytest.param(
            [
                (0.0, ALARMING),
                (0.5, ALARMING),
                (1.0, EASED),
                (1.9, ALARMING),
                (2.0, EASED),
                (2.9, EASED),
                (3.0, EASED),
                (9.0, EASED),
            ],
            [(0.5, RAISED, ALARM), (3.0, RAISED, WARNING)],
            id="an alarm below its deadband is a warning after the off delay and once",
        ),
        pytest.param(
            [
                (0.0, ALARMING),
                (0.5, ALARMING),
                (1.0, EASED),
                (2.0, EASED),
                (2.1, ALARMING),
                (2.5, ALARMING),
                (2.6, ALARMING),
            ],
            [(0.5, RAISED, ALARM), (2.0, RAISED, WARNING), (2.6, RAISED, ALARM)],
            id="and an alarm again after the on delay",
        ),
        pytest.param(
            [(0.0, ALARMING), (0.5, ALARMING), (1.0, OVER), (2.0, OVER)],
            [(0.5, RAISED, ALARM), (2.0, CLEARED, ALARM)],
            id="what is over needs no step to a warning",
        ),
        pytest.param(
            [(9.0, WARN), (1.0, WARN), (1.4, WARN), (1.5, WARN)],
            [(1.5, RAISED, WARNING)],
            id="a clock set back starts the delay again",
        ),
        pytest.param(
            [(9.0, WARN), (9.5, WARN), (20.0, QUIET), (1.0, QUIET), (1.9, QUIET), (2.0, QUIET)],
            [(9.5, RAISED, WARNING), (2.0, CLEARED, WARNING)],
            id="a clock set back does not hold an event",
        ),
    ],
)
def test_course(steps: list[tuple[float, What]], expected: list[tuple[float, EventState, Severity]]) -> None:
    assert course(*steps) == expected


def test_without_delays_it_follows_at_once() -> None:
    condition = Condition(event_kind("stale"), 0.0, 0.0)
    (raised,) = judge(condition, 1.0, ALARMING, "acceleration")
    (cleared,) = judge(condition, 2.0, QUIET)
    assert (raised.kind, raised.state, raised.cause) == ("stale", RAISED, "acceleration")
    assert (cleared.state, cleared.severity, cleared.cause) == (CLEARED, ALARM, "acceleration")


def test_clear_ends_what_is_active_and_only_that() -> None:
    condition = Condition(event_kind("stale"), 0.0, 5.0)
    assert condition.clear(0, NOTHING) == []
    judge(condition, 1.0, WARN, "estimate")
    (event,) = condition.clear(2 * SECOND, NOTHING)
    assert (event.state, event.severity, event.cause) == (CLEARED, WARNING, "estimate")
    assert condition.active is None
    assert condition.cause == ""
    assert condition.clear(3 * SECOND, NOTHING) == []


def test_the_event_carries_what_was_judged() -> None:
    condition = Condition(event_kind("friction_drift"), 0.0, 0.0)
    quantity = Quantity("coulomb_force_change", "N", 0.3)
    facts = Facts("coulomb_force", "N", 0.4, limit=0.2)
    (event,) = condition.judge(Finding(7, WARNING, False, "oil_contamination", quantity, facts))
    filled = replace(facts, began=7, urgency=Urgency.PLANNED, advice=202)
    assert event == Event(
        7, "friction_drift", RAISED, WARNING, "oil_contamination", quantity, code=202, facts=filled
    )
    assert math.isnan(event.quantity.standard_deviation)


@given(
    advised=st.sampled_from([(kind, one) for kind in KINDS.values() for one in kind.causes]),
    lasted=st.integers(1, 10 * 86400),
)
def test_what_is_over_says_how_long_it_lasted_and_advises_nothing(
    advised: tuple[EventKind, EventCause], lasted: int
) -> None:
    kind, cause = advised
    condition = Condition(kind, 0.0, 0.0)
    facts = Facts(
        "coulomb_force", "N", 0.4, limit=0.2, causes=("wear",), probabilities=(1.0,), time_to_limit=60.0,
        false_alarm_interval=3.6e6,
    )  # fmt: skip

    def shown(seconds: int, indicated: Severity | None) -> Event:
        finding = Finding(seconds * SECOND, indicated, indicated is None, cause.name, NOTHING, lambda: facts)
        (event,) = condition.judge(finding)
        return event

    raised, cleared = shown(1, ALARM), shown(1 + lasted, None)
    assert raised.facts.advice == raised.code == cleared.code == kind.cause(cause.name).code
    assert raised.facts.urgency > Urgency.NONE
    over = cleared.facts
    assert (over.advice, over.urgency, over.causes, over.probabilities) == (0, Urgency.NONE, (), ())
    assert math.isnan(over.time_to_limit)
    assert math.isnan(over.false_alarm_interval)
    shown_time = {one.field: one.text for one in details(cleared)}["lasted"]
    number, unit = shown_time.split()
    step, span = {"s": (0.1, 1), "min": (1, 60), "h": (1, 3600), "days": (1, 86400)}[unit]
    assert abs(float(number) * span - lasted) <= 0.5001 * step * span


def test_what_is_over_and_not_measured_any_more_names_what_was_judged() -> None:
    condition = Condition(event_kind("resonance"), 0.0, 0.0)
    condition.judge(Finding(1, WARNING, False, "", NOTHING, Facts("amplification", "1", 4.0, limit=1.8)))
    (event,) = condition.judge(Finding(2, None, True, "", NOTHING, Facts(note="at_rest")))
    assert (event.facts.parameter, event.facts.limit, event.facts.note) == ("amplification", 1.8, "at_rest")
    assert math.isnan(event.facts.value)


def test_what_was_raised_before_a_restart_is_over_after_a_time_that_nobody_knows() -> None:
    condition = Condition(event_kind("stale"), 0.0, 0.0)
    condition.restore(ALARM, "acceleration", Facts("silence", "s", 9.0, limit=1.5))
    (event,) = condition.clear(2 * SECOND, NOTHING, Facts(note="arrives_again"))
    assert event.facts.began == 0
    assert (event.facts.limit, event.facts.note) == (1.5, "arrives_again")
    assert "lasted" not in {one.field for one in details(event)}


@pytest.mark.parametrize("grows_after", [1, 30])
def test_an_alarm_that_grew_tells_since_when_it_began(grows_after: int) -> None:
    condition = Condition(event_kind("resonance"), on_delay=0.5, off_delay=1.0)
    judge(condition, 1.0, WARN)
    judge(condition, 1.5, WARN)
    judge(condition, 1.0 + grows_after, ALARMING)
    (event,) = judge(condition, 1.5 + grows_after, ALARMING)
    assert event.facts.began == 1 * SECOND


@given(
    on_delay=st.floats(0.0, 3.0),
    off_delay=st.floats(0.0, 3.0),
    steps=st.lists(
        st.tuples(st.floats(0.01, 2.0), st.sampled_from([QUIET, BETWEEN, WARN, ALARMING, EASED, OVER])),
        max_size=80,
    ),
)
def test_each_event_changes_the_severity_whatever_is_indicated(
    on_delay: float, off_delay: float, steps: list[tuple[float, What]]
) -> None:
    condition = Condition(event_kind("resonance"), on_delay, off_delay)
    now, active, last_stamp = 0.0, None, -1
    indicated_since: float | None = None
    for wait, what in steps:
        now += wait
        if what[0] is None:
            indicated_since = None
        elif indicated_since is None:
            indicated_since = now
        events = judge(condition, now, what)
        assert len(events) <= 1
        for event in events:
            assert event.stamp > last_stamp
            last_stamp = event.stamp
            if event.state is CLEARED:
                assert active is event.severity
                active = None
            else:
                assert event.severity is not active
                assert active is not ALARM or what == EASED
                if active is None:
                    assert indicated_since is not None
                    assert now - indicated_since >= on_delay - 2e-9
                active = event.severity
        assert condition.active is active


def test_after_a_clear_the_on_delay_starts_anew() -> None:
    condition = Condition(event_kind("resonance"), 0.5, 1.0)
    judge(condition, 0.0, WARN)
    judge(condition, 0.5, WARN)
    judge(condition, 1.0, QUIET)
    assert condition.clear(round(1.2 * SECOND), NOTHING)
    assert judge(condition, 1.3, WARN) == []
    assert judge(condition, 1.7, WARN) == []
    assert len(judge(condition, 1.8, WARN)) == 1
