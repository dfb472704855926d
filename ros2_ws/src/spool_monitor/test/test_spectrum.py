from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.block import Block
from spool_core.numbers import Array
from spool_monitor.window import BAND, Line, WindowTracker, find_line, strongest

START = 1_700_000_000_000_000_000
RATES = (1000.0, 2000.0, 10000.0)


def sine(frequency: float, amplitude: float, phase: float, seconds: float, rate: float) -> Array:
    time = np.arange(round(seconds * rate)) / rate
    return amplitude * np.sin(2.0 * math.pi * frequency * time + phase)


def track(body: Array, spool: Array, rate: float, cuts: tuple[int, ...] = ()) -> list[Line]:
    """Feed one record, cut before the samples ``cuts``."""
    return [line for line in looks(body, spool, rate, cuts) if line is not None]


def looks(body: Array, spool: Array, rate: float, cuts: tuple[int, ...] = ()) -> list[Line | None]:
    tracker = WindowTracker()
    tracker.restart(1.0 / rate)
    lines = []
    edges = [0, *sorted(cuts), body.size]
    for number, (begin, end) in enumerate(pairwise(edges)):
        if end > begin:
            stamp = START + round(begin / rate * 1e9)
            parts = (signal[begin:end].astype(np.float32) for signal in (body, spool))
            lines += map(find_line, tracker.update(Block(stamp, number, 1.0 / rate, *parts)))
    return lines


@pytest.mark.parametrize("rate", RATES)
@settings(max_examples=40, deadline=None)
@given(
    frequency=st.floats(5.0, 245.0),
    phase=st.floats(0.0, 2.0 * math.pi),
    lag=st.floats(0.0, 2.0 * math.pi),
    body=st.floats(0.01, 500.0),
    amplification=st.floats(0.05, 20.0),
)
def test_a_sine_is_found_with_frequency_and_amplitudes(
    rate: float, frequency: float, phase: float, lag: float, body: float, amplification: float
) -> None:
    shaken = sine(frequency, body, phase, 1.0, rate)
    answer = sine(frequency, amplification * body, phase - lag, 1.0, rate)
    (line,) = track(shaken, answer, rate)
    # 5 Hz is the fifth bin: its mirror at -5 Hz adds its side lobes.
    assert line.frequency == pytest.approx(frequency, abs=0.02)
    assert line.body == pytest.approx(body, rel=0.01)
    assert line.spool == pytest.approx(amplification * body, rel=0.01)
    assert line.amplification == pytest.approx(amplification, rel=0.01)
    assert line.share > 0.99


@pytest.mark.parametrize("rate", RATES)
def test_what_the_spool_makes_of_whole_periods_is_exact(rate: float) -> None:
    """Amplitudes 8 and 20 m/s^2, a quarter of a period apart: the difference is their hypotenuse."""
    line = track(sine(20.0, 8.0, 0.4, 1.0, rate), sine(20.0, 20.0, 0.4 - 0.5 * math.pi, 1.0, rate), rate)[0]
    assert line.frequency == pytest.approx(20.0, abs=2e-3)
    assert line.amplification == pytest.approx(2.5, rel=1e-5)
    moved = math.hypot(8.0, 20.0) / (2.0 * math.pi * 20.0) ** 2
    assert line.relative_displacement == pytest.approx(moved, rel=3e-4)


def test_a_spool_that_moves_with_the_body_does_not_move_in_it() -> None:
    shaken = sine(33.3, 5.0, 1.0, 1.0, 2000.0)
    (line,) = track(shaken, shaken, 2000.0)
    assert line.amplification == 1.0
    assert line.relative_displacement == 0.0


def test_the_stronger_of_two_lines_counts_whatever_the_spool_does() -> None:
    body = sine(20.0, 2.0, 0.3, 1.0, 2000.0) + sine(60.0, 3.0, 1.3, 1.0, 2000.0)
    spool = sine(20.0, 50.0, 0.3, 1.0, 2000.0) + sine(60.0, 1.5, 1.3, 1.0, 2000.0)
    (line,) = track(body, spool, 2000.0)
    assert line.frequency == pytest.approx(60.0, abs=2e-3)
    assert line.amplification == pytest.approx(0.5, rel=1e-3)
    assert line.share == pytest.approx(9.0 / 13.0, rel=1e-3)


def test_a_tie_goes_to_one_of_both_lines_and_never_between_them() -> None:
    body = sine(20.0, 3.0, 0.0, 2.0, 2000.0) + sine(60.0, 3.0, 0.0, 2.0, 2000.0)
    lines = track(body, body, 2000.0)
    assert lines
    for line in lines:
        assert min(abs(line.frequency - 20.0), abs(line.frequency - 60.0)) < 5e-3
        assert line.share == pytest.approx(0.5, abs=1e-3)


@settings(max_examples=30, deadline=None)
@given(cuts=st.lists(st.integers(1, 4999), max_size=60).map(tuple), seed=st.integers(0, 2**16))
def test_how_the_stream_is_split_changes_nothing(cuts: tuple[int, ...], seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal((2, 5000))
    body = sine(17.0, 4.0, 0.0, 2.5, 2000.0) + noise[0]
    spool = sine(17.0, 9.0, 1.0, 2.5, 2000.0) + noise[1]
    whole, split = track(body, spool, 2000.0), track(body, spool, 2000.0, cuts)
    assert len(whole) == len(split) == 7
    for one, other in zip(whole, split, strict=True):
        assert (one.frequency, one.body, one.spool, one.share) == (
            other.frequency,
            other.body,
            other.spool,
            other.share,
        )
        assert abs(one.stamp - other.stamp) <= 2


def test_lines_fall_due_every_hop_and_are_stamped_with_the_newest_sample() -> None:
    lines = track(sine(20.0, 1.0, 0.0, 3.0, 1000.0), np.zeros(3000), 1000.0)
    assert [line.stamp - START for line in lines] == [
        round((1.0 + 0.25 * number - 0.001) * 1e9) for number in range(9)
    ]


@pytest.mark.parametrize("level", [0.0, 9.75, 9.81])
def test_silence_has_no_line_until_something_shakes_again(level: float) -> None:
    rest, shaking = np.full(2000, level), level + sine(20.0, 1.0, 0.0, 1.0, 1000.0)
    record = np.concatenate([rest, shaking])
    seen = looks(record, record, 1000.0)
    assert [line is None for line in seen] == [True] * 5 + [False] * 4


@given(seed=st.integers(0, 2**16), low=st.integers(2, 60), width=st.integers(1, 40))
@settings(max_examples=50, deadline=None)
def test_the_kernel_finds_what_numpy_finds(seed: int, low: int, width: int) -> None:
    parts = np.random.default_rng(seed).standard_normal((2, 2, 110))
    spectrum = parts[0] + 1j * parts[1]
    body, spool = spectrum
    power = np.abs(body) ** 2
    peak = low + int(power[low : low + width + 1].argmax())
    around = slice(peak - 2, peak + 3)
    place = float(np.average(np.arange(peak - 2, peak + 3), weights=power[around]))
    expected = (
        place,
        power[around].sum(),
        (np.abs(spool) ** 2)[around].sum(),
        (np.abs(spool - body) ** 2)[around].sum(),
        power[low - 2 : low + width + 3].sum(),
    )
    assert strongest(spectrum, low, low + width) == pytest.approx(expected, rel=1e-12)


def test_a_line_outside_the_band_is_not_looked_for() -> None:
    body = sine(2.0, 50.0, 0.0, 1.0, 2000.0) + sine(40.0, 1.0, 0.0, 1.0, 2000.0)
    body += sine(400.0, 50.0, 0.0, 1.0, 2000.0)
    (line,) = track(body, body, 2000.0)
    assert BAND[0] < line.frequency < BAND[1]
    assert line.frequency == pytest.approx(40.0, abs=0.01)


def test_a_rate_too_low_for_the_band_gives_no_line() -> None:
    body = sine(0.5, 5.0, 0.0, 40.0, 4.0)
    assert track(body, body, 4.0) == []
