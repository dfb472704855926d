"""Nuisances of amplifier, converter and logger: gain drift, clipping, quantisation, jitter, lost samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .added import course
from .nuisance import (
    CHANNELS,
    SPOOL,
    FieldNuisance,
    Generator,
    Seen,
    draw_channels,
    log_between,
    new_seed,
)

Array = NDArray[np.float64]

#: Relative gain error that a data sheet allows: more is one with a name.
ALLOWED_GAIN = 0.05


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
    """Lost samples: runs that are missing, as rows left out or, of one channel, as empty cells (NaN).

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
