"""Orders of a machine's shaft: acceleration over angle, its lines, and the component that shakes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are first used
from numpy.typing import NDArray
from spool_core.block import Block
from spool_core.numbers import Array

if TYPE_CHECKING:  # slow to load
    from spool_sim.valve import Component

#: Probability that noise alone shows a line in a look, over all orders that are looked at.
FALSE_LINE = 1e-6
#: Lines of the spectrum that a sine spreads to on each side under a Hann taper.
LOBE = 2
#: Lines of noise on each side, every other one: a Hann taper correlates neighbours.
NOISE_LINES, NOISE_STEP = 8, 2
_OFFSETS = LOBE + 1 + NOISE_STEP * np.arange(NOISE_LINES)
_AROUND = np.concatenate((-_OFFSETS[::-1], _OFFSETS))
#: Lines from one that a test needs on each side.
REACH = int(_OFFSETS[-1])
#: Lines on each side of an order, and the share of their power that one sine of constant amplitude must hold.
#: The weakest line that noise does not show has 1.5 / (1.5 + 13 / 33) = 0.8: 33 is its contrast under
#: FALSE_LINE, 1.5 the noise bandwidth of the taper in lines, 13 the lines. Of noise through a structure of
#: 0.5 % damping at 29 Hz, 2.3 lines wide, 3 to 4 % of the pieces reach that, and at most 1 % reach 0.9 (study
#: `orders`); a line needs 1.5 times the least amplitude for it.
SKIRT, PURE = 6, 0.9

#: Orders of a shaft of which nobody said what turns with it.
SHAFT_ORDERS = tuple(float(order) for order in range(1, 13))
#: s of body and speed that an order is looked for in: chosen, longer tells closer lines apart, and later.
MEMORY = 8.0
#: s between two speeds, or since the last one, from which the speed is unknown: one a second may be late.
STALE = 2.5
#: Speeds that are kept: a hundred a second.
MOST_SPEEDS = round(100 * (MEMORY + STALE))
#: rev/min below which a shaft stands still: its 40th order lies below what the monitor looks at.
SLOWEST = 5.0
#: Share by which a speed may change within a second, and at once: no machine is faster, a faulty sensor is.
FASTEST, STEP = 3.0, 0.1

#: Probability that a vibration of another origin lies on an order by chance: chosen, the usual 5 %.
MOST_CHANCE = 0.05
#: Relative error of a measured speed: the last digit of 600 rev/min as a drive reports it.
SPEED_ERROR = 0.001
#: Share of the power that a line keeps over angle, of its power over time, where both tell the same.
KEPT = 0.9
#: Hz by which the strongest line of a second may lie beside an order: a second resolves 1 Hz.
BESIDE = 1.0
#: Revolutions of a piece of an order spectrum, and the highest order that it shows.
TURNS, MOST_ORDERS = 64, 30


class OrderName(NamedTuple):
    """Name of what shakes: ``order`` of ``component`` (empty: the shaft) at ``rpm``, its own speed."""

    order: float
    component: str
    rpm: float


@dataclass(slots=True)
class OrderTracker:
    """The last seconds of body and speed, bounded; names the order that a line of the body is.

    Attributes:
        components: what turns with the shaft.
    """

    components: Sequence[Component] = ()
    _period: float = field(default=0.0, init=False)
    _blocks: deque[tuple[int, Array]] = field(default_factory=deque, init=False)
    _end: int = field(default=0, init=False)
    _speeds: deque[tuple[int, float]] = field(
        default_factory=lambda: deque[tuple[int, float]](maxlen=MOST_SPEEDS), init=False
    )

    def restart(self, period: float) -> None:
        """Forget the body; its next samples are ``period`` s apart."""
        self._period = period
        self._blocks.clear()

    def take_speed(self, stamp: int, rpm: float) -> None:
        """Take the shaft's speed (rev/min) at ``stamp`` (ns)."""
        if self._speeds and stamp < self._speeds[-1][0]:
            self._speeds.clear()
        elif self._speeds and stamp == self._speeds[-1][0]:
            self._speeds.pop()
        self._speeds.append((stamp, rpm))

    def take(self, block: Block) -> None:
        """Take a block that continues the last one."""
        if not self._speeds:
            self._blocks.clear()
            return
        self._blocks.append((block.stamp, block.body.astype(np.float64)))
        oldest = block.stamp - round((MEMORY + STALE) * 1e9)
        while len(self._blocks) > 1 and self._blocks[1][0] <= oldest:
            self._blocks.popleft()

    def named(self, frequency: float, stamp: int) -> tuple[OrderName | None, str]:
        """Return the order that a line of ``frequency`` (Hz) at ``stamp`` (ns) is, and the code of a remark.

        The remark says why there is no name; it is empty where no speed is measured.
        """
        if not self._speeds:
            return None, ""
        begin = stamp - round(MEMORY * 1e9)
        speeds = [one for one in self._speeds if begin - STALE * 1e9 <= one[0] <= stamp]
        fault = speed_fault(speeds, stamp)
        if fault or not self._blocks:
            return None, fault or "order_unknown"
        times, rpm = np.array(speeds, dtype=np.float64).T
        begin = max(begin, speeds[0][0], self._blocks[0][0])
        first = max(0, math.ceil((begin - self._blocks[0][0]) * 1e-9 / self._period))
        count = math.floor((speeds[-1][0] - self._blocks[0][0]) * 1e-9 / self._period) + 1
        body = np.concatenate([samples for _, samples in self._blocks])[first:count]
        begins = (self._blocks[0][0] - stamp) * 1e-9
        at: Array = np.asarray(begins + (first + np.arange(body.size)) * self._period, dtype=np.float64)
        turns = revolutions(at, np.asarray((times - stamp) * 1e-9, dtype=np.float64), rpm)
        if body.size < 4 * REACH or turns[-1] < 4.0:
            return None, "order_unknown"
        speed = float(rpm[-1])
        found = name_of(body, turns, self._period, 60.0 * frequency / speed, speed, self.components)
        return found, "" if found is not None else "order_unknown"


def line_powers(samples: Array) -> Array:
    """Return the power of each line under a Hann taper; a sine's lines add up to half its amplitude squared.

    Args:
        samples: shape (..., n); the result has (..., n // 2 + 1).
    """
    taper = np.hanning(samples.shape[-1])
    spectrum = np.fft.rfft((samples - samples.mean(axis=-1, keepdims=True)) * taper)
    return np.asarray(2.0 * np.abs(spectrum) ** 2 / (samples.shape[-1] * float(taper @ taper)))


def contrast(powers: Array, places: NDArray[np.int64]) -> Array:
    """Return each line's power over the mean of the noise around it.

    Args:
        powers: shape (..., lines).
        places: of the lines that are asked for, (n,), at least ``REACH`` from both ends.
    """
    line, noise = powers[..., places], powers[..., places[:, np.newaxis] + _AROUND].mean(axis=-1)
    return np.asarray(np.divide(line, noise, out=np.full(line.shape, np.inf), where=noise > 0.0))


def false_probability(contrasts: Array) -> Array:
    """Return the probability that Gaussian noise, flat around a line, shows it as strong: F of 2 and 2 n."""
    # The F distribution of 2 and 2n degrees of freedom in closed form.
    return np.asarray((1.0 + contrasts / _AROUND.size) ** -float(_AROUND.size))


def is_one_sine(samples: Array, powers: Array, peak: int, cycles: float) -> bool:
    """Whether one sine of constant amplitude holds nearly all power around a line (``SKIRT``, ``PURE``).

    Args:
        samples: shape (n,).
        powers: of their lines.
        peak: the line.
        cycles: of the sine in ``samples``.
    """
    around = float(powers[peak - SKIRT : peak + SKIRT + 1].sum())
    taper = np.hanning(samples.size)
    sine = np.exp(-2j * np.pi * cycles / samples.size * np.arange(samples.size))
    power = float(2.0 * np.abs(sine @ ((samples - samples.mean()) * taper)) ** 2 / taper.sum() ** 2)
    return power >= PURE * around


def candidates(components: Iterable[Component]) -> dict[float, list[tuple[float, float, str, bool]]]:
    """Return who may shake with each order of the measured shaft, the lowest first.

    Of each: its own order, its speed over that of the shaft, its name, and whether the order is its own
    (pistons, firing) and not that of any shaft. Of unknown components it is the shaft, whose name is empty.
    """
    found: dict[float, list[tuple[float, float, str, bool]]] = {}
    for one in components:
        for order, own in one.orders.items():
            found.setdefault(round(order * one.ratio, 9), []).append((order, one.ratio, one.name, own))
    if not found:
        found = {order: [(order, 1.0, "", False)] for order in SHAFT_ORDERS}
    return dict(sorted(found.items()))


def attributed(sources: Sequence[tuple[float, float, str, bool]]) -> tuple[float, float, str]:
    """Return own order, ratio and name of the only one of ``sources`` that the order is typical of.

    Where several are, none is named: then order and speed are those of the measured shaft.
    """
    typical = [one for one in sources if one[3]] or list(sources)
    order, ratio, name, _ = typical[0]
    return (order, ratio, name) if len(typical) == 1 else (order * ratio, 1.0, "")


def speed_fault(speeds: Sequence[tuple[int, float]], stamp: int) -> str:
    """Return the code of what makes ``speeds`` (ns, rev/min) useless at ``stamp`` (ns), empty for nothing."""
    if len(speeds) < 2 or stamp - speeds[-1][0] > STALE * 1e9:
        return "speed_stale"
    if not all(math.isfinite(rpm) for _, rpm in speeds):
        return "speed_invalid"
    if any(rpm < 0.0 for _, rpm in speeds):
        return "speed_negative"
    if any(rpm < SLOWEST for _, rpm in speeds):
        return "speed_standstill"
    for (before, slow), (after, fast) in pairwise(speeds):
        seconds, change = (after - before) * 1e-9, abs(fast - slow) / max(slow, fast)
        if seconds > STALE:
            return "speed_stale"
        if change > max(STEP, FASTEST * seconds):
            return "speed_jump"
    return ""


def revolutions(time: Array, times: Array, rpm: Array) -> Array:
    """Return the revolutions since ``time[0]``, the exact integral of ``rpm`` along straight lines.

    Args:
        time: s, shape (n,), where they are asked for.
        times: s, shape (m,), rising, of the speeds ``rpm`` (rev/min, shape (m,)); held beyond its ends.
    """
    knots = np.unique(np.concatenate((times, time)))
    speed = np.interp(knots, times, rpm) / 60.0
    whole = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(knots))))
    turns = np.interp(time, knots, whole)
    return np.asarray(turns - turns[0])


def by_angle(samples: Array, turns: Array, whole: float) -> Array:
    """Return ``samples``, shape (..., n), at even angles over the last ``whole`` of their ``turns``, (n,).

    There are as many angles as keep the densest samples, at most four times as many as samples.
    """
    steps = np.diff(turns)
    count = scipy.fft.next_fast_len(min(math.ceil(whole / float(steps.min())), 4 * turns.size), real=True)
    angles = turns[-1] - whole + np.arange(count) * (whole / count)
    return np.asarray(scipy.interpolate.CubicSpline(turns, samples, axis=-1)(angles))


def name_of(
    body: Array, turns: Array, period: float, order: float, rpm: float, components: Sequence[Component]
) -> OrderName | None:
    """Return the name of the line near ``order`` in ``body`` over ``turns``, ``None`` where it is not sure.

    It is sure if noise does not show such a line (``FALSE_LINE``), the line lies on the order as closely as
    record and speed allow, chance would not put it there (``MOST_CHANCE``), and it follows the shaft at least
    as well as it keeps a frequency, with one phase and amplitude.

    Args:
        body: m/s^2, shape (n,), ``period`` s apart.
        turns: revolutions at each sample, shape (n,).
        order: frequency of the line over that of the shaft.
        rpm: present speed, rev/min.
        components: what turns with the shaft.
    """
    known = candidates(components)
    orders = np.array(list(known))
    whole = 2.0 * math.floor(0.5 * float(turns[-1])) or float(turns[-1])
    even = by_angle(body, turns, whole)
    powers = line_powers(even)
    tolerance = 0.5 / whole + SPEED_ERROR * orders
    gaps = np.gradient(orders) if orders.size > 1 else orders
    places = np.rint(orders * whole).astype(np.int64)
    beside = np.abs(orders - order) * rpm / 60.0 <= BESIDE + SPEED_ERROR * order * rpm / 60.0
    usable = beside & (places > REACH + LOBE) & (places < powers.size - REACH - LOBE)
    usable &= 2.0 * tolerance / gaps <= MOST_CHANCE
    best: tuple[float, float] | None = None
    for number in np.flatnonzero(usable):
        near = places[number] + np.arange(-LOBE, LOBE + 1)
        peak = int(near[np.argmax(powers[near])])
        lobe = peak + np.arange(-LOBE, LOBE + 1)
        power = float(powers[lobe].sum())
        place = float(lobe @ powers[lobe]) / power if power > 0.0 else math.inf
        if abs(place / whole - orders[number]) > tolerance[number]:
            continue
        # Each of the lines within the lobe of each order could have been the peak.
        trials = (2 * LOBE + 1) * orders.size
        if float(false_probability(contrast(powers, np.array([peak])))[0]) * trials > FALSE_LINE:
            continue
        if not is_one_sine(even, powers, peak, place):
            continue
        if power < KEPT * _steady_power(body, turns, whole, period, orders[number] * rpm / 60.0):
            continue
        if best is None or power > best[0]:
            best = power, float(orders[number])
    if best is None:
        return None
    own, ratio, name = attributed(known[best[1]])
    return OrderName(own, name, ratio * rpm)


@dataclass(frozen=True, slots=True)
class OrderLine:
    """Line of an order spectrum.

    ``order`` per revolution of the measured shaft, mean peak accelerations ``body`` and ``spool`` in m/s^2,
    and the speed (rev/min) at which the spool's was highest; ``component``: name of the one that is known to
    shake with this order, empty where none or several are.
    """

    order: float
    body: float
    spool: float
    loudest_rpm: float
    component: str = ""


@dataclass(frozen=True, slots=True)
class OrderSpectrum:
    """Mean spectrum over angle; its arrays have shape (lines,).

    Attributes:
        order: per revolution, ``1 / TURNS`` apart.
        body, spool: power, (m/s^2)^2; the lines of a sine add up to half its amplitude squared.
        lines: that noise does not show (``FALSE_LINE``, over all orders).
        slowest, fastest: rev/min in what was used.
        fault: code of why some of the record, or all of it, was not used; empty for nothing.
    """

    order: Array
    body: Array
    spool: Array
    lines: tuple[OrderLine, ...] = ()
    slowest: float = math.nan
    fastest: float = math.nan
    fault: str = ""


def order_spectrum(
    stretches: Iterable[tuple[int, float, Array, Array]],
    speeds: Sequence[tuple[int, float]],
    components: Sequence[Component] = (),
) -> OrderSpectrum:
    """Return the spectrum over angle of all pieces of ``TURNS`` revolutions that overlap by half.

    Args:
        stretches: stamp (ns), period (s), body and spool (m/s^2, shape (n,)) of what has no gap.
        speeds: stamps (ns) and rev/min, by stamp.
        components: what turns with the shaft.
    """
    known = candidates(components)
    found: list[tuple[float, Array]] = []
    fault = "" if speeds else "speed_stale"
    stamps = np.array([stamp for stamp, _ in speeds], dtype=np.int64)
    values = np.array([rpm for _, rpm in speeds], dtype=np.float64)
    for start, period, body, spool in stretches:
        inside = np.flatnonzero((stamps >= start) & (stamps <= start + body.size * period * 1e9))
        faulty = [speed_fault(speeds[at : at + 2], speeds[at][0]) for at in inside[:-1]]
        fault = next(filter(None, faulty), fault)
        for run in np.split(inside, np.flatnonzero([bool(one) for one in faulty]) + 1):
            if run.size < 2:
                continue
            times: Array = np.asarray((stamps[run] - start) * 1e-9, dtype=np.float64)
            rpm = values[run]
            part = slice(math.ceil(times[0] / period), math.floor(times[-1] / period) + 1)
            both = np.stack((body[part], spool[part]))
            time = period * np.arange(part.start, part.start + both.shape[1])
            turns = revolutions(time, times, rpm)
            for last in np.arange(TURNS, turns[-1], 0.5 * TURNS):
                piece = slice(np.searchsorted(turns, last - TURNS), np.searchsorted(turns, last) + 1)
                powers = line_powers(by_angle(both[:, piece], turns[piece], min(TURNS, np.ptp(turns[piece]))))
                speed = float(np.interp(time[piece], times, rpm).mean())
                found.append((speed, powers[:, : MOST_ORDERS * TURNS]))
    if not found:
        return OrderSpectrum(np.zeros(0), np.zeros(0), np.zeros(0), fault=fault or "order_unknown")
    size = min(powers.shape[1] for _, powers in found)
    every = np.stack([powers[:, :size] for _, powers in found])
    mean = every.mean(axis=0)
    places = np.arange(REACH + LOBE, size - REACH - LOBE, dtype=np.int64)
    # What does not follow the shaft lies elsewhere in each piece: half of them must show a line. Every other
    # piece is independent.
    half = np.sort([contrast(row, places) for row in every[:, 0]], axis=0)[(len(found) - 1) // 2]
    apart = (len(found) + 1) // 2
    false = scipy.stats.binom.sf((apart + 1) // 2 - 1, apart, false_probability(half))
    sure = false * places.size <= FALSE_LINE
    peaks = [at for at in places[sure] if mean[0, at] == mean[0, at - LOBE : at + LOBE + 1].max()]
    lines = []
    for peak in peaks:
        lobe = peak + np.arange(-LOBE, LOBE + 1)
        size_of = np.sqrt(2.0 * mean[:, lobe].sum(axis=1))
        loudest = found[int(np.argmax(every[:, 1, lobe].sum(axis=1)))][0]
        place = float(lobe @ mean[0, lobe] / mean[0, lobe].sum())
        order = min(known, key=lambda one: abs(one - place / TURNS))
        on_it = abs(order - place / TURNS) <= 0.5 / TURNS + SPEED_ERROR * order
        name = attributed(known[order])[2] if on_it else ""
        lines.append(OrderLine(place / TURNS, float(size_of[0]), float(size_of[1]), loudest, name))
    rpms = [rpm for rpm, _ in found]
    return OrderSpectrum(np.arange(size) / TURNS, mean[0], mean[1], tuple(lines), min(rpms), max(rpms), fault)


def _steady_power(body: Array, turns: Array, whole: float, period: float, frequency: float) -> float:
    """Return the power of the strongest line over time within ``BESIDE`` of ``frequency`` (Hz)."""
    part = body[np.searchsorted(turns, turns[-1] - whole) :]
    powers = line_powers(part)
    step = 1.0 / (part.size * period)
    low, high = (round((frequency + side * BESIDE) / step) for side in (-1.0, 1.0))
    low, high = max(LOBE, low), min(powers.size - LOBE - 1, high)
    if high < low:
        return 0.0
    peak = low + int(np.argmax(powers[low : high + 1]))
    return float(powers[peak - LOBE : peak + LOBE + 1].sum())
