"""Speed from harmonics: shown by two sources that fit one speed, else not at all."""

from __future__ import annotations

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.events.event import EventState
from spool_core.events.sentences import described, headline
from spool_core.numbers import Array
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.harmonics import sharp_lines, speed_from_harmonics
from spool_monitor.monitor import Monitor
from spool_monitor.orders import OrderTracker
from spool_monitor.replay import Replay
from spool_sim.excitation import MachineOrders
from spool_sim.simulator import Simulator
from spool_sim.valve import Component, find_valve

PERIOD, SAMPLES = 5e-4, 16_000
PUMP = (Component(name="pump", pistons=9),)


def shaken(rpm: float, *orders: float, noise: float = 1.0, amplitude: float = 1.0) -> Array:
    """Return 8 s of a body that ``orders`` of a shaft of constant speed shake, in white noise."""
    time, rng = PERIOD * np.arange(SAMPLES), np.random.default_rng(1)
    phases = rng.uniform(0.0, 6.0, len(orders))
    tones = [np.sin(2.0 * np.pi * o * rpm / 60.0 * time + p) for o, p in zip(orders, phases, strict=True)]
    return np.asarray(amplitude * np.sum(tones, axis=0) + rng.normal(0.0, noise, SAMPLES))


@pytest.mark.parametrize("orders", [(1, 9, 18, 27), (1, 2, 27), (1, 2, 3, 27), (1, 2, 9, 18, 27)])
def test_shaft_and_pistons_show_the_speed(orders: tuple[float, ...]) -> None:
    found = speed_from_harmonics(shaken(871.3, *orders), PERIOD, PUMP)
    assert found is not None
    assert found.rpm == pytest.approx(871.3, rel=1e-4)
    assert 0.99 <= found.confidence < 1.0
    assert tuple(found.lines) == orders


@pytest.mark.parametrize(
    "orders",
    [
        (),
        (9,),  # a single line
        (9, 18, 27),  # harmonics of anything
        (1, 2),
        (1, 9),  # or orders 2 and 18 at half the speed
        (1, 2, 9, 18),  # or 2, 4, 18 and 36
        (1.234, 3.71),  # nothing of the pump
    ],
)
def test_lines_that_fit_no_speed_or_two_show_none(orders: tuple[float, ...]) -> None:
    assert speed_from_harmonics(shaken(871.3, *orders), PERIOD, PUMP) is None


def test_an_engine_has_every_harmonic_and_shows_no_speed() -> None:
    engine = (Component(name="engine", strokes=4, cylinders=6),)
    assert speed_from_harmonics(shaken(871.3, 0.5, 1.0, 1.5, 3.0, 6.0), PERIOD, engine) is None


def test_a_run_up_shows_no_speed() -> None:
    time = PERIOD * np.arange(SAMPLES)
    turns = 10.0 * time + 0.05 * time**2
    body = sum(np.sin(2.0 * np.pi * order * turns) for order in (1, 2, 9, 18, 27))
    assert speed_from_harmonics(np.asarray(body), PERIOD, PUMP) is None


def test_the_frequency_of_a_line_lies_within_its_deviation() -> None:
    off = []
    for number in range(60):
        truth = 20.0 + 1.37 * number
        (line,) = sharp_lines(shaken(60.0, truth, noise=2.0 + 0.02 * number, amplitude=0.7), PERIOD)
        off.append((line.frequency - truth) / line.std)
    assert np.std(off) == pytest.approx(1.0, abs=0.25)


def test_an_event_says_that_its_speed_is_estimated() -> None:
    valve = find_valve("4weh10_stiff")
    orders = ((1.0, 2.0), (2.0, 6.0), (9.0, 2.0), (18.0, 2.0), (27.0, 2.0))
    shaking = MachineOrders(speed_profile=((0.0, 870.0),), orders=orders, broadband_rms=0.5)
    one = Replay(Estimator(settings_for(valve)), Monitor())
    one.monitor.detection.orders.components = PUMP
    # Cold oil damps the resonance for 12 s, 174 whole revolutions, then the valve has a thinner film.
    begin, number = 0, 0
    for viscosity in (0.5, 0.02):
        source = Simulator(valve.model_copy(update={"dynamic_viscosity": viscosity}), shaking, model="fluid")
        for block in source.records(12.0):
            begin = begin or block.stamp
            stamp = begin + round(number * block.sample_period * block.body.size * 1e9)
            one.update(Block(stamp, number, block.sample_period, block.body, block.spool))
            number += 1
    one.flush()
    raised = [one for one in one.events if one.kind == "resonance" and one.state is EventState.RAISED]
    assert headline(raised[-1]).startswith("Resonance (2nd order of the pump, 870 rev/min)")
    text = described(raised[-1])
    assert "Remark: speed estimated from harmonics" in text
    assert "confidence of the speed 0.99" in text


def test_a_tracker_names_the_component_of_a_line_without_a_speed() -> None:
    body = np.tile(shaken(870.0, 1, 2, 9, 18, 27), 2).astype(np.float32)
    tracker = OrderTracker(PUMP)
    tracker.restart(PERIOD)
    for first in range(0, SAMPLES, 40):
        stamp = 10**9 + round(first * PERIOD * 1e9)
        tracker.take(Block(stamp, first // 40, PERIOD, body[first : first + 40], body[first : first + 40]))
        if first == SAMPLES // 2:
            assert tracker.named(29.0, stamp) == (None, "")  # not seen for long enough
    found, remark = tracker.named(29.0, stamp + 20_000_000)
    assert remark == "speed_estimated"
    assert found is not None
    assert (found.order, found.component) == (2.0, "pump")
    assert found.rpm == pytest.approx(870.0, rel=1e-4)
    assert found.confidence is not None
    assert tracker.named(61.0, stamp + 20_000_000) == (None, "")  # another vibration
