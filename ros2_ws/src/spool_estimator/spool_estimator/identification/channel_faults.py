"""Faults of channels in a record: clipping, gaps, exchanged or dead channels.

These are the rules for records (``check``, ``import --look``, ``fit``, ``gap``) and for the monitor, which
looks at the last seconds. Each fault has its own cause, named as the monitor's events are; a fault that
is not clear is not reported.

A flat top (:func:`flat_share`) shows within a second, behind noise, too; a rail (:func:`at_rail`) says which
samples of a whole record to leave out, be it a dozen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled
from spool_core.kernels.samples import impossible
from spool_core.numbers import GRAVITY, Array
from spool_core.record_limits import LIMITS

from spool_estimator.identification.channel_pair import (
    CORNER,
    DELAY,
    GAIN,
    LOW,
    ChannelPair,
    ClockStep,
    PairFit,
)

#: Smallest steps of a converter that a change must reach on both sides of equal samples.
STEPS = 8.0
#: Equal samples between such changes, over all such changes, from which samples repeat: a sensor that is
#: polled a fifth faster than it samples. What chance gives is taken off: half as many as differ by one step.
REPEATS = 0.15
#: Changes that are needed to judge repeats, and equal samples: 5 deviations of a share of REPEATS.
FEWEST = 200
#: Bend over the mean one up to which a line counts as straight, samples between two readings at most, and
#: share of the intervals that must be alike.
STRAIGHT, LONGEST, REGULAR = 1e-3, 32.0, 0.9
#: Jumps over the span, from which on a jump may be a wrap-around, and how many are needed.
WRAPS, FEWEST_WRAPS = 0.7, 3
#: Share of the span that a wrap has at least, as what is beyond the range comes in at its other end, and that
#: the samples beside it may change by: a wave that is sampled ten times a period changes by pi / 10.
TURN, BESIDE = 0.95, 0.3
#: Times by which a wrap exceeds nine in ten changes: the largest jumps of white noise do so 2.6 times.
SMOOTH = 3.0
#: Steps of the converter that a span must have: fewer are noise at rest behind a coarse converter.
LEVELS = 64.0
#: m/s^2 to which two sensors never agree over seconds: accelerometers for machines have 0.002 to 0.05 rms of
#: noise each.
AGREE = 0.002
#: s of samples, and changes in them, from which channels that agree are one.
SAME_TIME = 1.0
#: Gain, either way, from which it is a wrong sensitivity: side by side, two sensors differ by a few per cent,
#: and laws of friction that the fit has not bend the gain by up to 10 %. Larger ones are not told.
WRONG_GAIN, LARGEST_GAIN = 1.3, 14.0
#: Times by which a correction must reduce the squares of what the fit leaves, and what the fit may leave at
#: most: laws that the fit lacks reduce them by less, or leave more.
BETTER, FITS = 1.6, 0.5
BETTER_TIME, FITS_TIME = 1.5, 0.12
#: Times by which squares of the accounts by a corner and by a delay must differ for either to be told.
APART = 1.3
#: Deviations from zero that a delay or a corner must have.
CERTAIN = 8.0
#: Share of the damping that a corner must bias, and samples that a delay must have, to matter.
MATTERS, SLIP = 0.04, 0.4
#: s by which one clock must fall behind the other within a piece. A delay of half of it biases the damping by
#: w0 delay / (2 zeta): 10 % for 15 Hz and a damping ratio of 0.24.
LEAST_SLIP = 1e-3
#: Share of the body's power below the natural frequency without which gain and spring look alike.
BELOW = 1e-3
#: Times by which a step of one clock must reduce the squares, and share of the residual of a changed valve
#: that it may leave.
STEP_BETTER, STEP_SHARE = 2.0, 0.8
#: Spread (natural logarithm) of the body's frequencies below which some spring accounts for any gain: a
#: second order with 2 % of the power of the first one has 0.1.
SPREAD = 0.1
#: s of a record that are looked at together, pieces at most, and s without which nothing is fitted.
PIECE, PIECES, SHORTEST = 60.0, 10, 6.0

Row = NDArray[np.floating[Any]]

#: Depths, as a share of half the span, of the strip at a channel's extremes that a flat top fills.
DEPTHS = (0.002, 0.02)

#: Times as long in that strip as in those below it that no wave spends there, and share of samples in it.
FLATTER, FLAT = 6, LIMITS.clipped

#: Samples at a rail from which a channel clips, and how many times as many as at levels below it.
COUNT, PILED = 12, 10.0
#: Levels below: those of a sine read by a coarse converter are filled up to five times less than its top.
CLIPPING_BELOW = 12


#: s and samples at most of a piece whose tops are restored together, order of its autoregression, turns of
#: both, and the share that keeps its equations regular.
TOGETHER, MOST, ORDER, TURNS, RIDGE = 1.0, 2500, 40, 6, 1e-9


@dataclass(frozen=True, slots=True)
class ChannelFault:
    """Something wrong with a channel, or with one against the other.

    ``cause`` is that of the monitor's event, ``channel`` is ``body``, ``spool`` or ``both``; ``value`` in
    ``unit`` is its size, as the ``parameter`` that passed ``limit``. ``text`` says what is seen, ``remedy``
    what to do.
    """

    cause: str
    channel: str
    parameter: str
    value: float
    limit: float
    unit: str
    text: str
    remedy: str

    @property
    def sentence(self) -> str:
        """What is seen and what to do, in one line."""
        return f"{self.cause}: {self.text}: {self.remedy}"


@dataclass(frozen=True, slots=True)
class PairLook:
    """Verdict on a pair of channels: its gravest ``fault``, and the spool's ``delay`` (s), NaN: not known.

    ``changed``: the valve itself changes within the readings, as where a spring breaks.
    """

    fault: ChannelFault | None
    delay: float
    changed: bool = False


def faults_of(body: Array, spool: Array, period: float) -> list[ChannelFault]:
    """Return the faults in readings of both channels (m/s^2, shape (n,), ``period`` s apart), gravest first.

    A fault that spoils all others is returned alone. Impossible single samples are left out first.
    """
    rows = {name: without_outliers(row, period)[0] for name, row in (("body", body), ("spool", spool))}
    found = faults_of_rows(rows["body"], rows["spool"], period)
    return found or faults_of_pair(rows["body"], rows["spool"], period)


def faults_of_rows(body: Array, spool: Array, period: float) -> list[ChannelFault]:
    """Return the faults that the samples themselves show, whatever moves: same channel, wrap, repeats."""
    same = same_channel(body, spool, period)
    if same is not None:
        return [same]
    rows = (("body", body), ("spool", spool))
    # The newest part by itself: before integers began to wrap around, the span was another one.
    tried = (wrap_around(row, name) or wrap_around(row[-(row.size // 4) :], name) for name, row in rows)
    wraps = [wrap for wrap in tried if wrap is not None]
    slower = (repeats(row, name) or interpolated(row, name, period) for name, row in rows)
    return wraps or [one for one in slower if one is not None]


def without_outliers(row: Array, period: float) -> tuple[Array, int]:
    """Return ``row`` with impossible samples replaced by lines between their neighbours, and their number."""
    gone = impossible(row, period)
    count = int(np.count_nonzero(gone))
    if not count or count == row.size:
        return row, 0
    places = np.arange(row.size)
    repaired = row.copy()
    repaired[gone] = np.interp(places[gone], places[~gone], row[~gone])
    return repaired, count


def same_channel(body: Array, spool: Array, period: float) -> ChannelFault | None:
    """Return that both channels read one sensor: they agree, or agree but for a factor, better than two can.

    A spool that sticks moves as its body, but its sensor has its own noise.
    """
    gain, left = proportion(body, spool)
    # The largest difference is no smaller than the rms of all.
    if left > body.size * AGREE**2:
        return None
    changes = np.count_nonzero(np.diff(body))
    if body.size * period < SAME_TIME or changes < FEWEST:
        return None
    equal, apart, nearest = bool(np.array_equal(body, spool)), 0.0, AGREE
    if not equal:
        # Numbers of a file are rounded to some digit, which a factor scales.
        rounding = max(_step(np.diff(body)) * abs(gain), _step(np.diff(spool)))
        apart = float(np.abs(spool - gain * body).max())
        loud = float(np.std(spool)) > 50.0 * AGREE
        nearest = min(AGREE, 1.01 * rounding)
        if abs(gain) < 1e-3 or not loud or apart > nearest:
            return None
    text = (
        "both channels read the same numbers"
        if equal
        else f"spool is {gain:.4g} times body, sample by sample"
    )
    return ChannelFault(
        "same_channel", "both", "channel_difference", apart, nearest, "m/s^2", text,
        "one sensor is read twice: check the wiring and which channel of the logger each column is",
    )  # fmt: skip


@compiled
def proportion(body: Array, spool: Array) -> tuple[float, float]:
    """Return by which factor ``spool`` follows ``body``, and the sum of squares that this leaves.

    A library's products of so many samples run in threads, which costs a live node more than it gains.
    """
    bodies = both = spools = 0.0
    for i in range(body.size):
        bodies += body[i] * body[i]
        both += body[i] * spool[i]
        spools += spool[i] * spool[i]
    gain = both / bodies if bodies > 0.0 else 0.0
    return gain, spools - gain * both


def wrap_around(row: Array, name: str) -> ChannelFault | None:
    """Return that a converter's integers wrap around: jumps lead from one end of the span to the other."""
    span = float(np.ptp(row))
    change = np.diff(row)
    jumps = np.flatnonzero(np.abs(change) > WRAPS * span)
    # Beyond the end the signal goes on as it came: a whole turn makes it continuous.
    inside = jumps[(jumps > 0) & (jumps < change.size - 1)]
    if inside.size < FEWEST_WRAPS or not span > LEVELS * _step(change):
        return None
    turn = float(np.median(np.abs(change[inside] - 0.5 * (change[inside - 1] + change[inside + 1]))))
    unwrapped = change[inside] - np.sign(change[inside]) * turn
    beside = np.maximum(np.abs(change[inside - 1]), np.abs(change[inside + 1]))
    goes_on = np.abs(unwrapped) <= 2.0 * np.minimum(beside, 0.5 * span) + 0.02 * span
    # Noise has large jumps as well, but small ones are hardly smaller.
    others = np.abs(change[(change != 0.0) & (np.abs(change) <= WRAPS * span)])
    if others.size and float(np.median(np.abs(change[inside]))) < SMOOTH * float(np.quantile(others, 0.9)):
        return None
    # Samples stay at each end: a blow goes and returns, and so does an outlier.
    stays = beside < BESIDE * span
    # No sample lies outside of one turn; friction that turns round at a rail jumps as well.
    if turn < TURN * span or np.mean(goes_on & stays) <= 0.5:
        return None
    return ChannelFault(
        "wrap_around", name, "jump", turn, WRAPS * span, "m/s^2",
        f"{name} jumps by {turn:.4g} m/s^2 from one end of its range to the other, {jumps.size} times: "
        "its integers wrap around",
        "choose a larger range, or read the counts with the width and sign that the converter has",
    )  # fmt: skip


def repeats(row: Array, name: str) -> ChannelFault | None:
    """Return that samples repeat: equal neighbours between changes of many steps of the converter.

    Equal samples at a rail, of a channel that stands still, or of slow motion behind a coarse converter are
    none. Only rows of up to 16 equal samples between larger changes count.
    """
    change = np.diff(row)
    # As many neighbours are equal as samples repeat, at least.
    if change.size - np.count_nonzero(change) < REPEATS * FEWEST:
        return None
    counts, mean = count_repeats(row, _step(change), float(row.min()), float(row.max()))
    if counts[0, 0] < FEWEST:
        return None
    # A vibration that is read alike at each of its tops repeats there, and nowhere else.
    for total, equal, chance in counts.tolist():
        # By chance neighbours are equal half as often as they differ by one step, up or down.
        if total < FEWEST // 4 or equal - 0.5 * chance < REPEATS * total:
            return None
    return ChannelFault(
        "repeats", name, "equal_samples", mean, 1.0 + REPEATS, "1",
        f"{name} repeats its samples, each {mean:.3g} times on average",
        "poll the sensor at its own rate, or record with the rate at which it samples",
    )  # fmt: skip


def interpolated(row: Array, name: str, period: float) -> ChannelFault | None:
    """Return that samples lie on straight lines between slower ones, which come at equal intervals.

    Bends of fewer than ``STEPS`` steps of the converter say nothing, nor do those of a motion that rests at
    times: they come as they like.
    """
    bends = np.abs(np.diff(row, 2))
    step = _step(np.diff(row))
    bent = bends > max(STRAIGHT * float(bends.mean()), 2.5 * step)
    if not FEWEST < np.count_nonzero(bent) < bent.size / 2.0 + 1.0:
        return None
    # A reading between two samples bends the line at both.
    starts = np.flatnonzero(bent & ~np.concatenate([[False], bent[:-1]]))
    apart = np.diff(starts)
    ratio = float(np.median(apart)) if apart.size >= FEWEST // 2 else math.inf
    alike = np.abs(apart - ratio) <= (1.0 if ratio > 2.0 else 0.0)
    if ratio > LONGEST or np.mean(alike) < REGULAR or float(np.median(bends[bent])) < STEPS * step:
        return None
    mean = float(apart[alike].mean())
    return ChannelFault(
        "repeats", name, "equal_samples", mean, 1.0 + REPEATS, "1",
        f"{name} is interpolated: its readings come at {1.0 / (period * mean):.4g} Hz, "
        f"one in {mean:.3g} samples",
        "export each channel at its own rate, or record with the rate at which the sensor samples",
    )  # fmt: skip


@compiled
def count_repeats(row: Array, step: float, low: float, high: float) -> tuple[Array, float]:
    """Return how often samples repeat between large changes, and how many do on average.

    Rows of the counts: all levels, and those that lie on a slope. Columns: levels that are judged, those with
    more than one sample, and changes by one ``step`` between large ones. Rails are levels that are met again
    and again at the extremes ``low`` and ``high``.
    """
    counts, samples = np.zeros((2, 3)), 0.0
    before, previous = -1, 0.0
    for i in range(row.size - 1):
        change = row[i + 1] - row[i]
        if change == 0.0:
            continue
        length = i - before
        large = abs(change) > STEPS * step and abs(previous) > STEPS * step
        level = row[before + 1]
        if before >= 0 and large and length <= 16 and low + step < level < high - step:
            samples += length
            for which in range(2 if change * previous > 0.0 else 1):
                counts[which, 0] += 1
                counts[which, 1] += length > 1
        before, previous = i, change
        if 0 < i < row.size - 2 and abs(change) < 1.5 * step:
            earlier, later = row[i] - row[i - 1], row[i + 2] - row[i + 1]
            if abs(earlier) > STEPS * step and abs(later) > STEPS * step:
                for which in range(2 if earlier * later > 0.0 else 1):
                    counts[which, 2] += 1
    return counts, samples / max(1.0, counts[0, 0])


def faults_of_pair(body: Array, spool: Array, period: float) -> list[ChannelFault]:
    """Return the faults of one channel against the other: sensitivity, step of a clock, coupling, delay."""
    size = round(PIECE / period)
    pieces = max(1, body.size // size)
    chosen = np.unique(np.linspace(0, pieces - 1, min(pieces, PIECES)).astype(int))
    found: dict[str, ChannelFault] = {}
    for number in chosen.tolist():
        first = number * size
        last = body.size if number == pieces - 1 else first + size
        look = look_at_pair(body[first:last], spool[first:last], period, first * period)
        if look is not None and look.fault is not None:
            found.setdefault(look.fault.cause, look.fault)
    return list(found.values())


def pair_of(body: Array, spool: Array, period: float) -> ChannelPair | None:
    """Return the pair of readings, ``None`` where it cannot be judged.

    They are too short, do not move, are sampled too slowly, or shaken at one frequency only.
    """
    # The difference of two equal channels has no shape.
    moves = min(float(np.ptp(row)) for row in (body, spool, spool - body)) > 0.0
    if body.size * period < SHORTEST or not moves or period > 0.1 / LOW:
        return None
    pair = ChannelPair(body, spool, period)
    return pair if pair.long_enough and pair.spread > SPREAD else None


def look_at_pair(body: Array, spool: Array, period: float, start: float = 0.0) -> PairLook | None:
    """Return what a pair of readings shows, ``period`` s apart; ``None`` where it cannot be judged.

    ``start`` is the time of the first sample, s: from the record's first, negative before now.
    """
    pair = pair_of(body, spool, period)
    # A clipped channel has another gain at its tops.
    if pair is None or flat_share(body) + flat_share(spool) > 0.0:
        return None
    seen = pair.glance()
    # A delay may be so large that nothing of first order shows it.
    wild = seen.plain >= FITS**2
    if not wild and seen.plain < BETTER_TIME * min(seen.constant, seen.parted):
        # No fault can explain so much more that it would be believed: none is searched for.
        return PairLook(None, seen.delay if seen.delayed < FITS_TIME**2 else math.nan)
    drift = clock_drift(pair)
    if drift is not None:
        return PairLook(drift, math.nan)
    gain, nominal = pair.fit((GAIN,)), pair.fit(())
    parted = changes_within(gain, seen.parted)
    wrong = wrong_sensitivity(pair, gain, nominal)
    step = pair.step(nominal) if wild or parted or wrong is not None else None
    first = 0 if step is None else round(step.time / period)
    after = ChannelPair(body[first:], spool[first:], period)
    changed = step is not None and valve_changes(after, step, gain)
    if wrong is not None and parted:
        wrong = sensitivity_in(after)
    elif step is not None and step.valve < gain.residual:
        wrong = None  # sensors that are right, on a valve that changes, account for more
    if wrong is not None and not changed and not clock_steps(step, gain.residual, period):
        return PairLook(wrong, math.nan)
    coupled, delayed = pair.fit((GAIN, CORNER), gain), pair.fit((GAIN, DELAY), gain)
    delay = delayed.delay if delayed.residual < FITS_TIME else math.nan
    # A step bends the gain of the whole, and so do laws that the fit lacks: 1 is tried before it.
    constant = min(coupled.residual, delayed.residual)
    if (
        step is not None
        and not clock_steps(step, constant, period)
        and nominal.residual**2 > BETTER * gain.residual**2
    ):
        step = pair.step(gain)
    if step is not None and clock_steps(step, constant, period):
        late = "late" if step.size > 0.0 else "early"
        when = start + step.time
        since = f"from {when:.1f} s on" if when >= 0.0 else f"since {-when:.1f} s ago"
        fault = ChannelFault(
            "clock_step",
            "both",
            "clock_step",
            step.size,
            math.copysign(SLIP * period, step.size),
            "s",
            f"{since} the spool's samples come {1e3 * abs(step.size):.1f} ms {late} against the body's",
            "sample both sensors with one clock; cut the record there, or import both sensors' own times",
        )
        return PairLook(fault, delay)
    if changed:
        return PairLook(None, delay, changed=True)
    if coupled.residual**2 * APART < delayed.residual**2:
        return PairLook(coupling(gain, coupled), delay)
    if delayed.residual**2 * APART < coupled.residual**2:
        return PairLook(constant_delay(gain, delayed, period), delay)
    return PairLook(None, delay)


def changes_within(gain: PairFit, parted: float) -> bool:
    """Whether two accounts, which leave the squares ``parted``, explain more than one gain does."""
    return gain.residual**2 >= BETTER_TIME * parted


def sensitivity_in(after: ChannelPair) -> ChannelFault | None:
    """Return the wrong sensitivity in the later part of readings that change within.

    Some gain explains half of any two states, such as before and after an exchange of the channels.
    """
    gain = after.fit((GAIN,)) if after.long_enough else None
    if gain is None or changes_within(gain, after.glance().parted):
        return None
    return wrong_sensitivity(after, gain, after.fit(()))


def valve_changes(after: ChannelPair, step: ClockStep, gain: PairFit) -> bool:
    """Whether the valve changes within the readings, as where a spring breaks, which bends the gain of all.

    A gain that jumps looks like that, too, where few frequencies move the spool; it stays wrong ``after``.
    """
    if STEP_BETTER * step.valve**2 > min(step.clock, gain.residual) ** 2:
        return False
    return after.long_enough and abs(math.log(after.fit((GAIN,)).gain)) < 0.5 * math.log(WRONG_GAIN)


def wrong_sensitivity(pair: ChannelPair, gain: PairFit, nominal: PairFit) -> ChannelFault | None:
    """Return that the sensitivity of one channel is wrong, by the fits with the gain free and held at 1."""
    apart = abs(math.log(gain.gain))
    frequency = gain.natural_frequency
    told = (
        math.log(WRONG_GAIN) < apart < math.log(LARGEST_GAIN)
        and gain.residual < FITS
        and nominal.residual**2 > BETTER * gain.residual**2
        and CERTAIN * gain.deviations[GAIN] < apart
        and frequency > LOW
        and gain.damping > -0.1 * math.sqrt(gain.stiffness)
        and pair.below(frequency) > BELOW
    )
    if not told:
        return None
    factor, other = gain.gain, 1.0 / gain.gain
    gravity = min(abs(apart - math.log(GRAVITY)), 1.0) < min(0.005, abs(apart - math.log(10.0)))
    units = "; 9.81 lies between g and m/s^2" if gravity else ""
    limit = WRONG_GAIN if factor > 1.0 else 1.0 / WRONG_GAIN
    return ChannelFault(
        "sensitivity", "both", "spool_over_body", factor, limit, "1",
        f"spool reads {factor:.3g} times what the body's reading makes due: the spool's sensitivity is wrong "
        f"by {factor:.3g}, or the body's by {other:.3g}{units}",
        "check sensitivity, range and unit of both sensors; calibrate them side by side",
    )  # fmt: skip


def clock_drift(pair: ChannelPair) -> ChannelFault | None:
    """Return that one clock runs faster than the other, by fits to the pair and to one that is stretched."""
    rate, seconds = pair.rate(), pair.body.size * pair.period
    slip = rate * seconds
    if abs(slip) < max(LEAST_SLIP, SLIP * pair.period):
        return None
    time = np.arange(pair.spool.size)
    stretched = ChannelPair(pair.body, np.interp((1.0 + rate) * time, time, pair.spool), pair.period)
    corrected, plain = stretched.fit((DELAY,)).residual, pair.fit((DELAY,)).residual
    if corrected > FITS or plain**2 < BETTER_TIME * corrected**2:
        return None
    step = pair.step(pair.fit(()))
    # A step of a clock, or a valve that changes, may account for the record better than a drift.
    if step is not None and (step.clock < corrected or corrected > STEP_SHARE * step.valve):
        return None
    late = "late" if slip > 0.0 else "early"
    return ChannelFault(
        "clock_drift",
        "both",
        "clock_drift",
        rate,
        math.copysign(LEAST_SLIP / seconds, rate),
        "1",
        f"the spool's samples come ever more {late} against the body's: {1e6 * abs(rate):.0f} ppm, "
        f"{1e3 * abs(slip):.1f} ms in {seconds:.0f} s",
        "sample both sensors with one clock, or import both sensors' own times",
    )


def clock_steps(step: ClockStep | None, constant: float, period: float) -> bool:
    """Whether a step of one clock accounts for a record, by how it does.

    It must do so better than what both channels have throughout, which leaves ``constant``, and than a valve
    that changes.
    """
    return (
        step is not None
        and step.clock < FITS
        and min(step.common, constant) ** 2 > STEP_BETTER * step.clock**2
        and step.clock < STEP_SHARE * step.valve
        and abs(step.size) > SLIP * period
    )


def coupling(plain: PairFit, coupled: PairFit) -> ChannelFault | None:
    """Return that one channel is coupled through a high-pass, by the fits without and with a corner."""
    angular = 2.0 * math.pi * abs(coupled.corner)
    clear = _clear(plain, coupled) and abs(coupled.corner) > CERTAIN * coupled.deviations[CORNER]
    if not clear or not MATTERS * coupled.damping < angular < 2.0 * math.pi * coupled.natural_frequency:
        return None
    name = "spool" if coupled.corner > 0.0 else "body"
    return ChannelFault(
        "ac_coupling",
        name,
        "corner_frequency",
        abs(coupled.corner),
        MATTERS * coupled.damping / (2.0 * math.pi),
        "Hz",
        f"{name} lacks its slow part: it is coupled through a high-pass of {abs(coupled.corner):.2g} Hz, "
        "the other channel is not",
        "set both channels to DC coupling, or both to the same lower limit",
    )


def constant_delay(plain: PairFit, delayed: PairFit, period: float) -> ChannelFault | None:
    """Return that one channel is late throughout, by the fits without and with a delay."""
    clear = _clear(plain, delayed) and abs(delayed.delay) > CERTAIN * delayed.deviations[DELAY]
    if not clear or abs(delayed.delay) < SLIP * period:
        return None
    late = "late" if delayed.delay > 0.0 else "early"
    return ChannelFault(
        "delay",
        "both",
        "delay",
        delayed.delay,
        math.copysign(SLIP * period, delayed.delay),
        "s",
        f"the spool's samples come {1e3 * abs(delayed.delay):.2g} ms "
        f"({abs(delayed.delay) / period:.2g} samples) {late} against the body's, throughout",
        "sample both sensors with one clock and equal filters, or fit with --sensor-delay",
    )


def flat_share(samples: Row) -> float:
    """Return the share of ``samples``, shape (n,), on a flat top at the upper or lower extreme."""
    low, high = float(samples.min()), float(samples.max())
    half = 0.5 * (high - low)
    return flat_top(samples, high, half) + flat_top(samples, low, -half) if half > 0.0 else 0.0


@compiled
def flat_top(samples: Row, peak: float, half: float) -> float:
    """Return the share of ``samples`` on a flat top at ``peak``, 0 for the top of any wave.

    ``half`` of the span is positive at the upper extreme and negative at the lower one.

    A sine spends as long within a depth below its peak as in the strip from there to four times that depth,
    the flattest sum of two waves (a top with two humps) 4.4 times as long; a clipped one spends much more,
    and neighbours of each sample in the strip lie in it too.
    """
    side = math.copysign(1.0, half)
    for depth in DEPTHS:
        top, strip = side * (peak - depth * half), side * (peak - 4.0 * depth * half)
        count = pairs = triples = below = run = 0
        for sample in samples:
            value = side * float(sample)
            if value < strip:
                run = 0
            elif value < top:
                run = 0
                below += 1
            else:
                run += 1
                count += 1
                pairs += run > 1
                triples += run > 2
        # A wave whose period is a whole number of samples may show the same two of each top.
        long_enough = pairs >= max(4.0, FLAT * samples.size) and triples >= 0.02 * pairs
        if long_enough and count > FLATTER * (below + 1):
            return count / samples.size
    return 0.0


def at_rail(row: Array) -> NDArray[np.bool_] | None:
    """Return which samples sit at a rail: equal to the extreme, often, and in runs; ``None`` for none."""
    found = np.zeros(row.size, dtype=np.bool_)
    for side in (1.0, -1.0):
        values = side * row
        top = float(values.max())
        at_top = values >= top - 1e-6 * abs(top)
        count = int(np.count_nonzero(at_top))
        pairs = int(np.count_nonzero(at_top[1:] & at_top[:-1]))
        if not top > 0.0 or count < COUNT or not pairs > 0.25 * count:
            continue
        # How many samples share one of the highest levels below.
        lower = values[~at_top]
        some = lower[lower > np.quantile(lower, 0.9)] if lower.size else lower
        _, counts = np.unique(some, return_counts=True)
        if count >= PILED * (float(counts[-CLIPPING_BELOW:].mean()) if counts.size else 0.0):
            found |= at_top
    return found if found.any() else None


def restored(
    row: Array, gone: NDArray[np.bool_], flat: NDArray[np.bool_], rate: float
) -> tuple[Array, Array]:
    """Return ``row`` with the samples ``gone`` predicted from both sides, and their deviations, shape (n,).

    In pieces of a second an autoregression is fitted to the row as filled so far, and the samples that it
    makes likeliest are filled in, by turns. Those that are ``flat``, at a rail, are at least that far out.
    Deviations are 0 of samples that are there.

    Source: Janssen, Veldhuis and Vries, IEEE Trans. ASSP 34, 1986.
    """
    places = np.arange(row.size)
    filled, deviations = row.copy(), np.zeros(row.size)
    filled[gone] = np.interp(places[gone], places[~gone], row[~gone])
    size = min(row.size, MOST, max(round(TOGETHER * rate), 4 * ORDER))
    for begin in range(0, row.size, size // 2):
        low = max(0, min(begin - size // 4, row.size - size))
        unknown = np.flatnonzero(gone[low : low + size])
        if not unknown.size:
            continue
        piece = filled[low : low + size].copy()
        rails, at_it = row[low + unknown], flat[low + unknown]
        least, most = (np.where(at_it & (side * rails > 0.0), rails, -side * np.inf) for side in (1.0, -1.0))
        for _ in range(TURNS):
            ahead = np.lib.stride_tricks.sliding_window_view(piece, ORDER + 1)[:, ::-1]
            products = ahead[:, 1:].T @ ahead[:, 1:]
            products += RIDGE * np.trace(products) / ORDER * np.eye(ORDER)
            own = np.concatenate([[1.0], -np.linalg.solve(products, ahead[:, 1:].T @ ahead[:, 0])])
            # Row t of the errors holds the coefficient of each unknown sample in the error of sample t.
            back = np.arange(ORDER, piece.size)[:, np.newaxis] - unknown
            errors = np.where((back >= 0) & (back <= ORDER), own[back.clip(0, ORDER)], 0.0)
            information = errors.T @ errors
            power = float(np.mean((ahead @ own) ** 2))
            piece[unknown] = 0.0
            known = np.convolve(piece, own)[ORDER : piece.size]
            information += RIDGE * np.trace(information) / unknown.size * np.eye(unknown.size)
            covariance = np.linalg.inv(information)
            piece[unknown] = np.clip(-covariance @ (errors.T @ known), least, most)
        kept = (unknown + low >= begin) & (unknown + low < begin + size // 2)
        filled[low + unknown[kept]] = piece[unknown[kept]]
        deviations[low + unknown[kept]] = np.sqrt(power * np.diag(covariance).clip(0.0))[kept]
    return filled, deviations


def _clear(plain: PairFit, corrected: PairFit) -> bool:
    """Whether ``corrected`` explains the pair, and much better than ``plain`` does."""
    better = plain.residual**2 > BETTER_TIME * corrected.residual**2
    return better and corrected.residual < FITS_TIME and corrected.stiffness > 0.0


def _step(change: Array) -> float:
    """Return the smallest step in the changes of a row: that of the converter, or of the digits."""
    sizes = np.abs(change[change != 0.0])
    # Levels of a converter are rounded in a file: steps that differ by less than that are one.
    place = math.ceil(0.001 * (sizes.size - 1))
    return float(np.partition(sizes, place)[place]) if sizes.size else 0.0
