from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest
from spool_monitor.detection import Detection, configured
from spool_monitor.detectors import Moment, MonitorSettings
from spool_monitor.detectors.resonance import KIND, Resonance
from spool_monitor.event import Condition, Event, EventState, Severity
from spool_monitor.window import Line

NATURAL = 15.0


@dataclass
class Judge:
    """The detector with its condition."""

    detector: Resonance = field(default_factory=lambda: Resonance(MonitorSettings()))
    condition: Condition = field(default_factory=lambda: Condition(KIND, 0.5, 1.0))
    detection: Detection = field(default_factory=lambda: Detection(MonitorSettings()))

    def see(self, stamp: int, line: Line | None, natural: float = NATURAL, **more: object) -> list[Event]:
        detection = self.detection
        moment = Moment(
            stamp, natural, configured(natural), detection.parameters, detection.learned,
            line=line, silent=line is None, **more,
        )  # fmt: skip
        found = self.detector.update(moment)
        assert found is not None
        return self.condition.judge(found)


def line(seconds: float, frequency: float, amplification: float, body: float = 5.0) -> Line:
    return Line(round(seconds * 1e9), frequency, body, amplification * body, amplification, 1e-3, 0.9)


def shake(judge: Judge, seconds: float, *arguments: float, start: float = 0.0) -> list[Event]:
    """Show the same line four times a second."""
    events = []
    for number in range(round(4 * seconds)):
        seen = line(start + 0.25 * number, *arguments)
        events += judge.see(seen.stamp, seen)
    return events


@pytest.mark.parametrize(
    ("frequency", "amplification", "body", "severity"),
    [
        pytest.param(15.0, 2.5, 5.0, Severity.WARNING, id="near and amplified"),
        pytest.param(12.9, 1.9, 5.0, Severity.WARNING, id="lower edge"),
        pytest.param(17.1, 1.9, 5.0, Severity.WARNING, id="upper edge"),
        pytest.param(15.0, 3.7, 5.0, Severity.ALARM, id="twice the warning"),
        pytest.param(15.0, 1.7, 5.0, None, id="near alone"),
        pytest.param(17.4, 9.0, 5.0, None, id="amplified alone, above"),
        pytest.param(12.7, 9.0, 5.0, None, id="amplified alone, below"),
        pytest.param(40.0, 0.5, 5.0, None, id="neither"),
        pytest.param(15.0, 9.0, 0.49, None, id="too weak to judge"),
        pytest.param(15.0, 9.0, 0.51, Severity.ALARM, id="just strong enough"),
    ],
)
def test_near_and_amplified_and_strong(
    frequency: float, amplification: float, body: float, severity: Severity | None
) -> None:
    detector = Judge()
    events = shake(detector, 5.0, frequency, amplification, body)
    assert [event.severity for event in events] == ([severity] if severity else [])
    for event in events:
        assert event.state is EventState.RAISED
        assert event.stamp == 500_000_000
        assert event.quantity.value == amplification
        assert numbers(event)["dominant_frequency"] == frequency
        assert event.facts.limit <= event.facts.value == amplification


@pytest.mark.parametrize(
    ("frequency", "amplification", "body", "clears"),
    [
        pytest.param(15.0, 1.6, 5.0, False, id="between the thresholds"),
        pytest.param(17.5, 2.5, 5.0, False, id="within a quarter beyond the band"),
        pytest.param(18.8, 2.5, 5.0, True, id="far"),
        pytest.param(15.0, 1.4, 5.0, True, id="no longer amplified"),
        pytest.param(15.0, 2.5, 0.4, True, id="too weak"),
    ],
)
def test_release(frequency: float, amplification: float, body: float, clears: bool) -> None:
    detector = Judge()
    assert len(shake(detector, 2.0, 15.0, 2.5)) == 1
    events = shake(detector, 5.0, frequency, amplification, body, start=2.0)
    assert [event.state for event in events] == ([EventState.CLEARED] if clears else [])
    assert [event.stamp for event in events] == ([3_000_000_000] if clears else [])


def test_it_follows_the_natural_frequency() -> None:
    judge = Judge()
    shaking = [line(0.25 * number, 29.0, 3.0) for number in range(8)]
    assert [event for one in shaking for event in judge.see(one.stamp, one, 15.0)] == []
    raised = [event for one in shaking for event in judge.see(one.stamp, one, 29.0)]
    assert [event.state for event in raised] == [EventState.RAISED]


def numbers(event: Event) -> dict[str, float]:
    """Return the further numbers of an event."""
    return {one.name: one.value for one in event.facts.evidence}


def test_an_event_carries_what_the_model_expects_and_when_it_was_raised() -> None:
    judge = Judge()
    (raised,) = shake(judge, 2.0, 15.0, 2.5)
    assert numbers(raised)["expected_amplification"] == abs(configured(NATURAL).transfer(15.0))
    assert numbers(raised)["relative_displacement"] == 1e-3
    (cleared,) = shake(judge, 3.0, 40.0, 0.5, start=2.0)
    assert cleared.stamp == 3_000_000_000
    assert cleared.facts.began == raised.stamp


def test_a_line_that_leaves_the_band_while_it_is_amplified_is_compared_with_the_band() -> None:
    judge = Judge()
    assert shake(judge, 2.0, 15.0, 2.5)
    (cleared,) = shake(judge, 3.0, 18.8, 2.5, start=2.0)
    assert (cleared.facts.parameter, cleared.facts.value) == ("dominant_frequency", 18.8)
    assert 15.0 < cleared.facts.limit < 18.8


def test_silence_ends_it_after_the_same_delay() -> None:
    judge = Judge()
    assert judge.see(0, None) == []
    shake(judge, 2.0, 15.0, 2.5)
    events = [
        event for number in range(12) for event in judge.see(2_000_000_000 + number * 250_000_000, None)
    ]
    assert [(event.state, event.stamp) for event in events] == [(EventState.CLEARED, 3_000_000_000)]
    assert math.isnan(events[0].quantity.value)
    assert events[0].facts.note == "at_rest"


def test_with_a_faulty_sensor_nothing_begins_or_ends() -> None:
    judge = Judge()
    resonant = [line(0.25 * number, 15.0, 3.0) for number in range(12)]
    assert [e for one in resonant for e in judge.see(one.stamp, one, distrust="a sensor is dead")] == []


def test_a_line_that_is_near_only_since_the_spring_is_soft_is_the_springs_event() -> None:
    judge = Judge()
    stiffness = judge.detection.parameters["spring_stiffness"]
    stiffness._smoothed = -2.0  # 20 % softer: the healthy valve had 13.0 / sqrt(0.8) Hz
    seen = [line(0.25 * number, 12.0, 3.0) for number in range(8)]
    assert [e for one in seen for e in judge.see(one.stamp, one, 13.0)] == []
    stiffness._smoothed = 0.0
    assert [e.state for one in seen for e in judge.see(one.stamp, one, 13.0)] == [EventState.RAISED]
