"""Rates from stamps that are coarse, jitter, burst or are lost: right within the deviation, or none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.numbers import Array
from spool_core.stamps import Rhythm, Stamps, judge, judge_stamps, repeated, round_period, ticks

#: Standard deviations within which a rate has to be. No stamps show a loss within a step of several samples.
SIGMAS = 4.0


def taken(rate: float, count: int, lost: list[int], start: float) -> Array:
    """Return the true times (s) of ``count`` samples, those numbered ``lost`` left out."""
    return start + np.delete(np.arange(count), lost) / rate


def right(found: Stamps, rate: float, hidden: float = 0.0) -> bool:
    """Return whether a rate is unknown, or right within its deviation and the share ``hidden`` of losses."""
    if found.rhythm is Rhythm.UNEVEN:
        return math.isnan(found.rate)
    allowed = hidden + max(SIGMAS * found.rate_std, 2e-6)
    return abs(found.rate / rate - 1.0) <= allowed or (
        found.literal is not None and abs(found.literal.rate / rate - 1.0) <= allowed
    )


@st.composite
def clocks(draw: st.DrawFn) -> tuple[float, int, float]:
    """Draw a rate (Hz), whole or not, a number of samples and a start (s), from power-on or of today."""
    rate = draw(st.one_of(st.integers(100, 6000).map(float), st.floats(100.0, 6000.0)))
    start = draw(st.sampled_from((0.0, 13.7, 1_767_225_600.25)))
    return rate, draw(st.integers(200, 9000)), start


def check(examples: int, body: object) -> None:
    settings(max_examples=examples, deadline=None)(body)()  # type: ignore[operator]


MANY = pytest.mark.parametrize("examples", [50, pytest.param(5000, marks=pytest.mark.slow)])


@pytest.mark.fuzz
@MANY
def test_a_rounded_clock_shows_its_rate_or_none(examples: int) -> None:
    @given(clocks(), st.integers(0, 6), st.booleans(), st.integers(0, 3), st.integers(0, 2**32))
    def rounded(clock: tuple[float, int, float], digits: int, floors: bool, losses: int, seed: int) -> None:
        rate, count, start = clock
        lost = sorted(set(np.random.default_rng(seed).integers(5, count - 5, losses).tolist()))
        true = taken(rate, count, lost, start)
        tick = 10.0**-digits
        stamps = np.round((np.floor if floors else np.rint)(true / tick) * tick, 9)
        found = judge(stamps)
        assert right(found, rate, len(lost) / count if tick > 1.0 / rate else 0.0)
        assert found.lost <= true.size
        if found.times is not None and not lost:
            assert float(np.ptp(found.times - true)) <= 2.0 * SIGMAS * found.rate_std * count / rate + 1e-6

    check(examples, rounded)


@pytest.mark.fuzz
@MANY
def test_bursts_are_never_a_high_rate_with_gaps(examples: int) -> None:
    @given(
        clocks(),
        st.integers(2, 40),
        st.sampled_from((0.0, 1e-3, 0.1, 0.5)),
        st.floats(0.0, 0.3),
        st.integers(0, 2**32),
    )
    def bursts(clock: tuple[float, int, float], size: int, spacing: float, jitter: float, seed: int) -> None:
        rate, count, start = clock
        true = taken(rate, count, [], start)
        reads = true[np.minimum((np.arange(count) // size + 1) * size - 1, count - 1)]
        late = np.abs(np.random.default_rng(seed).normal(0.0, jitter / rate, count // size + 1))
        stamps = reads + late[np.arange(count) // size] + np.arange(count) % size * spacing / rate
        found = judge(stamps)
        assert found.lost <= count
        if count > 20 * size:
            assert found.rhythm is Rhythm.UNEVEN or abs(found.rate / rate - 1.0) <= max(
                SIGMAS * found.rate_std, 2e-6
            )

    check(examples, bursts)


@pytest.mark.fuzz
@MANY
def test_jitter_and_losses_leave_the_rate_right(examples: int) -> None:
    @given(clocks(), st.floats(0.0, 0.45), st.integers(0, 60), st.integers(0, 2**32))
    def jittering(clock: tuple[float, int, float], jitter: float, block: int, seed: int) -> None:
        rate, count, start = clock
        noise = np.random.default_rng(seed)
        first = int(noise.integers(60, count - 60))
        true = taken(rate, count, list(range(first, min(first + block, count - 60))), start)
        found = judge(true + noise.normal(0.0, jitter / rate, true.size))
        assert right(found, rate)
        assert found.lost <= true.size

    check(examples, jittering)


@pytest.mark.fuzz
@MANY
def test_times_that_no_clock_makes_have_no_rate(examples: int) -> None:
    @given(st.integers(300, 5000), st.floats(0.35, 0.95), st.integers(0, 2**32))
    def irregular(count: int, spread: float, seed: int) -> None:
        steps = np.random.default_rng(seed).uniform(1.0 - spread, 1.0 + spread, count) / 1000.0
        assert judge(np.cumsum(steps)).rhythm is Rhythm.UNEVEN

    check(examples, irregular)


@pytest.mark.parametrize("rate", [667.0, 700.0, 800.0, 833.0, 952.0, 990.0])
def test_milliseconds_show_rates_near_a_kilohertz_without_gaps(rate: float) -> None:
    found = judge(np.floor(np.arange(8000) / rate * 1e3) / 1e3)
    assert (found.rhythm, found.lost) == (Rhythm.COARSE, 0)
    assert found.rate == pytest.approx(rate, rel=1e-12)


def test_whole_seconds_since_1970_show_two_kilohertz() -> None:
    found = judge(np.floor(1_767_225_600.3 + np.arange(40000) / 2000.0))
    assert (found.rhythm, found.rate) == (Rhythm.COARSE, 2000.0)
    assert 1e-5 < found.rate_std < 5e-5  # one sample of 40,000


@pytest.mark.parametrize("decimals", [4, 5, 6])
@pytest.mark.parametrize("rate", [800.123, 1017.3, 2001.7])
@pytest.mark.parametrize("count", [300, 2000])
def test_printed_times_leave_the_rate_no_less_certain_than_one_digit_over_their_length(
    decimals: int, rate: float, count: int
) -> None:
    found = judge(np.round(np.arange(count) / rate, decimals))
    assert found.rhythm is Rhythm.EVEN
    assert right(found, rate)
    assert 0.0 < found.rate_std <= 10.0**-decimals * rate / count


def test_two_whole_seconds_show_no_rate() -> None:
    assert judge(np.floor(1_767_225_600.3 + np.arange(4000) / 2000.0)).rhythm is Rhythm.UNEVEN


def test_samples_lost_behind_coarse_stamps_are_found_where_ticks_are_shorter_than_periods() -> None:
    true = taken(800.0, 8000, [100, 3000, 3001, 3002, 7000], 0.0)
    found = judge(np.round(true, 3))
    assert (found.rate, found.lost, found.gaps.tolist()) == (800.0, 5, [100, 2999, 6996])
    assert found.times is not None
    assert float(np.ptp(found.times - true)) < 1e-9


def test_one_double_step_in_milliseconds_makes_the_rate_uncertain() -> None:
    found = judge(np.delete(np.arange(8001), 4000) / 1000.0)
    assert (found.rhythm, found.rate, found.lost) == (Rhythm.EVEN, 1000.0, 1)
    assert found.rate_std == pytest.approx(0.5 / 7999)  # or 999.9 Hz, and nothing lost


def test_recordings_with_pauses_between_them_lose_nothing() -> None:
    found = judge(np.concatenate([start + np.arange(4000) / 2000.0 for start in (0.0, 600.0, 1300.0)]))
    assert (found.rhythm, found.rate, found.lost, found.gaps.tolist()) == (
        Rhythm.EVEN,
        2000.0,
        0,
        [4000, 8000],
    )


def test_integer_stamps_are_judged_alike() -> None:
    stamps = 1_767_225_600_000_000_000 + (np.arange(3200) * 1_250_000) // 1_000_000 * 1_000_000
    found = judge_stamps(stamps)
    assert (found.rhythm, found.rate) == (Rhythm.COARSE, 800.0)


def test_the_resolution_changes_with_the_digits() -> None:
    printed = np.array([float(f"{value:g}") for value in 99.2 + np.arange(3200) / 2000.0])
    tick = ticks(printed, 1e-12)
    assert tick[[0, -1]] == pytest.approx([5e-4, 1e-3])
    assert judge(printed).rate == 2000.0


def test_a_round_rate_is_chosen_only_within_the_range() -> None:
    assert round_period(0.9999e-3, 1.00005e-3) == 1e-3
    assert round_period(1.0 / 801.39, 1.0 / 801.31) == pytest.approx(1.0 / 801.35, rel=1e-7)


ROWS = tuple(np.random.default_rng(3).normal(size=(2, 3000)))


@pytest.mark.parametrize("times", [2, 3])
def test_rows_that_are_there_several_times_are_repeats(times: int) -> None:
    marked, sure = repeated(np.repeat(np.arange(3000) / 2000.0, times), [row.repeat(times) for row in ROWS])
    assert sure
    np.testing.assert_array_equal(~marked, np.arange(3000 * times) % times == 0)


def test_equal_values_of_a_coarse_clock_are_no_repeats() -> None:
    rough = [np.round(row) for row in ROWS]  # some pairs are equal by chance
    marked, _ = repeated(np.floor(np.arange(3000) / 3.0) / 1000.0, rough)
    assert not marked.any()


def test_repeats_that_chance_could_make_are_not_sure() -> None:
    rough = [np.round(row) for row in ROWS]
    order = np.sort(np.concatenate([np.arange(3000), np.arange(0, 3000, 3)]))
    stamps = (np.floor(np.arange(3000) / 2.0) / 1000.0)[order]
    assert not repeated(stamps, [row[order] for row in rough])[1]


def test_a_repeat_in_one_channel_alone_is_none() -> None:
    stamps = np.floor(np.arange(3000) / 2.0) / 1000.0
    body = ROWS[0].copy()
    body[1::2] = body[::2]
    assert not repeated(stamps, [body, ROWS[1]])[0].any()
