"""Nuisances of a measuring chain: what they do to a reading, and which of them a record carries."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfftfreq
from scipy.signal import bilinear, butter, ellip, fftconvolve, firwin, lfilter, sosfilt, sosfreqz

Array = NDArray[np.float64]
Generator = np.random.Generator

BODY, SPOOL, BOTH = "body", "spool", "both"
CHANNELS = (BODY, SPOOL)

#: s, delay of a filter in one channel at most that is not equalised: more would be seen at first sight.
LONGEST_DELAY = 3e-3
#: s, delay between the channels that a data sheet allows: more is a delay with a name.
ALLOWED_DELAY = 0.5e-3

#: Relative gain error that a data sheet allows: more is one with a name.
ALLOWED_GAIN = 0.05


@dataclass(frozen=True)
class FieldNuisance(ABC):
    """Nuisance of one or both channels. Its methods change nothing unless a class says otherwise.

    Attributes:
        id: of its kind.
        unit: of its size.
        stage: place in the chain; smaller ones come first.
        excludes: hidden effects of the sensors that it would be mistaken for: never drawn together.
        sizes: by channel, in ``unit``; only of channels that have it.
        seed: of its random numbers.
    """

    id: ClassVar[str]
    unit: ClassVar[str]
    stage: ClassVar[int]
    excludes: ClassVar[tuple[str, ...]] = ()

    sizes: Mapping[str, float]
    seed: int

    @classmethod
    @abstractmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw it."""

    @property
    def channel(self) -> str:
        """``body``, ``spool`` or ``both``."""
        return BOTH if len(self.sizes) > 1 else next(iter(self.sizes))

    @property
    def size(self) -> float:
        """The larger of both channels, by magnitude, in ``unit``."""
        return max(self.sizes.values(), key=abs)

    @property
    def may_be_named(self) -> tuple[str, ...]:
        """Names of sensor effects that say the same of the spool's channel: not wrong, and not demanded."""
        return ()

    def random(self, channel: str) -> Generator:
        """Return its random numbers for ``channel``."""
        return np.random.default_rng([self.seed, CHANNELS.index(channel)])

    def on_motion(self, channel: str, motion: Array, rate: float) -> Array:  # noqa: ARG002
        """Return the acceleration (m/s^2, ``rate`` Hz, far above the sampling) as it comes to the sampler."""
        return motion

    def instants(self, time: Array) -> Array:
        """Return when the samples of the instants ``time`` (s) are taken."""
        return time

    def on_noise(self, channel: str, noise: Array, rate: float) -> Array:  # noqa: ARG002
        """Return the rest of the sensor's white noise (m/s^2, sampled at ``rate`` Hz)."""
        return noise

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:  # noqa: ARG002
        """Return what it adds at random, m/s^2, shape of ``reading``."""
        return np.zeros(reading.size)

    def like_noise(self, channel: str, reading: Array, rate: float) -> Array:
        """Return what of it is noise to who knows everything else, m/s^2, shape of ``reading``."""
        return self.disturbance(channel, reading, rate)

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:  # noqa: ARG002
        """Return the samples (m/s^2, at ``time``, s) after it."""
        return reading

    def on_samples(self, time: Array, body: Array, spool: Array) -> tuple[Array, Array, Array]:
        """Return the record (s, m/s^2, m/s^2) as it is stored."""
        return time, body, spool


@dataclass(frozen=True)
class MainsHum(FieldNuisance):
    """The mains' frequency, which strays a little, and harmonics that fall off.

    ``frequency`` in Hz; ``harmonics`` are relative amplitudes from the fundamental on; sizes are amplitudes
    of the fundamental.
    """

    id = "hum"
    unit = "m/s^2"
    stage = 30
    frequency: float = 50.0
    harmonics: tuple[float, ...] = (1.0,)

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw amplitude, mains and harmonics."""
        share = log_between(generator, 0.005, 0.2)
        mains = float(generator.choice([50.0, 60.0]))
        fall = generator.uniform(0.0, 0.6, int(generator.integers(0, 6)))
        # Rectifiers and transformers give odd harmonics above all.
        odd = [float(one) * (1.0 if order % 2 else 0.3) for order, one in enumerate(fall, start=2)]
        return cls(
            {name: share * seen.rms[name] for name in draw_channels(generator)},
            new_seed(generator),
            frequency=mains * float(1.0 + generator.uniform(-8e-4, 8e-4)),
            harmonics=(1.0, *odd),
        )

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading with the lines."""
        generator = self.random(channel)
        # Hz; the grid's frequency wanders by some hundredths over a minute.
        turns = self.frequency * time + 0.3 * np.sin(2.0 * np.pi * (time / 80.0 + generator.random()))
        total = np.zeros(reading.size)
        for order, share in enumerate(self.harmonics, start=1):
            total += share * np.sin(2.0 * np.pi * (order * turns + generator.random()))
        return np.asarray(reading + self.sizes[channel] * total)


@dataclass(frozen=True)
class BiasDrift(FieldNuisance):
    """Bias that drifts slowly, along a line or while it warms; sizes are its change over the record.

    ``bias`` is its beginning, by channel, m/s^2; ``constant`` the time constant in records, 0 for a line.
    """

    id = "bias_drift"
    unit = "m/s^2"
    stage = 50
    bias: Mapping[str, float] | None = None
    constant: float = 0.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw bias and drift."""
        sign = float(generator.choice([-1.0, 1.0]))
        channels = draw_channels(generator)
        return cls(
            {name: sign * log_between(generator, 0.005, 0.2) * seen.rms[name] for name in channels},
            new_seed(generator),
            bias={name: float(generator.uniform(-0.2, 0.2)) * seen.rms[name] for name in channels},
            constant=float(generator.choice([0.0, generator.uniform(0.2, 0.6)])),
        )

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading with its bias."""
        beginning = (self.bias or {}).get(channel, 0.0)
        return np.asarray(reading + beginning + self.sizes[channel] * course(time, self.constant))


@dataclass(frozen=True)
class Spikes(FieldNuisance):
    """Spikes of one to three samples at random instants; sizes are their number per second.

    ``height`` is their median, by channel, m/s^2.
    """

    id = "spikes"
    unit = "1/s"
    stage = 60
    height: Mapping[str, float] | None = None

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw rate and height."""
        channels = draw_channels(generator)
        rate = log_between(generator, 0.05, 2.0)
        share = log_between(generator, 3.0, 30.0)
        return cls(
            dict.fromkeys(channels, rate),
            new_seed(generator),
            height={name: share * seen.rms[name] for name in channels},
        )

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading with spikes."""
        generator = self.random(channel)
        count = int(generator.poisson(self.sizes[channel] * (time[-1] - time[0])))
        spiked = reading.copy()
        for place in generator.integers(0, reading.size, count):
            height = (self.height or {})[channel] * float(np.exp(0.4 * generator.standard_normal()))
            spiked[place : place + int(generator.integers(1, 4))] += height * generator.choice([-1.0, 1.0])
        return spiked


@dataclass(frozen=True)
class CrossAxis(FieldNuisance):
    """Cross-axis sensitivity: vibration across the axis, which is not the motion; sizes are its rms.

    ``low`` and ``high`` in Hz are the band of the lateral vibration.
    """

    id = "cross_axis"
    unit = "m/s^2"
    stage = 10
    low: float = 10.0
    high: float = 100.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw sensitivity (1 to 5 %) and lateral vibration (0.3 to 1.5 of the body's)."""
        across = generator.uniform(0.3, 1.5) * seen.rms["body"]
        low = float(generator.uniform(0.5, 1.0) * seen.low)
        return cls(
            {name: float(generator.uniform(0.01, 0.05)) * across for name in draw_channels(generator)},
            new_seed(generator),
            low=low,
            high=float(min(generator.uniform(0.7, 2.0) * seen.high, 0.4 * seen.rate)),
        )

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the part of the lateral vibration: the same in both channels but for its size."""
        frequency = rfftfreq(reading.size, 1.0 / rate)
        inside = ((frequency >= self.low) & (frequency <= self.high)).astype(np.float64)
        return self.sizes[channel] * coloured(np.random.default_rng(self.seed), inside, reading.size)


@dataclass(frozen=True)
class ColouredNoise(FieldNuisance):
    """Coloured noise of the sensor: 1/f below a corner, or one band; sizes are its rms.

    ``low`` and ``high`` in Hz are the band; ``low`` 0: power falls as 1/f up to ``high``.
    """

    id = "coloured_noise"
    unit = "m/s^2"
    stage = 20
    low: float = 0.0
    high: float = 50.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw colour and rms."""
        share = log_between(generator, 0.003, 0.03)
        pink = generator.random() < 0.5
        low = 0.0 if pink else log_between(generator, 5.0, 0.1 * seen.rate)
        return cls(
            {name: share * seen.rms[name] for name in draw_channels(generator)},
            new_seed(generator),
            low=float(low),
            high=float(generator.uniform(100.0, 400.0) if pink else low * generator.uniform(1.5, 4.0)),
        )

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the noise."""
        frequency = rfftfreq(reading.size, 1.0 / rate)
        inside = (frequency >= self.low) & (frequency <= self.high)
        # 1/f from 0.1 Hz on: below that it is a bias.
        power = inside / np.maximum(frequency, 0.1) if self.low == 0.0 else inside.astype(np.float64)
        return self.sizes[channel] * coloured(self.random(channel), power, reading.size)


@dataclass(frozen=True)
class AcCoupling(FieldNuisance):
    """A high-pass of first order; sizes are its corners."""

    id = "ac_coupling"
    unit = "Hz"
    stage = 40

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:  # noqa: ARG003
        """Draw the corners; of both channels they are alike in half of the cases."""
        corner = log_between(generator, 0.1, 2.0)
        alike = generator.random() < 0.5
        sizes = {
            name: corner if alike else log_between(generator, 0.1, 2.0)
            for name in draw_channels(generator, (0.25, 0.25, 0.5))
        }
        return cls(sizes, new_seed(generator))

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading after the high-pass, which has settled on the first sample."""
        rate = (time.size - 1) / (time[-1] - time[0])
        turn = 2.0 * np.pi * self.sizes[channel]
        numerator, denominator = bilinear([1.0, 0.0], [1.0, turn], rate)
        return np.asarray(lfilter(numerator, denominator, reading - reading[0]))


@dataclass(frozen=True)
class AntiAlias(FieldNuisance):
    """Anti-alias filter: a low-pass of Butterworth, of Cauer (elliptic) or FIR; sizes are its corners.

    ``kind`` is butterworth, elliptic or fir; ``order`` that of the filter, taps of a FIR at the sampling rate
    ``rate`` (Hz); ``equalised``: its delay at low frequencies is taken off.
    """

    id = "anti_alias"
    unit = "Hz"
    stage = 5
    excludes = ("spool_delay",)
    kind: str = "butterworth"
    order: int = 4
    rate: float = 1000.0
    equalised: bool = False

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw kind, order, corner and whether its delay is equalised."""
        kind = str(generator.choice(["butterworth", "elliptic", "fir"]))
        corner = float(generator.uniform(0.2, 0.42)) * seen.rate
        channels = draw_channels(generator)
        equalised = bool(generator.random() < 0.5)
        order = int(generator.integers(12, 65)) if kind == "fir" else int(generator.integers(2, 9))
        if kind == "fir" and len(channels) == 1 and not equalised:
            order = min(order, int(2.0 * LONGEST_DELAY * seen.rate))
        return cls(
            dict.fromkeys(channels, corner), new_seed(generator), kind=kind, order=order, rate=seen.rate,
            equalised=equalised,
        )  # fmt: skip

    @property
    def delay(self) -> float:
        """The delay at low frequencies, s."""
        if self.kind == "fir":
            return 0.5 * (self.order - 1) / self.rate
        return slow_delay(self._sections, self.rate)

    @property
    def may_be_named(self) -> tuple[str, ...]:
        """A delay that a data sheet does not allow, where one channel's is not equalised."""
        one = len(self.sizes) == 1 and not self.equalised
        return ("spool_delay",) if one and self.delay > ALLOWED_DELAY else ()

    def on_motion(self, channel: str, motion: Array, rate: float) -> Array:  # noqa: ARG002
        """Return the filtered acceleration, set back by its delay where that is equalised."""
        filtered = self._through(motion, rate)
        ahead = self.delay * rate if self.equalised else 0.0
        places: Array = np.arange(motion.size, dtype=np.float64)
        return np.asarray(np.interp(places + ahead, places, filtered))

    def on_noise(self, channel: str, noise: Array, rate: float) -> Array:  # noqa: ARG002
        """Return the filtered noise."""
        return self._through(noise, rate)

    def _through(self, row: Array, rate: float) -> Array:
        if self.kind == "fir":
            taps = round((self.order - 1) * rate / self.rate) + 1
            passed = fftconvolve(row, firwin(taps, self._corner, fs=rate))[: row.size]
            return np.asarray(passed, dtype=np.float64)
        return np.asarray(sosfilt(self._sections(rate), row))

    @property
    def _corner(self) -> float:
        return next(iter(self.sizes.values()))

    def _sections(self, rate: float) -> Array:
        if self.kind == "elliptic":
            return np.asarray(ellip(self.order, 0.2, 60.0, self._corner, fs=rate, output="sos"))
        return np.asarray(butter(self.order, self._corner, fs=rate, output="sos"))


@dataclass(frozen=True)
class ExtraMode(FieldNuisance):
    """Extra mode of the body or a sensor's mounting in one channel; sizes are its frequency.

    ``share`` of the reading passes the mode, 1 for an elastic mounting; ``damping`` is its ratio.
    """

    id = "extra_mode"
    unit = "Hz"
    stage = 3
    share: float = 1.0
    damping: float = 0.05

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw frequency, share and damping."""
        channel = str(generator.choice(["body", SPOOL]))
        return cls(
            {channel: float(min(log_between(generator, 70.0, 350.0), 0.4 * seen.rate))},
            new_seed(generator),
            share=1.0 if generator.random() < 0.5 else log_between(generator, 0.03, 0.5),
            damping=float(generator.uniform(0.01, 0.1)),
        )

    def on_motion(self, channel: str, motion: Array, rate: float) -> Array:
        """Return the acceleration of what the sensor sits on."""
        turn = 2.0 * np.pi * self.sizes[channel]
        loss = 2.0 * self.damping * turn
        whole = [1.0, loss, turn**2]
        part = [1.0 - self.share, (1.0 - self.share) * loss, turn**2]
        numerator, denominator = bilinear(part, whole, rate)
        return np.asarray(lfilter(numerator, denominator, motion))


@dataclass(frozen=True)
class GainDrift(FieldNuisance):
    """Gain that drifts over the record, along a line or while it warms; sizes are its relative change.

    ``constant`` is the time constant in records, 0 for a line.
    """

    id = "gain_drift"
    unit = "1"
    stage = 45
    excludes = ("spool_gain_error",)
    constant: float = 0.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:  # noqa: ARG003
        """Draw channel and change."""
        change = log_between(generator, 0.003, 0.06) * float(generator.choice([-1.0, 1.0]))
        constant = float(generator.choice([0.0, generator.uniform(0.2, 0.6)]))
        return cls(
            dict.fromkeys(draw_channels(generator, (0.4, 0.5, 0.1)), change),
            new_seed(generator),
            constant=constant,
        )

    @property
    def may_be_named(self) -> tuple[str, ...]:
        """A gain error, where it leaves the tolerance."""
        return ("spool_gain_error",) if abs(self.size) > ALLOWED_GAIN else ()

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading with its gain."""
        return np.asarray(reading * (1.0 + self.sizes[channel] * course(time, self.constant)))


@dataclass(frozen=True)
class Clipping(FieldNuisance):
    """Clipping of a channel at its full scale; sizes are that."""

    id = "clipping"
    unit = "m/s^2"
    stage = 70
    excludes = ("sensor_saturation",)

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw the full scale below the peak: of each channel, or the same of both."""
        share = float(generator.uniform(0.4, 0.9))
        channels = draw_channels(generator)
        alike = generator.random() < 0.5
        least = min(seen.peak[name] for name in channels)
        return cls(
            {name: share * (least if alike else seen.peak[name]) for name in channels}, new_seed(generator)
        )

    @property
    def may_be_named(self) -> tuple[str, ...]:
        """The same thing, where it is the spool's channel."""
        return ("sensor_saturation",) if SPOOL in self.sizes else ()

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:  # noqa: ARG002
        """Return the reading within the full scale."""
        return np.asarray(np.clip(reading, -self.sizes[channel], self.sizes[channel]))


@dataclass(frozen=True)
class Quantisation(FieldNuisance):
    """Quantisation by a converter of 12 to 16 bits of a full scale; sizes are its steps."""

    id = "quantisation"
    unit = "m/s^2"
    stage = 80

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw bits and full scale, 1.2 to 20 times the larger peak, of both channels."""
        bits = int(generator.choice([12, 12, 13, 14, 16]))
        scale = log_between(generator, 1.2, 20.0) * max(seen.peak.values())
        return cls(dict.fromkeys(CHANNELS, 2.0 * scale / 2**bits), new_seed(generator))

    def like_noise(self, channel: str, reading: Array, rate: float) -> Array:  # noqa: ARG002
        """Return the error of rounding: even within a step."""
        return np.asarray(self.sizes[channel] * self.random(channel).uniform(-0.5, 0.5, reading.size))

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:  # noqa: ARG002
        """Return the reading in whole steps."""
        step = self.sizes[channel]
        return np.asarray(step * np.round(reading / step))


@dataclass(frozen=True)
class Jitter(FieldNuisance):
    """Jitter of the sampling instants of both channels; sizes are its rms. The times stored are even."""

    id = "jitter"
    unit = "s"
    stage = 0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw its rms, 1 to 30 % of a period and no more than 0.3 ms."""
        rms = min(log_between(generator, 0.01, 0.3) / seen.rate, 3e-4)
        return cls(dict.fromkeys(CHANNELS, rms), new_seed(generator))

    def like_noise(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the slope times the scatter."""
        scatter = self.sizes[channel] * np.random.default_rng(self.seed).standard_normal(reading.size)
        return np.asarray(np.gradient(reading) * rate * scatter)

    def instants(self, time: Array) -> Array:
        """Return the instants, normally scattered."""
        return np.asarray(time + self.size * np.random.default_rng(self.seed).standard_normal(time.size))


@dataclass(frozen=True)
class LostSamples(FieldNuisance):
    """Runs that are missing, as rows left out or, of one channel, as empty cells (NaN).

    Sizes are the share lost; ``lengths`` in s; ``rows``: whole rows are left out.
    """

    id = "missing_samples"
    unit = "1"
    stage = 90
    lengths: tuple[float, ...] = ()
    rows: bool = True

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw number and length of the runs, from one sample to half a second."""
        count = int(generator.integers(1, 5))
        lengths = tuple(log_between(generator, 1.0 / seen.rate, 0.5) for _ in range(count))
        rows = bool(generator.random() < 0.6)
        channels = CHANNELS if rows else (str(generator.choice(list(CHANNELS))),)
        share = sum(lengths) / seen.duration
        return cls(dict.fromkeys(channels, share), new_seed(generator), lengths=lengths, rows=rows)

    def on_samples(self, time: Array, body: Array, spool: Array) -> tuple[Array, Array, Array]:
        """Return the record without them; its first and last sample are there."""
        generator = np.random.default_rng(self.seed)
        kept = np.ones(time.size, dtype=bool)
        period = (time[-1] - time[0]) / (time.size - 1)
        for length in self.lengths:
            count = max(1, round(length / period))
            first = int(generator.integers(1, time.size - count - 1))
            kept[first : first + count] = False
        if self.rows:
            return time[kept], body[kept], spool[kept]
        return (
            time,
            np.where(kept | ("body" not in self.sizes), body, np.nan),
            np.where(kept | ("spool" not in self.sizes), spool, np.nan),
        )


@dataclass(frozen=True, slots=True)
class Seen:
    """What a nuisance's size is drawn in terms of.

    Attributes:
        rms, peak: of each channel's acceleration, m/s^2.
        rate: samples per second, Hz.
        duration: s.
        low, high: Hz, band of the excitation.
    """

    rms: Mapping[str, float]
    peak: Mapping[str, float]
    rate: float
    duration: float
    low: float
    high: float


def draw_channels(
    generator: Generator, shares: tuple[float, float, float] = (0.3, 0.4, 0.3)
) -> tuple[str, ...]:
    """Draw the channels that have it: the body's, the spool's or both, with these chances."""
    found = str(generator.choice([BODY, SPOOL, BOTH], p=shares))
    return CHANNELS if found == BOTH else (found,)


def slow_delay(sections: Callable[[float], Array], rate: float) -> float:
    """Return the delay (s) far below ``rate`` (Hz) of a filter that ``sections`` designs for a rate."""
    low, dense = 0.002 * rate, 40.0 * rate
    _, response = sosfreqz(sections(dense), [low], fs=dense)
    return float(-np.angle(response[0]) / (2.0 * np.pi * low))


def log_between(generator: Generator, low: float, high: float) -> float:
    """Draw from ``low`` to ``high``, evenly in the logarithm."""
    return float(np.exp(generator.uniform(np.log(low), np.log(high))))


def new_seed(generator: Generator) -> int:
    """Draw a seed for a nuisance's own random numbers."""
    return int(generator.integers(2**31))


def coloured(generator: Generator, power: Array, size: int) -> Array:
    """Return normal noise of rms 1, shape (size,), whose power has the shape ``power`` (size // 2 + 1,)."""
    lines = generator.standard_normal((2, power.size))
    row = irfft(np.sqrt(power) * (lines[0] + 1j * lines[1]), size)
    return np.asarray(row / row.std())


def course(time: Array, constant: float) -> Array:
    """Return a change from 0 to 1 over the record: linear, or towards 1 with ``constant`` records."""
    share = (time - time[0]) / (time[-1] - time[0])
    if constant <= 0.0:
        return np.asarray(share)
    return np.asarray((1.0 - np.exp(-share / constant)) / (1.0 - np.exp(-1.0 / constant)))


NUISANCES: dict[str, type[FieldNuisance]] = {
    kind.id: kind
    for kind in (
        MainsHum, BiasDrift, AcCoupling, AntiAlias, CrossAxis, GainDrift, Spikes, LostSamples, Quantisation,
        Jitter, Clipping, ColouredNoise, ExtraMode,
    )
}  # fmt: skip
#: Share of the records that carry nuisances, and how many at most.
SHARE, MOST = 2.0 / 3.0, 3


def names_by(generator: Generator, hidden: Sequence[str]) -> tuple[str, ...]:
    """Draw the names of a record's nuisances: none, or one to three that ``hidden`` is not mistaken for."""
    carries = generator.random() < SHARE
    count = int(generator.integers(1, MOST + 1))
    possible = [name for name, kind in NUISANCES.items() if not set(kind.excludes) & set(hidden)]
    chosen = generator.choice(possible, count, replace=False)
    return tuple(str(name) for name in chosen) if carries else ()


def draw_nuisances(
    generator: Generator,
    names: Sequence[str],
    seen: Seen,
    kinds: Mapping[str, type[FieldNuisance]] = NUISANCES,
) -> tuple[FieldNuisance, ...]:
    """Draw each of ``names`` among ``kinds``; in the order of the measuring chain.

    Raises:
        KeyError: there is no such nuisance.
    """
    drawn = [kinds[name].draw(generator, seen) for name in names]
    return tuple(sorted(drawn, key=lambda one: one.stage))
