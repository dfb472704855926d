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
INDICATED = {
    "quiet": QUIET, "between": BETWEEN, "warn": WARN, "alarm": ALARMING, "eased": EASED, "over": OVER,
}  # fmt: skip
What = tuple[Severity | None, bool] | tuple[Severity | None, bool, bool]


def judge(condition: Condition, seconds: float, what: What, cause: str = "") -> list[Event]:
    indicated, released, *eased = what
    finding = Finding(round(seconds * SECOND), indicated, released, cause, NOTHING, eased=any(eased))
    return condition.judge(finding)


def course(*steps: tuple[float, What]) -> list[tuple[float, EventState, Severity]]:
    condition = Condition(event_kind("resonance"), on_delay=0.5, off_delay=1.0)
    events = [event for seconds, what in steps for event in judge(condition, seconds, what)]
    return [(event.stamp / SECOND, event.state, event.severity) for event in events]


#: Whether each course raises and clears: what is indicated, by s, and what is announced, by s.
COURSES = {
    "quiet": ("0 quiet, 9 quiet", ""),
    "shorter than the on delay": ("0 warn, 0.49 warn", ""),
    "on delay": ("0 warn, 0.5 warn, 9 warn", "0.5 raised warning"),
    "interrupted by quiet": ("0 warn, 0.4 quiet, 0.5 warn, 0.9 warn", ""),
    "interrupted by between": ("0 warn, 0.4 between, 0.5 warn, 0.9 warn", ""),
    "between never raises": ("0 between, 9 between", ""),
    "between never clears": ("0 warn, 0.5 warn, 1 between, 9 between", "0.5 raised warning"),
    "off too short": ("0 warn, 0.5 warn, 1 quiet, 1.9 quiet", "0.5 raised warning"),
    "off delay": ("0 warn, 0.5 warn, 1 quiet, 2 quiet, 9 quiet", "0.5 raised warning, 2 cleared warning"),
    "the off delay starts again after between": (
        "0 warn, 0.5 warn, 1 quiet, 1.5 between, 2 quiet, 2.9 quiet",
        "0.5 raised warning",
    ),
    "the off delay starts again after an indication": (
        "0 warn, 0.5 warn, 1 quiet, 1.5 warn, 2 quiet, 2.9 quiet",
        "0.5 raised warning",
    ),
    "looks at a higher severity that are shorter than the on delay": (
        "0 warn, 0.5 warn, 0.6 alarm, 0.7 warn, 1.2 alarm, 1.6 alarm, 9 warn",
        "0.5 raised warning",
    ),
    "a higher severity after the on delay and once": (
        "0 warn, 0.5 warn, 0.6 alarm, 1.1 alarm, 1.2 warn, 1.8 alarm",
        "0.5 raised warning, 1.1 raised alarm",
    ),
    "a warning first where the alarm did not hold as long": (
        "0 warn, 0.4 alarm, 0.5 alarm, 0.8 alarm, 0.9 alarm",
        "0.5 raised warning, 0.9 raised alarm",
    ),
    "an alarm that weakens stays one above its deadband": (
        "0 alarm, 0.5 alarm, 1 warn, 2 quiet, 3 quiet",
        "0.5 raised alarm, 3 cleared alarm",
    ),
    "an alarm below its deadband is a warning after the off delay and once": (
        "0 alarm, 0.5 alarm, 1 eased, 1.9 alarm, 2 eased, 2.9 eased, 3 eased, 9 eased",
        "0.5 raised alarm, 3 raised warning",
    ),
    "and an alarm again after the on delay": (
        "0 alarm, 0.5 alarm, 1 eased, 2 eased, 2.1 alarm, 2.5 alarm, 2.6 alarm",
        "0.5 raised alarm, 2 raised warning, 2.6 raised alarm",
    ),
    "what is over needs no step to a warning": (
        "0 alarm, 0.5 alarm, 1 over, 2 over",
        "0.5 raised alarm, 2 cleared alarm",
    ),
    "a clock set back starts the delay again": ("9 warn, 1 warn, 1.4 warn, 1.5 warn", "1.5 raised warning"),
    "a clock set back does not hold an event": (
        "9 warn, 9.5 warn, 20 quiet, 1 quiet, 1.9 quiet, 2 quiet",
        "9.5 raised warning, 2 cleared warning",
    ),
}


@pytest.mark.parametrize(("steps", "announced"), COURSES.values(), ids=COURSES.keys())
def test_course(steps: str, announced: str) -> None:
    words = [step.split() for step in steps.split(", ")]
    found = course(*((float(seconds), INDICATED[what]) for seconds, what in words))
    shown = [f"{seconds:g} {state.name} {severity.name}".lower() for seconds, state, severity in found]
    assert ", ".join(shown) == announced


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
