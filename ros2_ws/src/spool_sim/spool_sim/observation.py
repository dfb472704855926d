"""What a data logger reads of a motion: each channel passes a low-pass before it is sampled.

Dry friction makes the spool's acceleration jump. The low-pass smears each jump over some samples and lets it
ring; the acceleration at the instant of a sample is another number. A simulation that locates its jumps and
kinks adds to its points what the low-pass makes of each, from a table: the band-limited steps of sound
synthesis. The smooth rest passes the low-pass in the frequency domain.

Sources: Stilson and Smith, Alias-free digital synthesis of classic analog waveforms, 1996; Brandt, Hard sync
without aliasing, 2001.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy  # its parts are loaded when they are first used
from numpy import fft
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array

Spectrum = NDArray[np.complex128]

INSTANTS, MEAN, LINEAR, CAUSAL = "instants", "mean", "linear", "causal"
#: Steps before and after an event that a table reaches, its points in a step, and steps that it is made over.
REACH, FINE, SPAN = 32, 32, 256
#: Corner (over the rate of the steps) and order of the low-pass that keeps points free of aliases: flat below
#: the corners of loggers, and a hundredth at half the rate.
SHARP, SHARP_ORDER = 0.44, 36
#: Shapes of causal low-passes: Bessel's, and Chebyshev's of order 8 with 0.5 dB of ripple.
SHAPES = (-1.0, 1.5)
#: Samples beyond both ends that the low-pass sees.
EDGE = 64


@dataclass(frozen=True, slots=True)
class Observation:
    """How a channel is read.

    Attributes:
        kind: ``instants``; ``mean`` over a sample; ``linear``: low-pass without phase; ``causal``: one of
            which poles stand for, whose delay of slow motion is taken off.
        order: of the low-pass, whose gain is 1 / (1 + (f / corner)^(2 order)), its root for ``causal``: there
            a whole number.
        corner: over the sample rate.
        body_corner: of the body's channel, if it has another one than the spool's.
        shape: of ``causal``, if not Butterworth's (0): -1 is Bessel's, above 0 Chebyshev's (first kind).
    """

    kind: str = INSTANTS
    order: float = 0.0
    corner: float = math.inf
    body_corner: float | None = None
    shape: float | None = None

    def of_body(self) -> Observation:
        """Return how the body's channel is read."""
        return self if self.body_corner is None else replace(self, corner=self.body_corner, body_corner=None)

    @classmethod
    def of(cls, text: str) -> Observation:
        """Return the reading of ``text``: a kind, ``KIND,ORDER,CORNER``, for ``causal`` also ``,SHAPE``.

        Raises:
            InputError: unknown kind, or numbers that no filter has.
        """
        kind, *rest = (part.strip() for part in text.split(","))
        with contextlib.suppress(ValueError, StopIteration):
            usual = next(one for one in USUAL_ONES if one.kind == kind)
            if not rest:
                return usual
            order, corner, *more = (float(part) for part in rest)
            whole = kind != CAUSAL or order % 1.0 == 0.0
            if usual.order and 1.0 <= order <= 24.0 and 0.05 <= corner <= 0.5 and whole:
                if not more:
                    return cls(kind, order, corner)
                (shape,) = more
                if kind == CAUSAL and SHAPES[0] <= shape <= SHAPES[1]:
                    return cls(kind, order, corner, shape=shape)
        raise InputError(
            f"filter: {text!r}: use {INSTANTS}, {MEAN}, {LINEAR} or {CAUSAL}; the last two may have order (1 "
            f"to 24, whole for {CAUSAL}) and corner (0.05 to 0.5 of the sample rate), like {LINEAR},6,0.42; "
            f"{CAUSAL} also a shape ({SHAPES[0]:g}: Bessel, 0: Butterworth, up to {SHAPES[1]:g}: Chebyshev)"
        )

    def __str__(self) -> str:
        """Return the text that ``of`` takes."""
        numbers = (self.order, self.corner, self.shape) if self.order else ()
        return ",".join([self.kind, *(f"{one:g}" for one in numbers if one is not None)])

    def sentence(self, rate: float) -> str:
        """Describe the reading at sample ``rate``, Hz, in words."""
        corner = f", corner {self.corner * rate:.4g} Hz"
        if self.body_corner is not None:
            corner += f" (body: acts like {self.body_corner * rate:.4g} Hz)"
        shape = self.shape or 0.0
        family = "Butterworth" if abs(shape) < 0.5 else "Bessel" if shape < 0.0 else "Chebyshev"
        return {
            INSTANTS: "none: samples at instants",
            MEAN: "mean over each sample",
            LINEAR: f"low-pass without phase, order {self.order:.2g}{corner}",
            CAUSAL: f"{family} low-pass, order {self.order:.2g}{corner}",
        }[self.kind]

    def response(self, frequency: Array) -> Spectrum:
        """Return the factor on the spectrum at ``frequency``, over the sample rate."""
        if self.kind == INSTANTS:
            return np.ones(frequency.size, dtype=np.complex128)
        if self.kind == MEAN:
            return np.sinc(frequency).astype(np.complex128)
        ratio = frequency / self.corner
        if self.kind == LINEAR:
            return (1.0 / (1.0 + ratio ** (2 * self.order))).astype(np.complex128)
        poles = poles_of(int(self.order), self.shape or 0.0)
        found: Spectrum = np.exp(1j * ratio * float(np.sum((-1.0 / poles).real)))
        for pole in poles:
            found /= 1.0 - 1j * ratio / pole
        return found

    def read(
        self, points: Array, events: Array, every: int, delay: float = 0.0, gains: Spectrum | None = None
    ) -> Array:
        """Return what the channel reads at its samples, shape (n,), unit of ``points``.

        Args:
            points: acceleration at each step, shape (n every,).
            events: rows of place (steps), jump and change of the rate (over a step), shape (e, 3).
            every: steps in a sample.
            delay: of the reading, samples.
            gains: further factors on the spectrum at ``lines_of(n, every)``.
        """
        samples = points.size // every
        if not math.isfinite(points[-1]):  # the motion diverged
            return np.full(samples, math.inf)
        if self.kind == INSTANTS and delay == 0.0 and gains is None:
            return points[::every].copy()
        dense = self._dense(points, events, every)
        edge = min(dense.size - 1, EDGE * every)
        fade = np.sin(0.5 * np.pi * (np.arange(edge) + 0.5) / edge) ** 2
        before, after = 2.0 * dense[0] - dense[edge:0:-1], 2.0 * dense[-1] - dense[-2 : -edge - 2 : -1]
        padded = np.concatenate([before * fade, dense, after * fade[::-1]])
        lines = fft.rfft(padded, _length(samples, every))
        lines *= _response(self, samples, every)
        if delay != 0.0:
            lines *= _late(delay, samples, every)
        if gains is not None:
            lines *= gains
        found = np.array(fft.irfft(lines, _length(samples, every))[edge : edge + dense.size : every])
        self._add_rest(found, events, every, delay)
        return found

    def _dense(self, points: Array, events: Array, every: int) -> Array:
        """Return ``points`` with jumps and kinks free of aliases."""
        dense = points.copy()
        add_events(dense, events, *tables_of(self, every)[0], 1, 0.0, 1.0)
        return dense

    def _add_rest(self, row: Array, events: Array, every: int, delay: float) -> None:
        """Add to the samples what the channel reads of jumps and kinks beyond its factor on ``_dense``."""
        free, rest = tables_of(self, every)
        if self.kind == INSTANTS:  # a jump itself: a table would smear it over the samples next to it
            add_events(row, events, -free[0], -free[1], every, delay * every, -1.0)
        else:
            add_events(row, events, *rest, every, delay * every, 0.0)


#: What a kind alone stands for: filters as good loggers have them.
USUAL_ONES = (
    Observation(), Observation(MEAN), Observation(LINEAR, 6.0, 0.42), Observation(CAUSAL, 4.0, 0.36),
)  # fmt: skip


class Stream:
    """Observation of a motion that comes in pieces; it stands still before them.

    Attributes:
        lead: samples by which the readings are behind the motion.
    """

    def __init__(self, observation: Observation, every: int, delay: float = 0.0) -> None:
        """Begin; ``every`` and ``delay`` as :meth:`Observation.read` takes them."""
        self.lead = EDGE + math.ceil((REACH + 1) / every)
        self._how, self._every, self._delay = observation, every, delay
        frequency = np.asarray(fft.rfftfreq(2 * EDGE * every, 1.0 / every))
        response = observation.response(frequency) * np.exp(-2j * np.pi * frequency * delay)
        self._taps = fft.fftshift(fft.irfft(response, 2 * EDGE * every))[::-1].copy()
        self._points: Array = np.zeros(2 * self.lead * every)
        self._events: Array = np.zeros((0, 3))

    def take(self, points: Array, events: Array) -> Array:
        """Return the readings of as many samples as there are new ``points``, the first ``lead`` too early.

        Args:
            points, events: as :meth:`Observation.read` takes them.
        """
        every, held = self._every, self._points.size
        samples = points.size // every
        self._points = np.append(self._points, points)
        self._events = np.vstack([self._events, events + np.array([held, 0.0, 0.0])])
        dense = self._how._dense(self._points, self._events, every)
        first = (self.lead - EDGE) * every + 1  # of the steps that the first sample is made of
        rows = sliding_window_view(dense[first:], self._taps.size)[::every][:samples]
        found: Array = np.zeros(self.lead + samples)
        found[self.lead :] = rows @ self._taps
        self._how._add_rest(found, self._events, every, self._delay)
        self._points = self._points[points.size :]
        self._events = self._events[self._events[:, 0] >= points.size] - np.array([points.size, 0.0, 0.0])
        return found[self.lead :]


@lru_cache(maxsize=512)
def poles_of(order: int, shape: float) -> Spectrum:
    """Return the poles of a causal low-pass with half the power at 1, shape (order,).

    From Butterworth's, on a circle, they go to an ellipse as Chebyshev's (first kind) for a ``shape`` above
    0, and towards Bessel's below it (Peless and Murakami, Analysis and synthesis of transitional
    Butterworth-Thomson filters, 1957).
    """
    poles: Spectrum = np.exp(0.5j * np.pi * (2 * np.arange(order) + order + 1) / order)
    if shape > 0.0:
        poles = math.exp(-shape) * poles.real + 1j * poles.imag
    elif shape < 0.0:
        row = [math.factorial(2 * order - n) / (2.0**-n * math.factorial(n) * math.factorial(order - n))
               for n in range(order, -1, -1)]  # fmt: skip
        bessel = np.roots(row)
        bessel = bessel[np.argsort(-bessel.imag)]
        poles = poles * (bessel / poles) ** -shape
    largest = float(np.abs(poles).max())
    low, high = 0.1 * largest, 4.0 * largest
    for _ in range(5):
        frequency = np.linspace(low, high, 64)
        power = np.abs(np.prod(1.0 - 1j * frequency / poles[:, np.newaxis], axis=0)) ** 2
        above = int(np.argmax(power > 2.0))
        low, high = frequency[above - 1 : above + 1].tolist()
    return np.asarray(poles / high)


@lru_cache(maxsize=64)
def lines_of(samples: int, every: int) -> Array:
    """Return the frequencies, over the sample rate, at which ``read`` takes further factors."""
    return np.asarray(fft.rfftfreq(_length(samples, every), 1.0 / every))


@lru_cache(maxsize=64)
def tables_of(observation: Observation, every: int) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return what a jump and a kink become, in two stages: (step, ramp) each, at ``1 / FINE`` of a step.

    The first one makes points free of aliases; the second is what the channel reads beyond its factor on
    such points.
    """
    frequency, sharp, free = _sharp()
    return free, _integrals(observation.response(frequency * every) * (1.0 - sharp))


@lru_cache(maxsize=1)
def _sharp() -> tuple[Array, Array, tuple[Array, Array]]:
    """Return frequencies over the rate of the steps, the response of the first stage, and its tables."""
    frequency = np.asarray(fft.rfftfreq(SPAN * FINE, 1.0 / FINE))
    sharp = 1.0 / (1.0 + (frequency / SHARP) ** SHARP_ORDER)
    return frequency, sharp, _integrals(sharp.astype(np.complex128))


def _integrals(response: Spectrum) -> tuple[Array, Array]:
    """Return step and ramp of a response, from ``-REACH`` to ``REACH`` steps."""
    pulse = fft.fftshift(fft.irfft(response, SPAN * FINE))
    step = np.cumsum(pulse) - 0.5 * pulse  # a pulse stands for the time half a point before and after it
    ramp = (np.cumsum(step) - 0.5 * step) / FINE
    middle = SPAN * FINE // 2
    part = slice(middle - REACH * FINE, middle + REACH * FINE + 2)
    return step[part].copy(), ramp[part].copy()


@lru_cache(maxsize=16)  # each as long as a record
def _response(observation: Observation, samples: int, every: int) -> Spectrum:
    return observation.response(lines_of(samples, every))


@lru_cache(maxsize=16)  # of a batch most sets have one delay
def _late(delay: float, samples: int, every: int) -> Spectrum:
    return np.asarray(np.exp(-2j * np.pi * delay * lines_of(samples, every)))


@lru_cache(maxsize=64)
def _length(samples: int, every: int) -> int:
    dense = samples * every
    return int(scipy.fft.next_fast_len(dense + 2 * min(dense - 1, EDGE * every), real=True))


@compiled
def add_events(
    row: Array, events: Array, step: Array, ramp: Array, every: int, late: float, ideal: float
) -> None:
    """Add to ``row`` (n,), whose values are ``every`` steps apart, what the tables make of each event.

    ``late``: steps by which the row is late; ``ideal``: 1 to take off the jump that the row has, else 0.
    """
    for e in range(events.shape[0]):
        place = events[e, 0] + late
        first = max(0, math.ceil((place - REACH) / every))
        last = min(row.size - 1, math.floor((place + REACH) / every))
        for n in range(first, last + 1):
            after = n * every - place
            x = (after + REACH) * FINE
            i = int(x)
            w = x - i
            there = ideal if after >= 0.0 else 0.0
            row[n] += events[e, 1] * ((1.0 - w) * step[i] + w * step[i + 1] - there)
            row[n] += events[e, 2] * ((1.0 - w) * ramp[i] + w * ramp[i + 1] - there * after)
