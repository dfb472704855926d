from __future__ import annotations

import math

import pytest
from spool_monitor.event import Event, EventState, Severity
from spool_monitor.resonance import ResonanceDetector
from spool_monitor.spectrum import Line

NATURAL = 15.0


def line(seconds: float, frequency: float, amplification: float, body: float = 5.0) -> Line:
    return Line(round(seconds * 1e9), frequency, body, amplification * body, amplification, 1e-3, 0.9)


def drive(detector: ResonanceDetector, seconds: float, *arguments: float, start: float = 0.0) -> list[Event]:
    """Show the same line four times a second."""
    events = []
    for number in range(round(4 * seconds)):
        events += detector.update(line(start + 0.25 * number, *arguments), NATURAL)
    return events


@pytest.mark.parametrize(
    ("frequency", "amplification", "body", "severity"),
    [
        pytest.param(15.0, 2.5, 5.0, Severity.WARNING, id="near and amplified"),
        pytest.param(12.1, 1.9, 5.0, Severity.WARNING, id="lower edge"),
        pytest.param(17.9, 1.9, 5.0, Severity.WARNING, id="upper edge"),
        pytest.param(15.0, 3.7, 5.0, Severity.ALARM, id="twice the warning"),
        pytest.param(15.0, 1.7, 5.0, None, id="near alone"),
        pytest.param(18.1, 9.0, 5.0, None, id="amplified alone, above"),
        pytest.param(11.9, 9.0, 5.0, None, id="amplified alone, below"),
        pytest.param(40.0, 0.5, 5.0, None, id="neither"),
        pytest.param(15.0, 9.0, 0.49, None, id="too weak to judge"),
        pytest.param(15.0, 9.0, 0.51, Severity.ALARM, id="just strong enough"),
    ],
)
def test_near_and_amplified_and_strong(
    frequency: float, amplification: float, body: float, severity: Severity | None
) -> None:
    detector = ResonanceDetector()
    events = drive(detector, 5.0, frequency, amplification, body)
    assert [event.severity for event in events] == ([severity] if severity else [])
    for event in events:
        assert event.state is EventState.RAISED
        assert event.stamp == 500_000_000
        assert event.quantity.value == amplification
        assert f"{frequency:.1f} Hz" in event.message


@pytest.mark.parametrize(
    ("frequency", "amplification", "body", "clears"),
    [
        pytest.param(15.0, 1.6, 5.0, False, id="between the thresholds"),
        pytest.param(18.5, 2.5, 5.0, False, id="within a quarter beyond the band"),
        pytest.param(18.8, 2.5, 5.0, True, id="far"),
        pytest.param(15.0, 1.4, 5.0, True, id="no longer amplified"),
        pytest.param(15.0, 2.5, 0.4, True, id="too weak"),
    ],
)
def test_release(frequency: float, amplification: float, body: float, clears: bool) -> None:
    detector = ResonanceDetector()
    assert len(drive(detector, 2.0, 15.0, 2.5)) == 1
    events = drive(detector, 5.0, frequency, amplification, body, start=2.0)
    assert [event.state for event in events] == ([EventState.CLEARED] if clears else [])
    assert [event.stamp for event in events] == ([3_000_000_000] if clears else [])


def test_it_follows_the_natural_frequency() -> None:
    detector = ResonanceDetector()
    shaking = [line(0.25 * number, 29.0, 3.0) for number in range(8)]
    assert [event for one in shaking for event in detector.update(one, 15.0)] == []
    raised = [event for one in shaking for event in detector.update(one, 29.0)]
    assert [event.state for event in raised] == [EventState.RAISED]


def test_silence_ends_it_after_the_same_delay() -> None:
    detector = ResonanceDetector()
    assert detector.silent(0) == []
    drive(detector, 2.0, 15.0, 2.5)
    events = [
        event for number in range(12) for event in detector.silent(2_000_000_000 + number * 250_000_000)
    ]
    assert [(event.state, event.stamp) for event in events] == [(EventState.CLEARED, 3_000_000_000)]
    assert math.isnan(events[0].quantity.value)
    assert events[0].message == "resonance is over: the body is at rest"
