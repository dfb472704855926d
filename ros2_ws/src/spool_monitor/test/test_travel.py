from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from spool_core.block import Block
from spool_core.kernels.compiled import COMPILED
from spool_monitor.trend_writer import TravelCounter, count_travel, integration_law

RATE = 2000.0
NOTHING = np.zeros(40, np.float32)


def blocks(relative: NDArray[np.float64], *, first: int = 1_000_000_000) -> list[Block]:
    """Return blocks of 40 samples of a body at rest and a spool that accelerates by ``relative``."""
    made = []
    for number, start in enumerate(range(0, relative.size - 39, 40)):
        spool = relative[start : start + 40].astype(np.float32)
        made.append(Block(first + number * 20_000_000, number, 1.0 / RATE, NOTHING, spool))
    return made


def counted(relative: NDArray[np.float64]) -> TravelCounter:
    counter = TravelCounter()
    for block in blocks(relative):
        counter.update(block)
    return counter


def sine(frequency: float, amplitude: float, seconds: float) -> NDArray[np.float64]:
    """Return the acceleration of a displacement of ``amplitude`` m."""
    at = np.arange(round(seconds * RATE)) / RATE
    return -amplitude * (2 * math.pi * frequency) ** 2 * np.sin(2 * math.pi * frequency * at)


@pytest.mark.parametrize(("frequency", "allowed"), [(8.0, 0.035), (15.0, 0.01), (29.0, 0.01), (100.0, 0.01)])
def test_a_sine_travels_four_amplitudes_and_turns_twice_a_period(frequency: float, allowed: float) -> None:
    amplitude, seconds = 0.3e-3, 10.0
    counter = counted(sine(frequency, amplitude, seconds))
    lasting = seconds - 0.5
    assert counter.travel == pytest.approx(
        4 * amplitude * frequency * lasting, rel=allowed + 1 / frequency / 5
    )
    assert counter.reversals == pytest.approx(2 * frequency * lasting, abs=3)


def test_sensor_noise_does_not_travel() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.05 * math.sqrt(2.0), round(120 * RATE))
    counter = counted(noise)
    assert (counter.travel, counter.reversals) == (0.0, 0)


def test_a_sensor_offset_does_not_travel() -> None:
    counter = counted(np.full(round(20 * RATE), 2.0))
    assert (counter.travel, counter.reversals) == (0.0, 0)


def test_a_gap_adds_nothing() -> None:
    motion = sine(15.0, 0.3e-3, 4.0)
    counter = TravelCounter()
    for block in blocks(motion):
        counter.update(block)
    before = counter.travel
    after = blocks(motion[: round(0.5 * RATE)], first=10_000_000_000)
    for block in after:
        counter.update(block)
    assert counter.travel == before


def test_the_split_into_blocks_does_not_matter() -> None:
    motion = sine(15.0, 0.3e-3, 2.0)
    whole = TravelCounter()
    whole.update(Block(1, 0, 1.0 / RATE, np.zeros(motion.size, np.float32), motion.astype(np.float32)))
    assert whole.travel == counted(motion).travel > 0.0


def slow_count(
    relative: NDArray[np.float64], law: NDArray[np.float64], threshold: float
) -> tuple[float, int]:
    """Return way and turns by the definition: list the displacement, then walk from turn to turn."""
    step, excitation = np.array([[law[0], law[1]], [law[2], law[3]]]), np.array([law[4], law[5]])
    state, way = np.zeros(2), [0.0]
    for driving in relative:
        state = step @ state + excitation * driving
        way.append(float(state[0]))
    turns = [way[0]]
    extreme, direction = way[0], 0
    for place in way[1:]:
        if direction == 0:
            if abs(place - turns[0]) > threshold:
                direction, extreme = (1 if place > turns[0] else -1), place
        elif (place - extreme) * direction > 0:
            extreme = place
        elif (extreme - place) * direction > threshold:
            turns.append(extreme)
            extreme, direction = place, -direction
    return sum(abs(b - a) for a, b in itertools.pairwise(turns)), len(turns) - 1


@pytest.mark.parametrize("seed", range(5))
def test_the_kernel_is_the_slow_count(seed: int) -> None:
    random = np.random.default_rng(seed)
    relative = random.normal(0.0, 20.0, 4000).astype(np.float32).astype(np.float64)
    law = integration_law(1.0 / RATE)
    state = np.zeros(8)
    body = np.zeros(relative.size, np.float32)
    kernel = getattr(count_travel, "py_func", count_travel)
    for function in (count_travel, kernel) if COMPILED else (kernel,):
        state[:] = 0.0
        function(body, relative.astype(np.float32), law, 2.0e-5, state)
        expected_way, expected_turns = slow_count(relative, law, 2.0e-5)
        assert expected_turns > 3
        assert state[6] == expected_turns
        assert state[5] == pytest.approx(expected_way, rel=1e-9)


def test_the_step_solves_the_equation_of_motion() -> None:
    """A held acceleration settles at a / w^2, as the differential equation says."""
    law = integration_law(1.0 / RATE)
    state = np.zeros(2)
    for _ in range(20000):
        state = np.array(
            [law[0] * state[0] + law[1] * state[1] + law[4], law[2] * state[0] + law[3] * state[1] + law[5]]
        )
    assert state == pytest.approx([1.0 / (8.0 * math.pi) ** 2, 0.0], abs=1e-12)
