"""What both channels show second by second: levels, faults, and the response of the spool.

The rules are those for records: :mod:`spool_estimator.identification.channel_faults`.

H(f) = g (w0^2 + j w d) / (w0^2 - w^2 + j w d),   w = 2 pi f

w0^2 = k/m and d = c/m (dry friction counts as the drag that takes as much energy), g the spool's sensitivity
over the body's. Fitted to cross-spectra as output error: sum of abs(S - H B)^2 over lines and windows.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from spool_core.block import Samples
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array, Complex
from spool_estimator.identification.channel_faults import (
    ChannelFault,
    PairLook,
    faults_of_rows,
    flat_top,
    look_at_pair,
)

from spool_monitor.parameter_drift import GAIN_ERROR
from spool_monitor.window import SignalWindow

#: s before a standstill in which a channel's span is looked at: half a period of 5 Hz.
BEFORE = 0.1

#: Hz, the band of the spectra; the upper end is 0.4 of the sample rate where that is less.
BAND = (3.0, 200.0)

#: s of samples that are kept, and that the samples themselves are looked at every so often.
KEPT, ROWS = 8.0, 2.0
#: s from one look at the pair to the next: as a rule, where the last one found something, and where the model
#: suddenly leaves more; looks of the latter kind in a row, after which it is as a rule again.
USUALLY, FOUND, URGENT, MOST_URGENT = 60.0, 2.0, 1.0, 10
#: Growth of the estimator's residual over its usual value that makes a look urgent, and its usual pace.
GROWN, PACE = 1.5, 0.02

#: s, time constant of forgetting of the spectra, and windows before the first fit.
MEMORY, FIRST = 2.0, 4
_STEPS = 4


class Channel(NamedTuple):
    """Channel in a window: ``mean`` and ``rms`` (about the mean) in m/s^2.

    ``flat_top`` is the share of samples that lie on a flat top at the upper or lower extreme, 0 where the
    extremes are those of a wave. ``standing`` (s) is how long the newest sample has not changed, at most the
    window's length, which ``constant`` says; ``step`` (m/s^2) is the smallest change between two samples, NaN
    where none changes, and ``before`` (m/s^2) the span of the last samples before ``standing``, NaN where
    they are not in the window.
    """

    mean: float
    rms: float
    flat_top: float
    constant: bool
    standing: float = 0.0
    step: float = math.nan
    before: float = math.nan


class Signals(NamedTuple):
    """Signals of both channels in the window that ends at ``stamp`` (ns, newest sample).

    ``frequency`` (Hz), ``body_power``, ``spool_power`` ((m/s^2)^2 per line) and ``cross`` (spool times
    conjugate of body) have shape (lines,); the powers of a stationary signal add to its mean square, which
    ``body_total`` and ``spool_total`` are.

    ``relative_rms`` (m/s^2) and ``relative_velocity`` (m/s rms) are of the spool in the body within the band.
    ``dissipation``, 1/s, is the damping that the energy of that motion shows: power Re(S conj(V)) over
    -abs(V)^2, V = (S - B) / (j w) being the relative velocity. It is negative where the channels can't belong
    to a passive valve, 0 where they have nothing in common, NaN where nothing moves.
    """

    stamp: int
    body: Channel
    spool: Channel
    frequency: Array
    body_power: Array
    spool_power: Array
    body_total: float
    spool_total: float
    cross: Complex
    relative_rms: float
    relative_velocity: float
    dissipation: float


def look(window: SignalWindow) -> Signals:
    """Return what the channels show in ``window``."""
    size = window.samples.shape[1]
    high = min(size // 2, math.floor(min(BAND[1] / window.step, 0.4 * size)))
    low = min(max(1, math.ceil(BAND[0] / window.step)), high)  # a slow channel shows no line of the band
    # Mean square by Parseval: two-sided, the taper's energy taken out.
    scale = 2.0 / (size * window.energy)
    frequency, body, spool, cross, sums = spectra(window.spectrum, low, high + 1, window.step, scale)
    relative, squared, work = sums
    return Signals(
        stamp=window.stamp,
        body=_channel(window.samples[0], window.means[0], 1.0 / (window.step * size)),
        spool=_channel(window.samples[1], window.means[1], 1.0 / (window.step * size)),
        frequency=frequency,
        body_power=body,
        spool_power=spool,
        body_total=float(np.add.reduce(body)),
        spool_total=float(np.add.reduce(spool)),
        cross=cross,
        relative_rms=math.sqrt(relative),
        relative_velocity=math.sqrt(squared),
        dissipation=-work / squared if squared > 0.0 else math.nan,
    )


@compiled
def spectra(
    spectrum: Complex, first: int, last: int, step: float, scale: float
) -> tuple[Array, Array, Array, Complex, tuple[float, float, float]]:
    """Return frequency, powers of body and spool and cross-power of the lines from ``first`` before ``last``.

    And sums over them: of the relative acceleration's power, of the relative velocity's, and of the power
    that the relative motion gives, per mass.
    """
    count = last - first
    frequency, body, spool = np.empty(count), np.empty(count), np.empty(count)
    cross = np.empty(count, np.complex128)
    relative = squared = work = 0.0
    for i in range(count):
        one, other = spectrum[0, first + i], spectrum[1, first + i]
        frequency[i] = (first + i) * step
        body[i] = scale * (one.real**2 + one.imag**2)
        spool[i] = scale * (other.real**2 + other.imag**2)
        cross[i] = scale * (other * one.conjugate())
        power = scale * ((other.real - one.real) ** 2 + (other.imag - one.imag) ** 2)
        w = 2.0 * math.pi * frequency[i]
        relative += power
        squared += power / w**2
        work += cross[i].imag / w
    return frequency, body, spool, cross, (relative, squared, work)


@compiled
def levels(samples: Samples, mean: float) -> tuple[float, float, int, float]:
    """Return mean square about ``mean``, share of samples on flat tops, and how samples change.

    That is how many of the newest ones equal the one before them, and the smallest change, NaN for none.
    """
    low = high = np.float64(samples[0])
    square = 0.0
    standing = -1
    step = math.inf
    previous = low
    for sample in samples:
        value = np.float64(sample)
        if value == previous:
            standing += 1
        else:
            standing = 0
            step = min(step, abs(value - previous))
        previous = value
        low, high = min(low, value), max(high, value)
        square += (value - mean) ** 2
    flat = 0.0
    if high > low:
        half = 0.5 * (high - low)
        flat = flat_top(samples, high, half) + flat_top(samples, low, -half)
    return square / samples.size, flat, standing, step if high > low else math.nan


class ChannelLook(NamedTuple):
    """Look at the channels at ``stamp`` (ns).

    ``rows`` are the faults that the samples themselves show; ``pair`` is what both channels show of each
    other, ``None`` where it was not looked at or cannot be judged; ``paired`` says whether it was looked at.
    """

    stamp: int
    rows: tuple[ChannelFault, ...]
    pair: PairLook | None
    paired: bool

    def fault(self, cause: str, channel: str = "") -> ChannelFault | None:
        """Return the fault of this ``cause``, ``None`` where it is not seen; ``channel``: only of that."""
        pair = self.pair.fault if self.pair is not None else None
        found = (one for one in (*self.rows, pair) if one is not None and one.cause == cause)
        return next((one for one in found if channel in ("", one.channel)), None)


@dataclass(slots=True)
class ChannelWatch:
    """Channel watch of one valve: takes its windows, says what the channels show; bounded in memory."""

    _kept: deque[Samples] = field(default_factory=deque, init=False)
    _period: float = field(default=0.0, init=False)
    _hop: int = field(default=0, init=False)
    _count: int = field(default=0, init=False)
    _rows_at: int = field(default=0, init=False)
    _pair_at: int = field(default=0, init=False)
    _due: float = field(default=KEPT, init=False)
    _usual: float = field(default=float("nan"), init=False)
    _urgent: int = field(default=0, init=False)

    def restart(self, period: float) -> None:
        """Forget all samples; the next ones are ``period`` s apart."""
        self._kept.clear()
        self._period, self._count, self._rows_at, self._pair_at, self._due = period, 0, 0, 0, KEPT

    def take_residual(self, residual: float) -> None:
        """Take what the estimator's model leaves, relative; more than usual makes the next look urgent."""
        if not residual > 0.0:
            return
        if not self._usual > 0.0 or residual < self._usual:
            self._usual = residual
        if residual > GROWN * self._usual:
            if self._urgent < MOST_URGENT:
                self._due = min(self._due, URGENT)
        else:
            self._urgent = 0
        self._usual += PACE * (residual - self._usual)

    def update(self, window: SignalWindow, hop: int) -> ChannelLook | None:
        """Take a window, whose newest ``hop`` samples are new; return a look where one is due."""
        # The first window is new as a whole.
        fresh = window.samples[:, -hop:] if self._kept else window.samples
        self._kept.append(fresh.copy())
        self._count += fresh.shape[1]
        while (self._count - self._kept[0].shape[1]) * self._period >= KEPT:
            self._count -= self._kept.popleft().shape[1]
        rows_due = self._rows_at == 0 or window.stamp - self._rows_at >= ROWS * 1e9
        since = 1e-9 * (window.stamp - self._pair_at) if self._pair_at else self._count * self._period
        pair_due = since >= self._due and self._count * self._period >= KEPT - 1e-6
        if not rows_due and not pair_due:
            return None
        body, spool = np.concatenate(self._kept, axis=1).astype(np.float64)
        self._rows_at = window.stamp
        rows = tuple(faults_of_rows(body, spool, self._period))
        pair = None
        paired = pair_due and not rows
        if paired:
            pair = look_at_pair(body, spool, self._period, -self._count * self._period)
            found = pair is not None and pair.fault is not None and pair.fault.cause != "delay"
            self._urgent = self._urgent + 1 if self._due == URGENT else 0
            self._pair_at, self._due = window.stamp, FOUND if found else USUALLY
        return ChannelLook(window.stamp, rows, pair, paired)


@dataclass(frozen=True, slots=True)
class ValveResponse:
    """``natural_frequency`` (Hz), ``damping`` d (1/s), ``gain`` g with its deviation (1).

    ``misfit``: rms of what the fit leaves over that of the spool. ``bend``: most by which as much again,
    taken for a response, changes the gain (Cauchy-Schwarz inequality).
    """

    natural_frequency: float
    damping: float
    gain: float
    gain_deviation: float
    misfit: float
    bend: float

    @property
    def square(self) -> float:
        """w0^2, 1/s^2."""
        return (2.0 * math.pi * self.natural_frequency) ** 2

    def transfer(self, frequency: float) -> complex:
        """Return H without the gain at ``frequency`` (Hz)."""
        return transfer(frequency, self.square, self.damping)


#: s over which a change of the gain is smoothed, and for which one must last.
GAIN_SMOOTHED, GAIN_LASTS = 5.0, 20.0
#: Change of the gain, beyond what a valve makes, that is a sensor's if it lasts: three standard deviations
#: between accelerometers of one make.
SLOW = 3.0 * GAIN_ERROR
#: Share of the healthy gain that may be bent at most: accelerometers are calibrated better than that.
BENDS = 0.3


@dataclass(slots=True)
class GainChange:
    """Relative change of the spool's gain over the body's, against its start value.

    Dry friction and all else that no linear response explains bend the gain, by a share of the response's
    ``bend`` that stays: what some share makes of both gains is let pass. So is the change of w0^2, as above
    resonance only the product of gain and w0^2 shows. A sensor that ages scales gain and ``bend`` alike.

    Attributes:
        change: smoothed; NaN while the record does not show it.
        beyond: what of it no operating point and no valve explains, 0 while unknown.
        unseen: whether the excitation, as a single tone, shows no gain.
    """

    change: float = field(default=math.nan, init=False)
    beyond: float = field(default=0.0, init=False)
    unseen: bool = field(default=False, init=False)
    _passes: float = field(default=math.nan, init=False)
    _last: int = field(default=0, init=False)

    @property
    def bends(self) -> bool:
        """Whether it may be the sensor's, which explains part of any change of the valve."""
        return self.beyond >= 0.5 * SLOW

    @property
    def breaks(self) -> bool:
        """Whether it is the sensor's if it lasts: what was reported of the valve was none."""
        return self.beyond >= SLOW

    def update(self, stamp: int, response: ValveResponse | None, *start: float) -> None:
        """Take the response at ``stamp`` (ns), ``None`` for no gain; ``start``: as learned, NaN before."""
        gain, bend, natural_frequency = start
        if response is None or math.isnan(sum(start)):
            self.change, self.beyond = math.nan, 0.0
            return
        change, most = response.gain / gain - 1.0, BENDS * gain / max(BENDS * gain, bend)
        low, high = ((response.gain - s * response.bend) / (gain - s * bend) - 1.0 for s in (-most, most))
        passes = abs(change) - (min(abs(low), abs(high)) if low * high > 0.0 else 0.0)
        passes += 2.0 * abs(math.log(response.natural_frequency / natural_frequency))
        if math.isnan(self.change) or stamp < self._last:
            self.change, self._passes, self._last = change, passes, stamp
        share, self._last = 1.0 - math.exp((self._last - stamp) * 1e-9 / GAIN_SMOOTHED), stamp
        self.change += share * (change - self.change)
        self._passes += share * (passes - self._passes)
        self.beyond = max(0.0, abs(self.change) - self._passes)


@compiled
def transfer(frequency: float, square: float, damping: float) -> complex:
    """Return spool over body acceleration at ``frequency`` (Hz) for w0^2 and d, without the gain."""
    w = 2.0 * math.pi * frequency
    follows = complex(square, w * damping)
    return follows / (follows - w * w)


@compiled
def due_power(frequency: Array, body: Array, square: float, damping: float) -> float:
    """Return the power that the reference response makes of the body's, per line, in the relative motion."""
    due = 0.0
    for i in range(frequency.size):
        due += body[i] * abs(transfer(frequency[i], square, damping) - 1.0) ** 2
    return due


@dataclass(slots=True)
class ResponseTracker:
    """Follows the response over the last few windows."""

    _weight: float = field(default=0.0, init=False)
    _body: Array = field(default_factory=lambda: np.zeros(0), init=False)
    _spool: Array = field(default_factory=lambda: np.zeros(0), init=False)
    _cross: Complex = field(default_factory=lambda: np.zeros(0, np.complex128), init=False)
    _stamp: int = field(default=0, init=False)
    _count: int = field(default=0, init=False)

    def restart(self) -> None:
        """Forget the spectra."""
        self._count = 0
        self._weight = 0.0
        self._body = np.zeros(0)

    def update(self, signals: Signals, start: ValveResponse) -> ValveResponse | None:
        """Take a window; return the fit found from ``start``, ``None`` while there are too few windows."""
        if self._body.size != signals.frequency.size:
            self.restart()
            self._body = np.zeros(signals.frequency.size)
            self._spool = np.zeros(signals.frequency.size)
            self._cross = np.zeros(signals.frequency.size, np.complex128)
            self._stamp = signals.stamp
        seconds = max(0.0, (signals.stamp - self._stamp) * 1e-9)
        self._stamp = signals.stamp
        keep = math.exp(-seconds / MEMORY)
        self._body = keep * self._body + signals.body_power
        self._spool = keep * self._spool + signals.spool_power
        self._cross = keep * self._cross + signals.cross
        self._weight = keep * self._weight + 1.0
        self._count += 1
        if self._count < FIRST:
            return None
        frequency, spool = signals.frequency, float(self._spool.sum())
        if not spool > 0.0 or not float(self._body.sum()) > 0.0:
            return None
        first = np.array([math.log(start.square), math.log(max(start.damping, 1e-3)), 1.0])
        theta, variance, gained = descend(frequency, self._body, self._cross, first)
        cost = max(spool - gained, 1e-12 * spool)
        # Windows overlap by half: about 0.6 of them are independent, each line of a Hann taper spans 1.5.
        independent = max(4.0, 0.4 * self._weight * frequency.size)
        logarithmic_square, logarithmic_damping, gain = theta.tolist()
        most = math.sqrt(max(0.0, variance * cost))
        return ValveResponse(
            natural_frequency=math.exp(0.5 * logarithmic_square) / (2.0 * math.pi),
            damping=math.exp(logarithmic_damping),
            gain=gain,
            gain_deviation=most * math.sqrt(max(1.0, self._weight) / independent),
            misfit=math.sqrt(cost / spool),
            bend=most,
        )


@compiled
def descend(frequency: Array, body: Array, cross: Complex, start: Array) -> tuple[Array, float, float]:
    """Return log(w0^2), log(d) and g that fit ``cross`` = H ``body`` after some Gauss-Newton steps.

    And, at the last step, the variance of g for errors of variance 1 (infinite where nothing tells it) and
    what the fit takes off the spool's power.
    """
    theta = start.copy()
    normal, right = np.zeros((3, 3)), np.zeros(3)
    columns = np.zeros(3, np.complex128)
    gained = 0.0
    for _ in range(_STEPS):
        square, damping, gain = math.exp(theta[0]), math.exp(theta[1]), theta[2]
        normal[:] = 0.0
        right[:] = 0.0
        gained = 0.0
        for n in range(frequency.size):
            w = 2.0 * math.pi * frequency[n]
            follows = complex(square, w * damping)
            lower = follows - w * w
            inverse = lower.conjugate() * (1.0 / (lower.real**2 + lower.imag**2))
            shape = follows * inverse
            # d/d follows of follows / (follows - w^2)
            slope = -w * w * inverse * inverse
            columns[0] = gain * slope * square
            columns[1] = gain * slope * complex(0.0, w * damping)
            columns[2] = shape
            model = gain * shape
            rest = cross[n] - model * body[n]
            gained += (model.conjugate() * (cross[n] + rest)).real
            for i in range(3):
                right[i] += (columns[i].conjugate() * rest).real
                for j in range(i + 1):
                    normal[i, j] += body[n] * (columns[i].conjugate() * columns[j]).real
        for i in range(3):
            for j in range(i):
                normal[j, i] = normal[i, j]
        damped = normal + 1e-9 * np.trace(normal) * np.eye(3)
        step = np.linalg.solve(damped, right)
        for i in range(3):
            theta[i] += min(0.3, max(-0.3, step[i]))
        for i in range(2):
            theta[i] = min(25.0, max(-5.0, theta[i]))
    # The last element of the inverse of the normal matrix.
    minor = normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2
    both = normal[0, 2] ** 2 * normal[1, 1] + normal[1, 2] ** 2 * normal[0, 0]
    whole = normal[2, 2] * minor - both + 2.0 * normal[0, 1] * normal[0, 2] * normal[1, 2]
    return theta, minor / whole if whole > 0.0 else math.inf, gained


def _channel(samples: Samples, mean: float, period: float) -> Channel:
    square, flat, standing, step = levels(samples, mean)
    changing, count, before = samples.size - 1 - standing, round(BEFORE / period), math.nan
    if standing and changing >= count:
        before = float(np.ptp(samples[changing - count : changing]))
    constant = standing == samples.size - 1
    return Channel(mean, math.sqrt(square), flat, constant, standing * period, step, before)
