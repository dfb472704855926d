"""Outlook of a drift: a steady one tells when it reaches its limit, a step and noise do not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spool_core.events.event import Facts, Urgency
from spool_core.events.sentences import details
from spool_core.uncertainty import Quantity
from spool_monitor.detectors import KINDS
from spool_monitor.event import Condition, EventKind, EventState, Finding, Severity
from spool_monitor.parameter_drift import Outlook

SECOND = 1_000_000_000
MEMORY = 4.0


def followed(changes: np.ndarray, noise: float = 0.02) -> Outlook:
    """Return the outlook of ``changes``, one a second."""
    outlook = Outlook()
    draw = np.random.default_rng(0)
    for second, change in enumerate(changes):
        outlook.take(SECOND, (second + 1) * SECOND, float(change + noise * draw.standard_normal()))
    return outlook


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("length", [40, 400, 4000])
def test_a_steady_drift_tells_when_it_reaches_its_limit(sign: float, length: int) -> None:
    ramp = sign * np.linspace(0.6, 1.2, length)
    rate = 0.6 / (length - 1)
    left = followed(ramp).seconds_to(2.0, MEMORY)
    assert left == pytest.approx(0.8 / rate, rel=0.2)


@pytest.mark.parametrize(("seconds", "tells"), [(15, False), (16, True)])
def test_a_trend_tells_once_it_has_lasted_four_memories_of_the_estimator(seconds: int, tells: bool) -> None:
    ramp = np.linspace(0.6, 1.2, seconds + 1)
    assert math.isfinite(followed(ramp, noise=0.0).seconds_to(2.0, MEMORY)) is tells


def test_what_has_passed_its_limit_has_no_time_left() -> None:
    assert followed(np.linspace(0.6, 2.4, 60)).seconds_to(2.0, MEMORY) == 0.0


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param(np.full(200, 1.3), id="rest"),
        pytest.param(
            1.3 * (1.0 - np.exp(-np.arange(200.0) / MEMORY)), id="a step that the estimator follows"
        ),
        pytest.param(np.linspace(1.5, 0.8, 200), id="one that goes back"),
        pytest.param(np.linspace(0.6, 0.9, 6), id="one that has hardly begun"),
        pytest.param(np.zeros(0), id="none"),
    ],
)
def test_no_trend_tells_no_time(changes: np.ndarray) -> None:
    assert math.isnan(followed(changes).seconds_to(2.0, MEMORY))


@pytest.mark.parametrize(("hurries", "urgency"), [(False, Urgency.PLANNED), (True, Urgency.SOON)])
def test_what_reaches_its_limit_within_a_shift_is_not_to_be_planned(hurries: bool, urgency: Urgency) -> None:
    finding = Finding(0, Severity.WARNING, False, "wear", Quantity("x", "1"), Facts(), hurries)
    (event,) = Condition(KINDS["friction_drift"], 0.0, 0.0).judge(finding)
    assert event.facts.urgency is urgency


def test_a_new_drift_forgets_the_one_before() -> None:
    outlook = followed(np.linspace(0.6, 1.2, 60))
    outlook.take(0, 61 * SECOND, 0.0)
    assert math.isnan(outlook.seconds_to(2.0, MEMORY))


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.name)
@pytest.mark.parametrize("severity", [Severity.WARNING, Severity.ALARM])
def test_every_alarm_says_what_since_when_how_urgent_and_what_to_do(
    kind: EventKind, severity: Severity
) -> None:
    for cause in [one.name for one in kind.causes] or [""]:
        condition = Condition(kind, 2.0, 2.0)
        facts = Facts("silence", "s", 3.0, limit=1.5)
        events = [
            event
            for second in range(1, 5)
            for event in condition.judge(
                Finding(second * SECOND, severity, False, cause, Quantity("x", "1"), facts)
            )
        ]
        (event,) = [event for event in events if event.state is EventState.RAISED]
        shown = [one.field for one in details(event)]
        order = ["measured", "limit", "began", "urgency", "meaning", "advice"]
        assert [one for one in shown if one in order] == order
        letter = kind.cause(cause).namur.letter
        assert (event.facts.urgency is Urgency.IMMEDIATE) == (
            letter == "F" or (letter == "S" and severity is Severity.ALARM)
        )
