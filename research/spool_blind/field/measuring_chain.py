"""Measuring chain of a field case: both channels from the motion to what is stored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spool_blind.simulator.plant import SpoolMotion

from .nuisances.nuisance import BODY, CHANNELS, SPOOL, FieldNuisance

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MeasuringChain:
    """Measuring chain: gain, delay and range of the spool's channel, noise of both, and nuisances.

    Attributes:
        gain, delay, full_scale: of the spool's channel over the body's, 1, s and m/s^2 (0: none).
        noise: rms of white noise by channel, m/s^2.
        nuisances: in the order of the chain.
        seed: of the noise.
    """

    gain: float
    delay: float
    full_scale: float
    noise: Mapping[str, float]
    nuisances: tuple[FieldNuisance, ...]
    seed: int

    def quiet(self, channel: str, motion: SpoolMotion, time: Array) -> Array:
        """Return the reading (m/s^2) at ``time`` (s) without noise and nuisances."""
        return self._sampled(channel, motion.spool if channel == SPOOL else motion.body, motion, time)

    def record(self, motion: SpoolMotion, time: Array) -> tuple[Array, Array, Array]:
        """Return the record as it is stored: time (s), body and spool (m/s^2)."""
        body, spool = (self._reading(channel, motion, time) for channel in CHANNELS)
        for one in self.nuisances:
            time, body, spool = one.on_samples(time, body, spool)
        return time, body, spool

    def noise_of(self, channel: str, quiet: Array, rate: float) -> Array:
        """Return all noise of a channel whose reading is ``quiet`` (m/s^2, ``rate`` Hz)."""
        total = self._white(channel, quiet.size, rate)
        for one in self._of(channel):
            total = total + one.like_noise(channel, quiet, rate)
        return total

    def _of(self, channel: str) -> list[FieldNuisance]:
        return [one for one in self.nuisances if channel in one.sizes]

    def _white(self, channel: str, size: int, rate: float) -> Array:
        noise = np.random.default_rng([self.seed, CHANNELS.index(channel)]).standard_normal(size)
        noise *= self.noise[channel]
        for one in self._of(channel):
            noise = one.on_noise(channel, noise, rate)
        return noise

    def _sampled(self, channel: str, signal: Array, motion: SpoolMotion, instants: Array) -> Array:
        if channel == BODY:
            return np.interp(instants, motion.time, signal)
        row = self.gain * np.interp(instants - self.delay, motion.time, signal)
        return np.clip(row, -self.full_scale, self.full_scale) if self.full_scale > 0.0 else row

    def _reading(self, channel: str, motion: SpoolMotion, time: Array) -> Array:
        own = self._of(channel)
        signal = motion.spool if channel == SPOOL else motion.body
        instants = time
        for one in own:
            signal = one.on_motion(channel, signal, 1.0 / motion.step)
            instants = one.instants(instants)
        row = self._sampled(channel, signal, motion, instants)
        rate = (time.size - 1) / (time[-1] - time[0])
        row = row + self._white(channel, row.size, rate)
        for one in own:
            row = one.on_reading(channel, row + one.disturbance(channel, row, rate), time)
        return (
            np.clip(row, -self.full_scale, self.full_scale) if channel == SPOOL and self.full_scale else row
        )
