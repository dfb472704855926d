"""Estimates of one estimator are used; a second one is a fault, a restarted one goes on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.one_source import Standing
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import MonitorSettings
from spool_monitor.estimate_gate import Descriptions
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
RATE, SIZE = 500.0, 50
STEP = 100_000_000  # ns, a block
SECONDS = 24
LATER = 40 * 86_400 * 1_000_000_000


@cache
def stream() -> tuple[Block, ...]:
    simulator = Simulator(VALVE, PRESETS["multisine"], sample_rate=RATE, block_size=SIZE)
    return tuple(simulator.next_block() for _ in range(10 * SECONDS))


@cache
def estimates(start: int = 0, period: float = 1.0, phase: int = 0) -> dict[int, Estimate]:
    """Return the estimates of an estimator that hears the stream from block ``start`` on, by block."""
    estimator = Estimator(settings_for(VALVE, period=period, phase=phase))
    found = {}
    for block in stream()[start:]:
        for one in estimator.update(block):
            found[block.sequence] = replace(one, source=VALVE.id)
    return found


class Watched:
    """Monitor that hears the stream and the estimates of some estimators."""

    def __init__(self) -> None:
        self.monitor = Monitor(MonitorSettings(natural_frequency=VALVE.natural_frequency))
        self.used: list[Estimate] = []
        self.events: list[Event] = []

    def hear(self, number: int, *told: Estimate | None) -> None:
        self.events += self.monitor.update(stream()[number])
        for one in told:
            if one is not None:
                self.events += self.monitor.update_estimate(one)
                if self.monitor.estimate is one:
                    self.used.append(one)

    @property
    def faults(self) -> list[tuple[str, str, EventState]]:
        return [(one.cause, one.source, one.state) for one in self.events if one.kind == "data_fault"]


@pytest.mark.parametrize("period", [0.1, 1.0, 3.0])
def test_every_estimate_of_one_estimator_is_used(period: float) -> None:
    watched, own = Watched(), estimates(0, period, 0)
    for number in range(10 * SECONDS):
        watched.hear(number, own.get(number))
    assert watched.used == list(own.values())
    assert watched.faults == []


@settings(max_examples=40 if settings().derandomize else 300)
@given(
    start=st.integers(1, 80),
    joins=st.integers(30, 150),
    phase=st.integers(0, 9),
    ahead=st.sampled_from([0, -LATER, LATER]),
    first=st.booleans(),
    other=st.booleans(),
)
@example(start=0, joins=30, phase=1, ahead=0, first=False, other=False)
def test_a_second_estimator_is_never_used_and_a_fault(
    start: int, joins: int, phase: int, ahead: int, first: bool, other: bool
) -> None:
    """It began later by ``start`` blocks, or is a record of another day, played into the live valve.

    Both have the ``phase`` of the valve's namespace.
    """
    watched, own, theirs = Watched(), estimates(0, 1.0, phase), estimates(start, 1.0, phase)
    for number in range(10 * SECONDS):
        second = theirs.get(number) if number >= joins else None
        if second is not None:
            second = replace(second, stamp=second.stamp + ahead, source="4weh10_stiff" if other else VALVE.id)
        both = (own.get(number), second)
        watched.hear(number, *(both[::-1] if first else both))
    assert watched.used == list(own.values())
    assert watched.faults[:1] == [("source", "estimate", EventState.RAISED)]
    assert watched.monitor.health.level.name == "WARNING"


@given(dies=st.integers(50, 120), pause=st.integers(0, 30), other=st.booleans())
@settings(max_examples=20)
def test_an_estimator_that_was_restarted_is_used_within_seconds(dies: int, pause: int, other: bool) -> None:
    name = "4weh10_stiff" if other else VALVE.id
    watched, own, later = Watched(), estimates(), estimates(dies + pause)
    for number in range(10 * SECONDS):
        one = own.get(number) if number < dies else later.get(number)
        watched.hear(number, one if one is None or number < dies else replace(one, source=name))
    rest = [one for one in watched.used if one.source != VALVE.id or one in later.values()]
    assert len(rest) >= len(later) - 3
    assert watched.used[-1].stamp == max(one.stamp for one in later.values())
    raised = [one for one in watched.events if one.cause == "source" and one.state is EventState.RAISED]
    assert [one.facts.subject for one in raised] == ([name] if other else [])


def test_a_second_estimator_that_ends_is_over_and_the_first_one_goes_on() -> None:
    watched, own, theirs = Watched(), estimates(), estimates(20)
    watched.monitor._data_faults.conditions["estimate"].off_delay = 5.0
    for number in range(10 * SECONDS):
        watched.hear(number, own.get(number), theirs.get(number) if 60 < number < 120 else None)
    assert watched.faults == [
        ("source", "estimate", EventState.RAISED),
        ("source", "estimate", EventState.CLEARED),
    ]
    assert watched.used == list(own.values())


def test_the_second_estimator_takes_over_where_the_first_one_ends() -> None:
    watched, own, theirs = Watched(), estimates(), estimates(20)
    for number in range(10 * SECONDS):
        watched.hear(number, own.get(number) if number < 120 else None, theirs.get(number))
    assert watched.used[-1] == list(theirs.values())[-1]
    assert watched.monitor.estimates.standing is None


def test_an_estimate_that_came_before_a_pause_is_not_taken_for_a_second_estimator() -> None:
    """It is latched: the monitor gets it again when it is activated."""
    watched, own = Watched(), estimates()
    for number in range(100):
        watched.hear(number, own.get(number))
    watched.monitor.gate.resume()
    watched.monitor.estimates.resume()
    latched = watched.used[-1]
    for number in range(150, 10 * SECONDS):
        watched.hear(number, latched if number == 150 else None, own.get(number))
    assert watched.faults == []
    assert watched.monitor.estimates.standing is not Standing.OPEN
    assert watched.used[-1] == list(own.values())[-1]


def test_the_description_of_an_estimator_whose_estimates_are_not_used_waits() -> None:
    watched, used = Watched(), Descriptions[str]()
    assert used.take(VALVE.id, "the valve", None) == "the valve"
    for number in range(100):
        watched.hear(number, estimates().get(number))
    gate = watched.monitor.estimates
    assert used.take("4weh10_stiff", "another one", gate.last) is None
    assert used.take(VALVE.id, "the valve with other oil", gate.last) is None
    assert used.follow(gate) is None
    later = estimates(100)
    found = []
    for number in range(100, 200):
        watched.hear(number, later.get(number))
        if later.get(number) is watched.monitor.estimate:
            found.append(used.follow(gate))
    assert [one for one in found if one] == ["the valve with other oil"]
    assert used.used == VALVE.id


def test_a_description_that_comes_after_the_first_estimate_of_its_estimator_is_used() -> None:
    watched, used = Watched(), Descriptions[str]("4weh10_stiff")
    for number in range(100):
        watched.hear(number, estimates().get(number))
    assert used.take(VALVE.id, "the valve", watched.monitor.estimates.last) == "the valve"


def test_the_description_of_an_estimator_that_was_silent_for_a_while_is_used_again() -> None:
    watched, used, found = Watched(), Descriptions[str](), []
    other = {number: replace(one, source="4weh10_stiff") for number, one in estimates(10).items()}
    found.append(used.take(VALVE.id, "the valve", None))
    for number in range(200):
        first = estimates().get(number) if number < 60 or number > 120 else None
        second = other.get(number) if 60 <= number <= 120 else None
        if number == 60:
            found.append(used.take("4weh10_stiff", "another one", watched.monitor.estimates.last))
        watched.hear(number, first, second)
        if watched.monitor.estimate in (first, second):
            found.append(used.follow(watched.monitor.estimates))
    assert [one for one in found if one] == ["the valve", "another one", "the valve"]
