"""Strokes: how they are recognised, the gap around them, and their times."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.kernels.strokes import Kept, Stroke, StrokeWatch
from spool_core.numbers import Array

PERIOD, NATURAL, START = 5e-4, 15.0, 1_577_836_800_000_000_000


def shaken(seconds: float, hertz: float = 24.0) -> tuple[Array, Array]:
    """Return a shaken body and the spool of a valve of 15 Hz that follows it, m/s^2."""
    t = np.arange(round(seconds / PERIOD)) * PERIOD
    turn = 2.0 * math.pi * hertz
    natural = 2.0 * math.pi * NATURAL
    follows = complex(natural**2, turn * 0.5 * natural)
    wave = 5.0 * np.exp(1j * turn * t)
    return wave.imag, (follows / (follows - turn**2) * wave).imag


def pushed(spool: Array, at: float, acceleration: float, seconds: float) -> None:
    """Push the spool by so much, then stop it by as much."""
    first, count = round(at / PERIOD), round(seconds / PERIOD)
    spool[first : first + count] += acceleration
    spool[first + count : first + count + 4] -= acceleration * count / 4.0


def watched(
    body: Array, spool: Array, sizes: int = 40, commands: tuple[tuple[float, float], ...] = ()
) -> tuple[list[Kept], list[Stroke], StrokeWatch]:
    watch, kept, strokes, left = StrokeWatch(), [], [], list(commands)
    for first in range(0, body.size, sizes):
        block = Block(
            START + round(first * PERIOD * 1e9), first // sizes, PERIOD,
            body[first : first + sizes].astype(np.float32), spool[first : first + sizes].astype(np.float32),
        )  # fmt: skip
        while left and START + left[0][0] * 1e9 < block.end:
            watch.take_command(START + round(left[0][0] * 1e9), left.pop(0)[1])
        kept += watch.kept(block, block, NATURAL, restarts=first == 0)
        strokes += watch.strokes
    return kept, strokes, watch


def left_out(kept: list[Kept]) -> list[tuple[float, float]]:
    """Return beginning and length (s) of the gaps."""
    return [
        ((one[0].end - START) * 1e-9, (other[0].stamp - one[0].end) * 1e-9)
        for one, other in pairwise(kept)
        if other[0].stamp - one[0].end > 1000
    ]


def test_vibration_alone_is_judged_whole_at_every_frequency() -> None:
    for hertz in (5.0, 15.0, 24.0, 80.0):
        kept, strokes, watch = watched(*shaken(3.0, hertz))
        assert not strokes
        assert watch.share == 1.0
        assert all(one[1] is None for one in kept)


def test_a_stroke_is_left_out_from_its_beginning_until_the_spool_moves_again() -> None:
    body, spool = shaken(4.0)
    pushed(spool, 2.0, 60.0, 0.01)
    kept, strokes, watch = watched(body, spool)
    assert len(strokes) == 1
    ((begin, length),) = left_out(kept)
    assert 2.0 <= begin < 2.008
    assert 0.4 < length < 0.8
    assert [one[1] for one in kept if one[1]] == [pytest.approx(length * 1e9, abs=1e3)]
    assert watch.share == pytest.approx(1.0 - length / 4.0, abs=1e-3)
    assert watch.count == 1


def test_a_spool_that_stays_at_its_stop_is_left_out_until_it_is_back() -> None:
    body, spool = shaken(8.0)
    pushed(spool, 2.0, 60.0, 0.01)
    spool[round(2.012 / PERIOD) : round(5.0 / PERIOD)] = body[round(2.012 / PERIOD) : round(5.0 / PERIOD)]
    pushed(spool, 5.0, -60.0, 0.01)
    kept, strokes, _ = watched(body, spool)
    assert [(one.out, one.side) for one in strokes] == [(True, 1), (False, -1)]
    ((_, length),) = left_out(kept)
    assert 3.4 < length < 3.9


def test_the_travel_time_is_that_of_the_push() -> None:
    body, spool = shaken(4.0)
    pushed(spool, 2.0, 60.0, 0.01)
    slower = spool.copy()
    pushed(slower, 3.0, 40.0, 0.02)
    _, strokes, _ = watched(body, slower)
    assert [one.travel_time for one in strokes] == [
        pytest.approx(0.010, abs=0.002), pytest.approx(0.020, abs=0.002)
    ]  # fmt: skip


def test_what_lasts_longer_than_a_stroke_is_believed() -> None:
    """A channel that reads five times as much from one sample on is a fault of a sensor."""
    body, spool = shaken(8.0)
    spool[round(2.0 / PERIOD) :] *= 5.0
    kept, _, watch = watched(body, spool)
    assert sum(length for _, length in left_out(kept)) < 2.0
    assert not watch.away


def test_a_machine_that_starts_is_no_stroke() -> None:
    body, spool = shaken(4.0)
    rises = np.clip(np.arange(body.size) * PERIOD - 2.0, 0.0, 0.2) / 0.2
    body, spool = body * rises, spool * rises
    _, strokes, _ = watched(body, spool)
    assert not strokes


@pytest.mark.parametrize("size", [7, 200, 2000])
def test_how_the_stream_is_split_changes_nothing(size: int) -> None:
    body, spool = shaken(9.0)
    for at in (2.0, 4.0, 6.0):
        pushed(spool, at, 60.0, 0.01)
    kept, strokes, _ = watched(body, spool)
    other_kept, other_strokes, _ = watched(body, spool, size)
    assert left_out(other_kept) == left_out(kept)
    assert [replace_stamp(one) for one in other_strokes] == [replace_stamp(one) for one in strokes]
    assert len(strokes) == 3


def replace_stamp(stroke: Stroke) -> Stroke:
    """Return ``stroke`` rounded to a microsecond."""
    return stroke._replace(stamp=round(stroke.stamp, -3), travel_time=round(stroke.travel_time, 9), delay=0.0)


def test_while_a_command_lasts_nothing_is_judged_and_the_stroke_has_a_delay() -> None:
    body, spool = shaken(6.0)
    pushed(spool, 2.03, 60.0, 0.01)
    kept, strokes, _ = watched(body, spool, commands=((0.0, 0.0), (2.0, 24.0), (4.0, 0.0)))
    assert [one.delay for one in strokes] == [pytest.approx(0.03, abs=0.003)]
    ((begin, length),) = left_out(kept)
    assert begin == pytest.approx(2.0)
    assert length == pytest.approx(2.4, abs=0.01)


def test_a_command_ends_what_is_left_out_also_where_the_spool_sticks() -> None:
    """Otherwise a spool that does not come back would never be reported as stuck."""
    body, spool = shaken(6.0)
    pushed(spool, 2.0, 60.0, 0.01)
    spool[round(2.012 / PERIOD) :] = body[round(2.012 / PERIOD) :]
    _, _, unknown = watched(body, spool)
    _, _, known = watched(body, spool, commands=((0.0, 0.0), (2.0, 1.0), (3.0, 0.0)))
    assert unknown.away
    assert not known.away


def test_counts_begin_again_with_the_day() -> None:
    watch = StrokeWatch()
    body, spool = shaken(4.0)
    pushed(spool, 2.0, 60.0, 0.01)
    block = Block(START, 0, PERIOD, body.astype(np.float32), spool.astype(np.float32))
    watch.kept(block, block, NATURAL, restarts=True)
    assert watch.count == 1
    still = replace(block, stamp=START + 86_400_000_000_000, spool=shaken(4.0)[1].astype(np.float32))
    watch.kept(still, still, NATURAL, restarts=True)
    assert (watch.count, watch.share) == (0, 1.0)
