"""Orders of a machine's shaft: named with its speed where they are sure, never by noise or a foreign tone."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.events.event import Event, EventState
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import described, headline
from spool_core.numbers import Array
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor import orders
from spool_monitor.monitor import Monitor
from spool_monitor.orders import (
    REACH,
    OrderName,
    OrderTracker,
    contrast,
    false_probability,
    line_powers,
    order_spectrum,
)
from spool_monitor.replay import Replay
from spool_sim.excitation import PRESETS, MachineOrders
from spool_sim.simulator import Simulator
from spool_sim.valve import Component, find_valve

PERIOD, SIZE = 5e-4, 40
PUMP, ENGINE = Component(name="pump", pistons=9), Component(name="engine", strokes=4, cylinders=6)
Rpm = Callable[[float], float]


def run_up(order: float, amplitude: float = 5.0) -> MachineOrders:
    """Return a run-up from 600 to 1250 rev/min in 65 s with two orders, of which one is the stronger."""
    strengths = {1.0: 2.0, 2.0: 2.0, order: amplitude}
    profile = ((0.0, 600.0), (10.0, 600.0), (75.0, 1250.0))
    return MachineOrders(speed_profile=profile, orders=tuple(strengths.items()), broadband_rms=1.0)


def names(
    body: Array, speed: Rpm, frequency: float | None, *components: Component
) -> list[tuple[OrderName | None, str]]:
    """Return the name of the line of ``frequency`` (Hz; the strongest one without it) in each half second."""
    tracker, found = OrderTracker(components), []
    tracker.restart(PERIOD)
    for first in range(0, body.size - SIZE, SIZE):
        stamp, samples = 10**9 + round(first * PERIOD * 1e9), body[first : first + SIZE].astype(np.float32)
        if first % (5 * SIZE) == 0:
            tracker.take_speed(stamp, speed(first * PERIOD))
        tracker.take(Block(stamp, first // SIZE, PERIOD, samples, samples))
        if first % 1000 == 0 and first >= 2000:
            second = line_powers(body[first - 2000 : first])
            line = float(4 + np.argmax(second[4:250])) if frequency is None else frequency
            found.append(tracker.named(line, stamp + 20_000_000))
    return found


@pytest.mark.parametrize(
    ("valve", "order", "natural"), [("4weh10_stiff", 2.0, 29.0), ("4weh10_soft", 1.0, 15.0)]
)
def test_a_run_up_through_resonance_names_order_component_and_speed(
    valve: str, order: float, natural: float
) -> None:
    shaking, known = run_up(order), find_valve(valve)
    # The drag of warm oil, so that the soft valve resonates as well.
    source = Simulator(known.model_copy(update={"dynamic_viscosity": 0.01}), shaking, model="fluid")
    one = Replay(Estimator(settings_for(known)), Monitor())
    one.monitor.detection.orders.components = (PUMP, Component(name="fan", ratio=1.37))
    start = None
    for block in source.records(75.0):
        start = block.stamp if start is None else start
        if block.sequence % 5 == 0:
            one.monitor.update_speed(block.stamp, shaking.speed((block.stamp - start) * 1e-9))
        one.update(block)
    one.flush()
    raised = [one for one in one.events if one.kind == "resonance" and one.state is EventState.RAISED]
    assert raised
    assert start is not None
    for event in raised:
        told = {one.name: one.value for one in event.facts.evidence}
        assert (told["order"], event.facts.subject) == (order, "pump")
        truth = shaking.speed((event.stamp - start) * 1e-9)
        assert told["speed"] == pytest.approx(truth, rel=0.01)
        assert told["order"] * told["speed"] / 60.0 == pytest.approx(natural, rel=0.2)
        ordinal = {1.0: "1st", 2.0: "2nd"}[order]
        assert headline(event).startswith(
            f"Resonance ({ordinal} order of the pump, {told['speed']:.0f} rev/min)"
        )
        assert all(len(headline(event, language).split()) <= 12 for language in LANGUAGES.values())


@pytest.mark.parametrize("noise", ["white", "lines", "structure"])
@pytest.mark.parametrize("speed", [lambda _: 870.0, lambda t: 600.0 + 10.0 * t], ids=["steady", "run-up"])
def test_a_thousand_blocks_of_broadband_name_nothing(noise: str, speed: Rpm) -> None:
    time = PERIOD * np.arange(1000 * SIZE + SIZE)
    draws = np.random.default_rng(1).normal(0.0, 4.0, time.size)
    if noise == "lines":
        body = PRESETS["multisine"].acceleration(time)
    elif noise == "structure":  # of 1 % damping at 29 Hz, shaken by noise
        squared = -1j * np.fft.rfftfreq(time.size, PERIOD) / 29.0
        body = np.fft.irfft(np.fft.rfft(draws) / (1.0 + 0.02 * -squared + squared**2), time.size)
    else:
        body = draws
    for frequency in (14.5, 29.0, 43.5, None):
        assert {name for name, _ in names(body, speed, frequency)} == {None}


def test_the_false_alarm_probability_is_the_stated_one() -> None:
    powers = line_powers(np.random.default_rng(2).normal(size=(200, 2000)))
    places = np.arange(REACH, 1000 - REACH)
    found = false_probability(contrast(powers, places))
    for wanted in (0.1, 0.01, 0.001):
        assert np.mean(found < wanted) == pytest.approx(wanted, rel=0.25)


@pytest.mark.parametrize(
    ("speed", "remark"),
    [
        (lambda t: 870.0 if t < 9.0 else math.nan, "speed_invalid"),
        (lambda t: 870.0 if t < 9.0 else -870.0, "speed_negative"),
        (lambda t: 870.0 if t < 9.0 else 0.0, "speed_standstill"),
        (lambda t: 870.0 if t < 9.0 else 1740.0, "speed_jump"),
        (lambda t: 900.0, "order_unknown"),
    ],
)
def test_a_useless_or_wrong_speed_is_said_and_names_nothing(speed: Rpm, remark: str) -> None:
    time = PERIOD * np.arange(24_000)
    body = 5.0 * np.sin(2.0 * np.pi * 29.0 * time)
    assert names(body, speed, 29.0)[-1] == (None, remark)
    assert names(body, lambda _: 870.0, 29.0)[-1] == (OrderName(2.0, "", 870.0), "")


def test_a_speed_that_stops_arriving_names_nothing() -> None:
    tracker, samples = OrderTracker(), np.zeros(SIZE, np.float32)
    tracker.restart(PERIOD)
    assert tracker.named(29.0, 10**9) == (None, "")  # nobody measures a speed: there is nothing to say
    for number in range(500):
        stamp = 10**9 + number * 20_000_000
        if number < 300:
            tracker.take_speed(stamp, 870.0)
        tracker.take(Block(stamp, number, PERIOD, samples, samples))
    assert tracker.named(29.0, stamp) == (None, "speed_stale")


def test_a_tone_that_does_not_follow_the_shaft_is_not_named() -> None:
    time = PERIOD * np.arange(60_000)
    body = 5.0 * np.sin(2.0 * np.pi * 29.0 * time) + np.random.default_rng(3).normal(0.0, 1.0, time.size)
    assert {name for name, _ in names(body, lambda t: 800.0 + 10.0 * t, 29.0)} == {None}


def test_an_order_of_several_components_names_none_of_them() -> None:
    time = PERIOD * np.arange(24_000)
    body = 5.0 * np.sin(2.0 * np.pi * 29.0 * time)
    both = names(body, lambda _: 870.0, 29.0, PUMP, Component(name="fan"))[-1][0]
    assert both == OrderName(2.0, "", 870.0)
    # Firing of six cylinders is the engine's own, although a fan on its shaft has a third piston.
    firing = names(body, lambda _: 580.0, 29.0, ENGINE, Component(name="fan", ratio=3.0))[-1][0]
    assert firing == OrderName(3.0, "engine", 580.0)
    geared = names(body, lambda _: 580.0, 29.0, Component(name="fan", ratio=3.0))[-1][0]
    assert geared == OrderName(1.0, "fan", 1740.0)


def test_an_order_spectrum_shows_the_orders_of_a_run_up_and_nothing_else() -> None:
    shaking, time = run_up(2.0), PERIOD * np.arange(150_000)
    body = shaking.acceleration(time) + 2.0 * np.sin(2.0 * np.pi * 41.0 * time)
    speeds = [(10**9 + n * 10**8, shaking.speed(0.1 * n)) for n in range(750)]
    found = order_spectrum([(10**9, PERIOD, body, 2.0 * body)], speeds)
    assert [round(one.order, 3) for one in found.lines] == [1.0, 2.0]
    assert [one.body for one in found.lines] == pytest.approx([2.0, 5.0], rel=0.05)
    assert [one.spool for one in found.lines] == pytest.approx([4.0, 10.0], rel=0.05)
    assert (found.slowest, found.fastest) == pytest.approx((600.0, 1250.0), rel=0.03)
    broken = [(stamp, math.nan if n % 20 == 0 else rpm) for n, (stamp, rpm) in enumerate(speeds)]
    nothing = order_spectrum([(10**9, PERIOD, body, body)], broken)
    assert (nothing.lines, nothing.fault) == ((), "speed_invalid")


def test_what_is_kept_is_bounded() -> None:
    tracker, samples = OrderTracker(), np.zeros(SIZE, np.float32)
    tracker.restart(PERIOD)
    for number in range(20_000):
        tracker.take_speed(10**9 + number * 20_000_000, 870.0)
        tracker.take(Block(10**9 + number * 20_000_000, number, PERIOD, samples, samples))
    kept = sum(body.size for _, body in tracker._blocks)
    assert kept * PERIOD <= orders.MEMORY + orders.STALE + 2 * SIZE * PERIOD
    assert len(tracker._speeds) <= orders.MOST_SPEEDS


def test_a_remark_says_why_there_is_no_order() -> None:
    known = find_valve("4weh10_stiff")
    shaking = PRESETS["steady"].model_copy(update={"frequency": 29.0})
    one = Replay(Estimator(settings_for(known)), Monitor())
    for block in Simulator(known, shaking, model="fluid").records(6.0):
        one.monitor.update_speed(block.stamp, math.nan)
        one.update(block)
    one.flush()
    (event,) = [event for event in one.events if event.kind == "resonance"]
    assert isinstance(event, Event)
    assert "Remark: no order named: the speed is no number" in described(event)
