"""Stamps of a regular clock: sampling rate and its uncertainty, lost samples, rounding, bursts, repeats.

Records and live streams judge their stamps by these functions. They are pure: arrays in, a result out.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from spool_core.numbers import MEDIAN_TO_DEVIATION, Array

#: Periods: a longer step is a gap, one missing sample makes two; a sample further off its place is not
#: explained by the rounding of printed times.
GAP = 1.5
JITTER = 0.25
#: Correlation of a step with the next one below which stamps jitter about a regular clock: errors of stamps
#: give -1/2, samples that truly come at irregular times 0 (the first difference of white noise).
STAMP_NOISE = -0.3
#: Standard deviations of the steps that one of them may be off: beyond, rows were exchanged or a clock set.
JITTER_REACH = 6.0
#: Samples on each side of a long step by which a loss is separated from a late stamp.
BESIDE = 50
#: Relative error of a rate beyond which it is not known, or wrong: a stiffness goes with the square of time,
#: so that 0.25 % of the rate are 0.5 % of the stiffness.
LEAST_CERTAIN = 2.5e-3
#: Steps of two periods at equal distances that prove a coarse clock: that many random losses are as regular
#: in n!/n^n of all cases, 1.5 % for 6.
REGULAR_STEPS = 6
#: Share of steps of two periods beyond which fewer of them are ambiguous: lost samples or a coarse clock.
AMBIGUOUS_SHARE = 0.05
#: Bursts that show a rhythm, and how much longer the pauses between them are than the steps inside.
BURSTS, PAUSE = 8, 1.5
#: Batches of stamps whose means show whether a line holds everywhere, and how far off it (periods) they are.
BATCHES, OFF_LINE = 32, 0.75
#: s: a range this short holds a whole microsecond by chance in one of five cases.
ROUND_RANGE = 2e-7
#: Exceptions that separate a coarse clock that jitters beyond its resolution from random losses.
MANY_STEPS = 30
#: Stretches between gaps: samples and s from which they are recordings with pauses and no bursts; standard
#: deviation over mean below which they are alike, and above which gaps come at random (1 for random losses).
FEW, PAUSED, ALIKE, RANDOM = 100, 0.25, 0.5, 0.85
#: Stamps that are judged at least, and distinct stamps of a clock that counts in several samples: three
#: complete steps show whether they hold equally many.
FEWEST, FEWEST_STEPS = 3, 5
#: Share of the received samples beyond which short stretches were not cut by losses.
MOST_LOST = 0.5
#: Resolution, in periods, from which a clock that counts in whole periods hides what was lost.
HIDING = 0.4
#: Reason of stamps that go back further than jitter.
BACKWARDS = "stamps go back"
#: Samples of a burst, or of one step of a coarse clock, from which stamps are those of packets: two sensors
#: then belong together only where they share each packet's stamp. s of a packet that is no longer one.
PACKET, LEAST_PACKET = 2.0, 1e-4
_PIECE = 1 << 20
#: Stamps over which a resolution is looked for: it changes with the number of digits.
_LOCAL = 256

Indices = NDArray[np.int64]


class Rhythm(enum.Enum):
    """How regularly stamps follow each other; the value is the text people read."""

    EVEN = "even"  # each stamp is the time of its sample, to a quarter of a period
    COARSE = "coarse"  # a regular clock, rounded to a resolution that is no small share of the period
    BURSTS = "bursts"  # samples that share a stamp, or follow each other faster than they were sampled
    JITTER = "jitter"  # a regular clock, and stamps that are late by chance
    UNEVEN = "uneven"  # no regular clock explains them


@dataclass(frozen=True, slots=True)
class Stamps:
    """Result of judging stamps, one of each sample, in the order in which they were received.

    Attributes:
        rhythm: kind of the stamps.
        rate: Hz; NaN where no rate is known (``UNEVEN``).
        rate_std: relative standard deviation of ``rate``, from the stamps alone (the clock's own error is
            not in it).
        resolution: s, largest step in which the clock counts; 0 where it is below 1 ns.
        lost: samples that are missing in ``gaps``; never more than were received. A gap longer than
            everything received is a pause, and is not counted.
        gaps: index of each first sample after a gap, int64.
        times: s, shape (n,): times of the samples on the clock's line; ``None`` where the stamps themselves
            are the times (``EVEN``), or no clock is known (``UNEVEN``).
        deviation: s, rms of the stamps about ``times``.
        burst: samples that come together on average, 1 without bursts.
        literal: for ``BURSTS`` of distinct stamps, and ``UNEVEN`` with gaps, the same stamps with each taken
            as the time of its sample: between short stretches there were pauses. Stamps alone cannot
            exclude that; the values can (samples that follow each other at once differ less).
        reason: for ``UNEVEN``, what does not fit; ``at``: index of the first stamp that does not.
    """

    rhythm: Rhythm
    rate: float = math.nan
    rate_std: float = math.nan
    resolution: float = 0.0
    lost: int = 0
    gaps: Indices = field(default_factory=lambda: np.empty(0, np.int64))
    times: Array | None = None
    deviation: float = 0.0
    burst: float = 1.0
    literal: Stamps | None = None
    reason: str = ""
    at: int = 0

    @property
    def period(self) -> float:
        """Time between samples, s."""
        return 1.0 / self.rate


def judge_stamps(stamps: Indices) -> Stamps:
    """Return what integer stamps (ns, shape (n,)) show of their clock; ``times`` count from the first."""
    return judge((stamps - stamps[:1]).astype(np.float64) * 1e-9)


def judge(time: Array, noise: float | None = None) -> Stamps:
    """Return what stamps (s, shape (n,), n >= 3) show of their clock.

    Args:
        time: in the order in which the samples were received. Equal stamps are allowed.
        noise: s, error of the numbers themselves; default: that of float64 at the size of ``time``.
    """
    if time.size < FEWEST:
        return Stamps(Rhythm.UNEVEN, reason=f"{time.size} stamps show no rate")
    noise = number_error(time) if noise is None else noise
    backwards = first_step(time, lambda steps: steps < 0.0)
    equal = first_step(time, lambda steps: steps == 0.0)
    even = _even(time) if backwards is None and equal is None else None
    if even is not None and not even.gaps.size:
        return _refined(time, even, noise)
    together = (_coarse(time, noise, even) or _bursts(time, even)) if backwards is None else None
    if together is not None:
        return together
    if even is not None:
        even = _judged(time, even, noise)
        if even.rhythm is not Rhythm.UNEVEN:
            return even
    usual = median_step(time)
    if backwards is None or _back_by_jitter(time, usual):
        placed = _jittered(time, usual)
        if placed is not None and not (
            placed.lost and float(ticks(time, noise).max()) >= HIDING * placed.period
        ):
            return placed
    if backwards is not None:
        return Stamps(Rhythm.UNEVEN, reason=BACKWARDS, at=backwards + 1)
    return _uneven(time, usual) if even is None else even


def unpaired(names: tuple[str, str], found: tuple[Stamps, Stamps], stamps: tuple[Indices, Indices]) -> str:
    """Return why the stamps of two sensors do not show one time although each shows a clock; "" if they do.

    Args:
        names: of both sensors, for the text.
        found: what the stamps of each sensor show; ``UNEVEN`` ones are left out.
        stamps: ns, shape (n,) each, as they were judged.
    """
    packets = [
        one.burst
        if one.rhythm is Rhythm.BURSTS
        else one.resolution * one.rate
        if one.rhythm is Rhythm.COARSE
        else 0.0
        for one in found
    ]
    largest = max(packets)
    no_clock = any(one.rhythm is Rhythm.UNEVEN for one in found)
    if no_clock or largest / max(one.rate for one in found) < LEAST_PACKET:
        return ""
    advice = "let the driver stamp each sample, or read both sensors in one packet"
    first, second = found
    if first.rhythm is not second.rhythm:
        at = packets.index(largest)
        what = f"stamps of {names[at]} have steps of {found[at].resolution:g} s"
        if found[at].rhythm is Rhythm.BURSTS:
            what = f"samples of {names[at]} come in bursts of {found[at].burst:.3g}"
        return f"{what}, those of {names[1 - at]} do not: {advice}"
    if largest > PACKET or first.rhythm is Rhythm.BURSTS:
        begin = max(int(one[0]) for one in stamps)
        end = min(int(one[-1]) for one in stamps)
        inside = [one[(one >= begin) & (one <= end)] for one in stamps]
        if inside[0].size < PACKET or not np.array_equal(inside[0], inside[1]):
            size = f"{largest:.3g} samples"
            return (
                f"stamps of {names[0]} and {names[1]} are those of packets of {size}, which differ: {advice}"
            )
    if first.resolution != second.resolution:
        steps = f"{first.resolution:g} and {second.resolution:g} s"
        return f"stamps of {names[0]} and {names[1]} have steps of {steps}: {advice}"
    return ""


def repeated(time: Array, rows: Sequence[NDArray[np.floating]]) -> tuple[NDArray[np.bool_], bool]:
    """Return which samples repeat the one before, stamp and all values, and whether that is sure.

    A coarse clock gives equal stamps, and coarse values are equal now and then: such pairs are no repeats.
    Pairs of equal stamps hold repeats where more of them have equal values than pairs of different stamps
    do. It is not sure where chance alone makes one such pair or more: leaving it out would shift the rest.

    Args:
        time: stamps, shape (n,).
        rows: values of all channels that were stamped together, each of shape (n,); none: nothing repeats.
    """
    same = np.diff(time) == 0.0
    marked = np.zeros(time.size, dtype=np.bool_)
    if len(rows) == 0 or not same.any():
        return marked, True
    equal = np.ones(same.size, dtype=np.bool_)
    for row in rows:
        equal &= row[1:] == row[:-1]
    both, others = int(np.count_nonzero(same & equal)), int(np.count_nonzero(~same))
    seen, pairs = int(np.count_nonzero(equal & ~same)), int(np.count_nonzero(same))
    # With half an equal pair added: that none was seen does not exclude chance.
    expected = (seen + 0.5) / (others + 1) * pairs
    if both <= expected + 4.0 * math.sqrt(expected):  # 4 standard deviations of a Poisson number
        return marked, True
    marked[1:] = same & equal
    return marked, seen * pairs < max(others, 1)


def rate_range(numbers: Array, low: Array, high: Array) -> tuple[float, float] | None:
    """Return the shortest and longest period of the lines that pass through all intervals.

    Sample ``numbers[i]`` (increasing) was taken between ``low[i]`` and ``high[i]`` (s); shape (n,) each.
    ``None`` where no line does. The condition max(low - b x) <= min(high - b x) is convex in the period b, so
    that Newton's method from outside finds both ends of it without passing them.
    """
    x = numbers - numbers[0]
    span, rounding = float(x[-1]), 1e-7 * float(np.min(high - low))
    ends: list[float] = []
    for begin in (float(low[-1] - high[0]) / span, float(high[-1] - low[0]) / span):
        period, outside = begin, 1.0 if not ends else -1.0
        for _ in range(60):
            first, second = low - period * x, high - period * x
            above, below = int(np.argmax(first)), int(np.argmin(second))
            excess = float(first[above] - second[below])
            if excess <= rounding:
                break
            slope = float(x[below] - x[above])
            if slope * outside >= 0.0:
                return None
            period -= excess / slope
        else:
            return None
        ends.append(period)
    return (ends[0], ends[1]) if ends[0] <= ends[1] else None


def round_period(low: float, high: float) -> float:
    """Return the period (s) from ``low`` to ``high`` that a clock was set to: the roundest, or the middle.

    The roundest rate in whole Hz comes first, then a period in whole microseconds where chance would hardly
    give one.
    """
    mean = 0.5 * (low + high)
    for digits in (-3, -2, -1, 0):
        rate = round(1.0 / mean, digits)
        if rate > 0.0 and low <= 1.0 / rate <= high:
            return 1.0 / rate
    rounded = round(mean * 1e6) / 1e6
    return rounded if rounded > 0.0 and low <= rounded <= high and high - low < ROUND_RANGE else mean


def sampling_period(mean: float, spread: float, count: int) -> float:
    """Return the period (s) of the clock whose ``count`` steps were printed with few decimals.

    Their ``mean`` (s) is exact to one digit of print over the whole record, ``spread`` is the largest less
    the smallest.
    """
    tolerance = max(2.0 * spread / count, 1e-7 * mean)
    return round_period(mean - tolerance, mean + tolerance)


def line_through(x: Array | Indices, y: Array) -> tuple[float, float]:
    """Return slope and level (at 0) of the least-squares line through points, shape (n,) each, n >= 2."""
    centred = x - x.mean()
    slope = float(centred @ y) / float(centred @ centred)
    return slope, float(y.mean()) - slope * float(x.mean())


def on_line(number: Array | Indices, time: Array, period: float) -> tuple[Array, float]:
    """Return the times of samples on the line of a ``period`` (s) nearest to ``time``, and its rms about it.

    ``number``: of each sample; all of shape (n,).
    """
    off = time - time[0] - period * number
    mean = float(off.mean())
    return np.asarray(period * number + mean + time[0]), float(np.sqrt(np.mean(np.square(off - mean))))


def number_error(time: Array) -> float:
    """Return the error (s) of float64 numbers of the size of ``time``, after a few operations."""
    return 4.0 * float(np.spacing(np.abs(time[[0, -1]]).max()))


def resolution(time: Array) -> float:
    """Return the last digit (s) in which ``time`` was printed, or that its numbers can hold."""
    probe = time[: min(time.size, 200)]
    finest = max(1e-12, 2.0 * float(np.spacing(np.abs(probe).max())))
    for decimals in range(3, 12):
        if np.allclose(probe, np.round(probe, decimals), rtol=0.0, atol=1e-13):
            return max(float(10.0**-decimals), finest)
    return finest


def ticks(time: Array, noise: float) -> Array:
    """Return the resolution (s) of the clock at each stamp, shape (n,): it changes where digits do.

    It is the largest number of ns of which all steps nearby are multiples, to within ``noise`` (s).
    """
    whole = np.rint((time - time[0]) * 1e9).astype(np.int64)
    grid = 1
    while noise * 1e9 > 0.5 * grid:  # float64 seconds since 1970 hold 0.2 us
        grid *= 10
    for coarser in (10**power for power in range(9, 0, -1)):
        if coarser > grid and (np.abs(whole - coarser * np.rint(whole / coarser)) <= noise * 1e9).all():
            grid = coarser
            break
    steps = np.diff(np.rint(whole / grid).astype(np.int64))
    starts = np.arange(0, steps.size, _LOCAL)
    found = np.gcd.reduceat(np.abs(steps), starts) * grid
    whole_clock = int(np.gcd.reduce(found)) or grid
    found = np.where(found == 0, np.max(found, initial=whole_clock), found)
    return np.asarray(np.repeat(found, _LOCAL)[np.minimum(np.arange(time.size), steps.size - 1)] * 1e-9)


def first_step(time: Array, test: Callable[[Array], NDArray[np.bool_]]) -> int | None:
    """Return the number of the first step that passes ``test``."""
    for first, steps in _steps(time):
        found = test(steps)
        if found.any():
            return first + int(np.argmax(found))
    return None


def median_step(time: Array) -> float:
    """Return the median step; of a long record that of a piece at its beginning, middle and end."""
    starts = {0, max(0, time.size // 2 - _PIECE // 2), max(0, time.size - _PIECE)}
    return float(np.median(np.concatenate([np.diff(time[at : at + _PIECE]) for at in sorted(starts)])))


def _even(time: Array) -> Stamps | None:
    """Return the clock of stamps that are their samples' times; gaps are steps of several periods."""
    usual = median_step(time)
    gaps = 1 + np.concatenate([first + np.flatnonzero(steps > GAP * usual) for first, steps in _steps(time)])
    regular = time.size - 1 - gaps.size
    if regular < 2:
        return None
    long = time[gaps] - time[gaps - 1]
    low, high = math.inf, -math.inf
    for _, steps in _steps(time):
        inner = steps[steps <= GAP * usual]
        if inner.size:
            low, high = min(low, float(inner.min())), max(high, float(inner.max()))
    mean = (float(time[-1] - time[0]) - float(np.sum(long))) / regular
    period = sampling_period(mean, high - low, regular)
    digit = min(resolution(time), JITTER * period)
    if max(high - period, period - low) > JITTER * period + digit:
        return None
    missing = np.rint(long / period) - 1.0
    if missing.size and float(missing.min()) < 1.0:
        return None
    lost = int(np.sum(missing[missing <= time.size]))
    # Gaps of one length may all be rounded the same way.
    std = (high - low) * (1.0 / math.sqrt(3.0) + gaps.size / math.sqrt(12.0)) / (regular * mean)
    return Stamps(Rhythm.EVEN, 1.0 / period, std, low if high == low else 0.0, lost, gaps.astype(np.int64))


def _refined(time: Array, even: Stamps, noise: float) -> Stamps:
    """Return even stamps of few digits with the rate that fits them all, where the first choice does not."""
    if even.rate_std < 1e-5:  # less than quartz clocks differ by
        return even
    tick = ticks(time, noise)
    mean = float(time[-1] - time[0]) / (time.size - 1)
    found = _rounded(np.arange(time.size, dtype=np.float64), time, tick, noise, mean, jitters=False)
    if found is None:
        return replace(even, rate_std=3.0 * even.rate_std)  # of the mean, and of the round rate near it
    low, high = found
    period = even.period if low <= even.period <= high else round_period(low, high)
    std = (high - low) / (math.sqrt(3.0) * (low + high))
    return replace(even, rate=1.0 / period, rate_std=std, resolution=float(tick.max()))


def _judged(time: Array, even: Stamps, noise: float) -> Stamps:
    """Return even stamps with gaps, as uneven ones where bursts or a coarse clock may explain them."""
    edges = np.concatenate([[0], even.gaps, [time.size]])
    stretches, at = np.diff(edges)[1:-1], int(even.gaps[0])
    steps = np.rint((time[even.gaps] - time[even.gaps - 1]) / even.period)
    missing = float(np.sum(steps - 1.0))
    usual = float(np.median(np.diff(edges)))
    short = usual < FEW or usual * even.period < PAUSED
    if short and missing > MOST_LOST * time.size:
        reason = f"{missing:.0f} samples would be lost and {time.size} received"
    elif short and stretches.size >= BURSTS and float(stretches.std()) < ALIKE * float(stretches.mean()):
        reason = f"gaps after every {stretches.mean():.3g} samples are pauses between bursts, or losses"
    else:
        share = int(np.count_nonzero(steps == 2.0)) / time.size
        random = stretches.size >= MANY_STEPS and float(stretches.std()) >= RANDOM * float(stretches.mean())
        if share == 0.0 or random or float(ticks(time, noise).max()) < HIDING * even.period:
            return even
        std = math.hypot(even.rate_std, 0.5 * share)
        if std <= LEAST_CERTAIN:
            return replace(even, rate_std=std)
        reason = f"{even.gaps.size} gaps are lost samples, or the steps of a coarse clock"
    return Stamps(Rhythm.UNEVEN, literal=even, reason=reason, at=at)


def _uneven(time: Array, usual: float) -> Stamps:
    steps = np.diff(time)
    inner = steps[steps <= GAP * usual]
    period = float(np.mean(inner)) if inner.size else usual
    off = (np.abs(steps - period) > JITTER * period + resolution(time)) & (steps <= GAP * usual)
    at = int(np.argmax(off)) if off.any() else int(np.argmax(steps))
    reason = f"a step of {steps[at]:g} s where {period:g} s is usual"
    if usual <= 0.0:
        reason = f"most stamps repeat the one before, and the others step by up to {steps.max():g} s"
    return Stamps(Rhythm.UNEVEN, reason=reason, at=at + 1)


def _coarse(time: Array, noise: float, even: Stamps | None) -> Stamps | None:
    """Return the clock of stamps that were rounded to a resolution, with single losses where it shows them.

    ``even``: the same stamps taken as they are, with gaps.
    """
    share = 0.0 if even is None else even.gaps.size / (time.size - 1)
    if even is not None and float(np.max(np.diff(time))) > 2.5 * even.period and share <= AMBIGUOUS_SHARE:
        return None  # a coarse clock has steps of one and two periods only
    tick = ticks(time, noise)
    coarsest = float(tick.max())
    mean = float(time[-1] - time[0]) / (time.size - 1)
    if mean <= 0.0:
        return None
    number: Array = np.arange(time.size, dtype=np.float64)
    # Beyond a step of several samples a line holds although some were lost in it.
    jitters = coarsest <= mean and (even is None or even.gaps.size >= MANY_STEPS)
    found = _rounded(number, time, tick, noise, mean, jitters=jitters)
    hidden = coarsest >= HIDING * (mean if even is None else even.period)
    if found is None:
        if even is not None and (share <= AMBIGUOUS_SHARE or not hidden):
            return None
        numbered = _numbered(time, tick) if coarsest < 0.9 * mean else None
        if numbered is None or not 0.0 < numbered[-1] - (time.size - 1) <= time.size:
            return None
        number = numbered
        found = _rounded(number, time, tick, noise, mean, jitters=False)
        if found is None:
            return None
    elif even is not None and even.gaps.size < REGULAR_STEPS:
        if share <= AMBIGUOUS_SHARE:
            std = math.hypot(even.rate_std, 0.5 * share)
            return replace(even, rate_std=std)
        reason = f"{even.gaps.size} steps of two periods are lost samples or a coarse clock"
        return Stamps(Rhythm.UNEVEN, reason=reason, at=int(even.gaps[0]))
    low, high = found
    std = (high - low) / (math.sqrt(3.0) * (low + high))
    if coarsest > mean:  # a lost sample is not seen in a step of several
        std = math.hypot(std, 1.0 / time.size)
        if np.count_nonzero(np.diff(time)) < FEWEST_STEPS - 1:
            std = math.inf
    if std > LEAST_CERTAIN:
        reason = f"steps of {coarsest:g} s are too few and too coarse to show the rate"
        return Stamps(Rhythm.UNEVEN, reason=reason, at=time.size - 1)
    period = round_period(low, high)
    line, deviation = on_line(number, time, period)
    gaps = np.flatnonzero(np.diff(number) > 1.5) + 1
    lost = round(float(number[-1])) - (time.size - 1)
    return Stamps(Rhythm.COARSE, 1.0 / period, std, coarsest, lost, gaps.astype(np.int64), line, deviation)


def _rounded(
    number: Array, time: Array, tick: Array, noise: float, mean: float, *, jitters: bool
) -> tuple[float, float] | None:
    """Return the range of periods of a clock whose stamps are rounded to ``tick``, or a little beyond it."""
    for beyond in (0.0, min(0.5 * float(tick.max()), GAP * mean))[: 1 + jitters]:
        half = 0.5 * (tick + beyond) + noise
        found = rate_range(number, time - half, time + half)
        if found is not None and found[0] > 0.0:
            return found
    return None


def _numbered(time: Array, tick: Array) -> Array | None:
    """Return the number of each sample where some were lost, by a clock whose ticks are below a period.

    A loss leaves the phase of the stamps as it was, so that the rate is where their phasors add up: on a
    short stretch first, then on ever longer ones. ``None`` where two samples fall on one number.
    """
    at = time - time[0]
    size = min(_LOCAL, at.size)
    mean = float(at[size - 1]) / (size - 1)
    low, high = 0.97 / mean, min(1.2 / mean, 0.95 / float(tick.max()))
    if mean <= 0.0 or high <= low:
        return None
    rates = np.linspace(low, high, max(3, math.ceil(4.0 * (high - low) * float(at[size - 1]))))
    while True:
        sums = [np.exp(2j * math.pi * rate * at[:size]).sum() for rate in rates.tolist()]
        heights = np.abs(sums)
        # Whole ticks show 1/tick less the rate as well: of two that are as high, the one with fewer losses.
        first = int(np.argmax(heights >= 0.9 * float(heights.max())))
        best = first + int(np.argmax(heights[first : first + 8]))
        rate, phase = float(rates[best]), float(np.angle(sums[best])) / (2.0 * math.pi)
        if size == at.size:
            break
        size = min(2 * size, at.size)
        rates = rate + np.arange(-8, 9) / (8.0 * float(at[size - 1]))
    number = np.rint(rate * at - phase)
    for _ in range(3):  # with the line known, each tick belongs to one sample only
        slope, _ = line_through(number, at)
        left = at - slope * number
        number = np.rint((at - 0.5 * float(left.min() + left.max())) / slope)
        if not slope > 0.0 or float(np.min(np.diff(number))) < 1.0:
            return None
    return np.asarray(number - number[0])


def _bursts(time: Array, even: Stamps | None) -> Stamps | None:
    """Return the clock of samples that come together: of each burst its first or last stamp is on a line."""
    steps = np.diff(time)
    mean = float(time[-1] - time[0]) / steps.size
    long = steps > mean
    ends = np.flatnonzero(long)
    if ends.size < BURSTS or time.size < 1.5 * ends.size:
        return None
    inside, between = steps[~long], steps[long]
    if float(np.quantile(between, 0.05)) < PAUSE * float(np.quantile(inside, 0.95)):
        return None
    size = time.size / (ends.size + 1)
    if even is not None and size >= FEW and size * even.period >= PAUSED:
        return None  # recordings with pauses: no read of a buffer takes so long

    def fitted(place: Indices) -> tuple[float, float, float, float]:
        slope, level = line_through(place, time[place])
        left = time[place] - level - slope * place
        return float(np.ptp(left)), _farthest(left), level, slope

    # A last sample is at most a period before it is read; a first one at most a period after its tick.
    spread, off, level, slope = min(fitted(ends), fitted(ends + 1))
    if slope <= 0.0 or spread > max(2.0, 0.5 * size) * slope or off > OFF_LINE * slope:
        return None
    if even is None and _is_recording(time[ends[0] + 1 : ends[1] + 1], slope):
        return None
    digit = float(np.min(between)) if not inside.any() else 0.0
    std = 3.0 * max(off, 1e-9) / (float(ends[-1] - ends[0]) * slope)
    if std > LEAST_CERTAIN:
        return None
    reach = std * math.sqrt(3.0)
    period = round_period(slope * (1.0 - reach), slope * (1.0 + reach))
    line = period * np.arange(time.size, dtype=np.float64)
    line += level + (slope - period) * 0.5 * (time.size - 1)
    return Stamps(
        Rhythm.BURSTS,
        1.0 / period,
        std,
        digit,
        times=line,
        deviation=float(np.sqrt(np.mean(np.square(time - line)))),
        burst=size,
        literal=even,
    )


def _is_recording(time: Array, period: float) -> bool:
    """Return whether the stamps of one burst may be those of a faster, coarse clock that then paused."""
    if np.unique(time).size < FEWEST_STEPS:
        return False
    noise = number_error(time)
    mean = float(time[-1] - time[0]) / (time.size - 1)
    number = np.arange(time.size, dtype=np.float64)
    return (
        GAP * mean < period
        and _rounded(number, time, ticks(time, noise), noise, mean, jitters=True) is not None
    )


def _farthest(left: Array) -> float:
    """Return how far the mean of a batch of residuals is off their line at most."""
    count = BATCHES if left.size >= 2 * BATCHES else left.size
    edges = np.linspace(0, left.size, count + 1).astype(np.int64)
    total = np.concatenate([[0.0], np.cumsum(left)])
    return float(np.max(np.abs((total[edges[1:]] - total[edges[:-1]]) / np.diff(edges))))


def _jittered(time: Array, usual: float) -> Stamps | None:
    """Return the line through jittering stamps, period and gaps; ``None`` where no clock explains them."""
    steps = np.diff(time)
    inner = steps[steps < 3.0 * usual]
    if inner.size < 100:
        return None
    centred = inner - inner.mean()
    power = float(centred @ centred)
    if power == 0.0 or float(centred[1:] @ centred[:-1]) / power > STAMP_NOISE:
        return None
    return placed(time)


def placed(time: Array, *, stepped: bool = False) -> Stamps | None:
    """Return the line through stamps of a clock that jitters, with gaps where they advance for good.

    A late stamp leaves the stamps behind it where they were, a loss does not. With ``stepped`` a clock that
    was set by part of a period begins another line, too. ``None`` where no clock explains the stamps.
    """
    if time.size < 3 * BESIDE:
        return None
    steps = np.diff(time)
    period = float(np.median((time[BESIDE:] - time[:-BESIDE]) / BESIDE))
    if not period > 0.0:
        return None
    phase = time - period * np.arange(time.size)
    gaps, lost = [], 0
    odd = np.abs(steps - period) > JITTER * period if stepped else steps > GAP * period
    long = np.flatnonzero(odd) + 1
    # The longest first: what it explains is taken off before its neighbours are judged.
    jumps = _jumps(phase, long)
    long = long[(np.abs(jumps) if stepped else jumps) > JITTER * period]
    for at in long[np.argsort(-steps[long - 1])]:
        before, after = phase[max(0, at - BESIDE) : at], phase[at : at + BESIDE]
        moved = float(np.median(after) - np.median(before)) / period
        missing = round(moved)
        if missing >= 1 or (stepped and abs(moved) >= JITTER):
            gaps.append(int(at))
            lost += missing if 0 < missing <= time.size else 0
            phase[at:] -= (moved if stepped else missing) * period
    if lost > time.size:
        return None
    gaps.sort()
    edges = [0, *gaps, time.size]
    line, fitted = np.empty_like(time), 0.0
    for begin, end in pairwise(edges):
        number, part = np.arange(end - begin, dtype=np.float64), time[begin:end]
        slope = line_through(number, part)[0] if end - begin > 10 * BESIDE else period
        line[begin:end], _ = on_line(number, part, slope)
        fitted += slope * (end - begin)
    # A line through jitter cannot be surer than the jitter: half a period off is another clock.
    deviation = float(np.sqrt(np.mean(np.square(time - line))))
    total = np.concatenate([[0.0], np.cumsum(time - line)])
    nearby = float(np.max(np.abs(total[BESIDE:] - total[:-BESIDE]))) / BESIDE
    if float(
        np.quantile(np.abs(time - line), 0.999)
    ) > 5.0 * period or nearby > JITTER * period + 5.0 * deviation / math.sqrt(BESIDE):
        return None
    mean = fitted / time.size
    longest = max(end - begin for begin, end in pairwise(edges))
    std = 3.0 * max(_farthest(time - line), deviation / math.sqrt(longest)) / (longest * mean)
    slopes = math.sqrt(12.0 * sum(1.0 / (end - begin) for begin, end in pairwise(edges)))
    std = math.hypot(std, slopes * deviation / (time.size * mean))
    if std > LEAST_CERTAIN:
        return None
    return Stamps(
        Rhythm.JITTER, 1.0 / mean, std, 0.0, lost, np.asarray(gaps, dtype=np.int64), line, deviation
    )


def _jumps(phase: Array, places: Indices) -> Array:
    """Return by how much the mean of the stamps' phase rises at ``places``, over BESIDE samples each side."""
    total = np.concatenate([[0.0], np.cumsum(phase)])
    first, last = np.maximum(places - BESIDE, 0), np.minimum(places + BESIDE, phase.size)
    after = (total[last] - total[places]) / (last - places)
    return np.asarray(after - (total[places] - total[first]) / (places - first))


def _back_by_jitter(time: Array, usual: float) -> bool:
    """Return whether times go back no further than the jitter of all their steps explains."""
    steps = np.diff(time)
    usual_error = MEDIAN_TO_DEVIATION * float(np.median(np.abs(steps - usual)))
    return float(steps.min()) > usual - JITTER_REACH * usual_error


def _steps(time: Array) -> Iterator[tuple[int, Array]]:
    """Yield the number of the first step and the steps, piece by piece."""
    for first in range(0, time.size - 1, _PIECE):
        yield first, np.diff(time[first : first + _PIECE + 1])
