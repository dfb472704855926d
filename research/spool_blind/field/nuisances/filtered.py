"""Nuisances that filter a reading: AC coupling, anti-alias filters, an extra mode of body or mounting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, butter, ellip, fftconvolve, firwin, lfilter, sosfilt, sosfreqz

from .nuisance import SPOOL, FieldNuisance, Generator, Seen, draw_channels, log_between, new_seed

Array = NDArray[np.float64]

#: s, delay of a filter in one channel at most that is not equalised: more would be seen at first sight.
LONGEST_DELAY = 3e-3
#: s, delay between the channels that a data sheet allows: more is a delay with a name.
ALLOWED_DELAY = 0.5e-3


@dataclass(frozen=True)
class AcCoupling(FieldNuisance):
    """AC coupling: a high-pass of first order; sizes are its corners."""

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
        low = 0.002 * self.rate
        _, response = sosfreqz(self._sections(40.0 * self.rate), [low], fs=40.0 * self.rate)
        return float(-np.angle(response[0]) / (2.0 * np.pi * low))

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
