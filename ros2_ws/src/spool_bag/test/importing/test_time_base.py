"""Time bases: gaps, repeated rows, coarse and jittering stamps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_bag.importing.time_base import time_base
from spool_core.errors import InputError

RNG = np.random.default_rng(5)
ROWS = (RNG.normal(size=8000), RNG.normal(size=8000))


def where(row: int) -> str:
    return f"line {row}"


def test_jittering_stamps_of_a_regular_clock_are_placed_on_its_line() -> None:
    true = np.arange(8000) / 1000.3
    found = time_base("x", "t", true + np.random.default_rng(1).normal(0.0, 2.5e-4, 8000), ROWS, where)
    assert found.period == pytest.approx(1.0 / 1000.3, rel=1e-6)
    assert float(np.abs(found.time - true).max()) < 2e-5
    assert found.repairs["jitter_placed_on_a_line"] == 8000
    assert not found.gaps.size


def test_lost_samples_are_found_behind_jitter() -> None:
    true = np.delete(np.arange(8005) / 1000.0, np.arange(3000, 3005))
    found = time_base("x", "t", true + np.random.default_rng(2).normal(0.0, 2.0e-4, 8000), ROWS, where)
    assert found.gaps.tolist() == [3000]
    assert float(np.abs(found.time - true).max()) < 5e-5


def test_samples_that_truly_come_at_irregular_times_are_refused() -> None:
    time = np.cumsum(np.random.default_rng(3).uniform(0.5e-3, 1.4e-3, 8000))
    with pytest.raises(InputError, match="sampling is irregular, a step of"):
        time_base("x", "t", time, ROWS, where)


def test_times_rounded_to_milliseconds_are_placed_on_a_line() -> None:
    true = np.arange(8000) / 2048.0
    found = time_base("x", "t", np.floor(true * 1e3) / 1e3, ROWS, where)
    assert found.period == pytest.approx(1.0 / 2048.0, rel=1e-4)
    assert float(np.abs(found.time - true).max()) < 1.1e-3


def test_rows_written_twice_are_left_out() -> None:
    order = np.sort(np.concatenate([np.arange(8000), [70, 4000, 4000]]))
    time = (np.arange(8000) / 2000.0)[order]
    found = time_base("x", "t", time, [row[order] for row in ROWS], where)
    assert found.repairs == {"repeated_rows": 3}
    assert found.kept is not None
    np.testing.assert_array_equal(time[found.kept], np.arange(8000) / 2000.0)


def test_a_clock_that_goes_back_and_exchanged_rows_are_refused_with_their_place() -> None:
    back, exchanged = (np.arange(8000) / 2000.0 for _ in range(2))
    back[5000:] -= 1.0
    exchanged[[4000, 4001]] = exchanged[[4001, 4000]]
    for time, line in ((back, 5000), (exchanged, 4001)):
        with pytest.raises(InputError, match=f"line {line}: t does not increase"):
            time_base("x", "t", time, ROWS, where)


MANY = pytest.mark.parametrize("examples", [25, pytest.param(2000, marks=pytest.mark.slow)])


def sweep(time: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return body and spool of a sweep from 5 to 25 Hz with sensor noise, m/s^2, at ``time`` (s)."""
    noise = np.random.default_rng(seed).normal(0.0, 0.05, (2, time.size))
    at = time - time[0]
    phase = 2.0 * np.pi * (5.0 * at + 10.0 * at * at / max(float(at[-1]), 1.0))
    return 8.0 * np.sin(phase) + noise[0], 3.0 * np.sin(phase - 0.8) + noise[1]


@pytest.mark.fuzz
@MANY
def test_a_record_is_right_or_refused_whatever_its_stamps(examples: int) -> None:
    @settings(max_examples=examples, deadline=None)
    @given(
        st.one_of(st.integers(200, 5000).map(float), st.floats(200.0, 5000.0)),
        st.integers(1000, 6000),
        st.sampled_from((0.0, 42.7, 1_767_225_600.4)),
        st.sampled_from((1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1.0)),
        st.sampled_from(("even", "bursts", "paused", "twice")),
        st.integers(2, 12),
        st.integers(0, 30),
        st.integers(0, 2**32),
    )
    def check(
        rate: float, count: int, begin: float, tick: float, kind: str, size: int, lost: int, seed: int
    ) -> None:
        first = count // 3
        if kind == "paused":  # recordings of half a second, 2 s apart
            stretch = max(100, round(0.5 * rate))
            numbers = np.arange(count) + np.arange(count) // stretch * round(2.0 * rate)
        else:
            numbers = np.delete(np.arange(count), slice(first, first + lost))
        true = begin + numbers / rate
        body, spool = sweep(true, seed)
        if kind == "twice":
            true, body, spool = (np.repeat(row, 2) for row in (true, body, spool))
        stamps = np.round(np.floor(true / tick) * tick, 7)
        if kind == "bursts":
            read = np.minimum((np.arange(true.size) // size + 1) * size - 1, true.size - 1)
            stamps = true[read] + np.arange(true.size) % size * 0.05 / rate
        try:
            found = time_base("x", "t", stamps, (body, spool), where)
        except InputError:
            return
        kept = true if found.kept is None else true[found.kept]
        assert found.kept is None or kind == "twice"
        hidden = lost / count if tick * rate > 1.0 or kind == "bursts" else 0.0
        allowed = hidden + max(4.0 * found.rate_std, 3e-6)
        assert abs(found.period * rate - 1.0) <= allowed
        late = found.time - found.time[0] - (kept - kept[0])
        assert float(np.ptp(late)) <= 2.0 * tick + 1.5 * size / rate + allowed * count / rate

    check()


def test_the_values_show_whether_bursts_were_pauses() -> None:
    inside = np.tile(np.arange(64), 60) / 25600.0
    paused = np.repeat(np.arange(60), 64) * 1.0 + inside
    found = time_base("x", "t", paused, sweep(paused, 1), where)
    assert found.period == pytest.approx(1.0 / 25600.0, rel=1e-6)
    assert found.gaps.size == 59
    read = np.repeat(np.arange(960), 4) * 2e-3 + np.tile(np.arange(4), 960) * 1e-4
    found = time_base("x", "t", read, sweep(np.arange(3840) / 2000.0, 1), where)
    assert (found.period, found.gaps.size) == (pytest.approx(5e-4, rel=1e-6), 0)
    with pytest.raises(
        InputError, match=r"bursts of 4 samples: type --rate 2000 if .* or --rate 10000 if it paused"
    ):
        time_base("x", "t", read, RNG.normal(size=(2, 3840)), where)


@pytest.mark.parametrize(("rate", "gaps"), [(2000.0, 0), (10000.0, 959)])
def test_a_given_rate_decides_between_bursts_and_pauses(rate: float, gaps: int) -> None:
    read = np.repeat(np.arange(960), 4) * 2e-3 + np.tile(np.arange(4), 960) * 1e-4
    found = time_base("x", "t", read, RNG.normal(size=(2, 3840)), where, rate)
    assert found.period == pytest.approx(1.0 / rate, rel=1e-6)
    assert found.gaps.size == gaps


def test_a_given_rate_decides_where_stamps_are_too_coarse_and_is_refused_where_they_contradict_it() -> None:
    stamps = np.floor(np.arange(4000) / 2000.0)
    rows = RNG.normal(size=(2, 4000))
    with pytest.raises(InputError, match="give the rate with --rate HZ"):
        time_base("x", "t", stamps, rows, where)
    assert time_base("x", "t", stamps, rows, where, 2000.0).period == 5e-4
    with pytest.raises(InputError, match=r"--rate 900: 4000 samples in 1 s of t do not fit it"):
        time_base("x", "t", stamps, rows, where, 900.0)


def test_repeats_that_may_be_chance_are_refused() -> None:
    order = np.sort(np.concatenate([np.arange(3000), np.arange(0, 3000, 3)]))
    stamps = (np.floor(np.arange(3000) / 2.0) / 1000.0)[order]
    rough = [np.round(row[:3000])[order] for row in ROWS]
    with pytest.raises(InputError, match="by repetition or by chance"):
        time_base("x", "t", stamps, rough, where)


@pytest.mark.parametrize("decimals", [0, 3])
def test_coarse_epochs_are_read_at_their_rate_with_its_deviation(decimals: int) -> None:
    rate = 2000.0 if decimals == 0 else 800.0
    true = 1_767_225_600.0 + np.arange(40000) / rate
    found = time_base(
        "x", "t", np.floor(true * 10**decimals) / 10**decimals, RNG.normal(size=(2, 40000)), where
    )
    assert found.period == 1.0 / rate
    assert found.rate_std < 5e-5
    assert not found.gaps.size


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    pauses=st.lists(st.floats(0.004, 20.0), min_size=0, max_size=4),
    glitch=st.floats(0.0, 0.45),
    noise=st.floats(0.0, 0.1),
    ppm=st.floats(-1000.0, 1000.0),
)
def test_a_given_rate_closes_no_pause(
    seed: int, pauses: list[float], glitch: float, noise: float, ppm: float
) -> None:
    numbers = np.random.default_rng(seed)
    steps = np.full(3999, 1e-3 * (1.0 + 1e-6 * ppm))
    for place, pause in zip(
        numbers.choice(np.arange(200, 3800), len(pauses), replace=False), pauses, strict=True
    ):
        steps[place] += pause
    steps[numbers.integers(100, 3900)] += 1e-3 * glitch
    stamps = np.concatenate([[0.0], np.cumsum(steps)]) + 1e-3 * noise * numbers.uniform(-1.0, 1.0, 4000)
    try:
        found = time_base("x", "t", stamps, numbers.normal(size=(2, 4000)), where, 1000.0)
    except InputError:
        return
    np.testing.assert_allclose(found.time, stamps, atol=2e-3)


def test_a_few_odd_steps_refuse_no_record() -> None:
    steps = np.full(3999, 1e-3)
    steps[[700, 701, 2500]] = [1.4e-3, 0.6e-3, 1.35e-3]
    stamps = np.concatenate([[0.0], np.cumsum(steps)])
    found = time_base("x", "t", stamps, RNG.normal(size=(2, 4000)), where)
    assert found.period == pytest.approx(1e-3, rel=1e-6)
    np.testing.assert_allclose(found.time, stamps, atol=0.5e-3)
