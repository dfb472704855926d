"""Measuring channels: what sensors and data channels make of the accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, lfilter_zi

from .plant import SpoolMotion

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Channels:
    """Channel errors of body and spool; the body's is the reference, so gain and delay are the spool's.

    Attributes:
        gain: reading of the spool's sensor over the truth.
        delay: of the spool's reading behind the body's, s; negative is ahead.
        full_scale: of the spool's sensor, m/s^2; 0 for none.
        noise: rms of white noise on either channel, m/s^2.
        low_pass: corner of a second-order low-pass in the spool's sensor, Hz; 0 for none.
        jitter: rms of the spool's sampling instants, s.
        mount_frequency, mount_damping: resonance of the spool sensor's mounting, Hz; 0 for none.
    """

    gain: float = 1.0
    delay: float = 0.0
    full_scale: float = 0.0
    noise: float = 0.0
    low_pass: float = 0.0
    jitter: float = 0.0
    mount_frequency: float = 0.0
    mount_damping: float = 0.05

    def read(self, motion: SpoolMotion, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
        """Return the readings (body, spool), m/s^2, at the instants ``t`` (s, shape (n,))."""
        sensed = motion.spool
        rate = 1.0 / motion.step
        if self.low_pass > 0.0:
            numerator, denominator = butter(2, self.low_pass, fs=rate)
            sensed, _ = lfilter(
                numerator, denominator, sensed, zi=sensed[0] * lfilter_zi(numerator, denominator)
            )
        if self.mount_frequency > 0.0:
            sensed = self._mounted(sensed, rate)
        when = t - self.delay
        if self.jitter > 0.0:
            when = when + self.jitter * generator.standard_normal(t.size)
        body = np.interp(t, motion.time, motion.body)
        spool = self.gain * np.interp(when, motion.time, sensed)
        body += self.noise * generator.standard_normal(t.size)
        spool += self.noise * generator.standard_normal(t.size)
        if self.full_scale > 0.0:
            spool = np.clip(spool, -self.full_scale, self.full_scale)
        return body, spool

    def _mounted(self, sensed: Array, rate: float) -> Array:
        """Return what a sensor on an elastic mounting feels: one mass on spring and damper."""
        turn = 2.0 * np.pi * self.mount_frequency / rate
        radius = np.exp(-self.mount_damping * turn)
        denominator = [1.0, -2.0 * radius * np.cos(turn * np.sqrt(1.0 - self.mount_damping**2)), radius**2]
        return np.asarray(lfilter([sum(denominator)], denominator, sensed))
