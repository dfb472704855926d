"""Outlook of a drift: a steady one tells when it reaches its limit, a step and noise do not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spool_monitor.detectors import KINDS
from spool_monitor.drift.outlook import Outlook
from spool_monitor.events.condition import Condition, Finding
from spool_monitor.events.event import EventState, Severity
from spool_monitor.events.event_kind import EventKind
from spool_stream.quantity import Quantity

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
    outlook = followed(changes)
    assert math.isnan(outlook.seconds_to(2.0, MEMORY))
    assert "nothing is said of when" in outlook.text(2.0, MEMORY)


def test_a_new_drift_forgets_the_one_before() -> None:
    outlook = followed(np.linspace(0.6, 1.2, 60))
    outlook.take(0, 61 * SECOND, 0.0)
    assert math.isnan(outlook.seconds_to(2.0, MEMORY))


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.name)
@pytest.mark.parametrize("severity", [Severity.WARNING, Severity.ALARM])
def test_every_alarm_says_what_since_when_how_sure_how_urgent_and_what_to_do(
    kind: EventKind, severity: Severity
) -> None:
    for cause in [one.name for one in kind.causes] or [""]:
        condition = Condition(kind, 2.0, 2.0)
        events = [
            event
            for second in range(4)
            for event in condition.judge(
                Finding(second * SECOND, severity, False, cause, Quantity("x", "1"), "what is seen")
            )
        ]
        (event,) = [event for event in events if event.state is EventState.RAISED]
        parts = ["what is seen", "began about 2.0 s ago", "how sure: ", "how urgent: ", "what to do: "]
        places = [event.message.index(part) for part in parts]
        assert places == sorted(places)
        letter = kind.cause(cause).namur.letter
        assert f"(NE 107: {letter}, " in event.message
        assert ("at once" in event.message) == (
            letter == "F" or (letter == "S" and severity is Severity.ALARM)
        )
