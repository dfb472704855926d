"""Excitations made of many sines: multisine, and the orders of a machine with broadband."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from spool_sim.files.validation import NotNegative, Number, Positive

from .base import Array, Excitation, sum_of_lines, turns_to_sine


class Multisine(Excitation):
    """Multisine: lines of equal amplitude on whole multiples of 1 / period; repeats exactly after ``period``.

    Attributes:
        low_frequency, high_frequency: band, Hz.
        lines: how many, spread evenly over the band (fewer where the band holds fewer).
        rms: of the whole, m/s^2.
        period: s.
        seed: of the phases; the best of some draws and Schroeder's phases is kept (lowest crest factor).
    """

    kind: Literal["multisine"] = "multisine"
    low_frequency: Positive
    high_frequency: Positive
    lines: Annotated[int, Field(ge=1, le=1000)] = 60
    rms: NotNegative
    period: Positive = 10.0
    seed: Annotated[int, Field(ge=0)] = 0
    soft_start: NotNegative = 0.2

    @model_validator(mode="after")
    def _band(self) -> Multisine:
        if self.high_frequency < self.low_frequency:
            raise ValueError("high_frequency is below low_frequency")
        if self.frequencies.size == 0:
            raise ValueError("no multiple of 1 / period lies in the band; make period longer")
        return self

    @property
    def frequencies(self) -> Array:
        """Frequencies of the lines, Hz, shape (lines,)."""
        first = int(np.ceil(self.low_frequency * self.period - 1e-9))
        last = int(np.floor(self.high_frequency * self.period + 1e-9))
        if last < max(first, 1):
            return np.empty(0)
        numbers = np.unique(np.rint(np.linspace(max(first, 1), last, self.lines)))
        return np.asarray(numbers / self.period, dtype=np.float64)

    @property
    def highest_frequency(self) -> float:
        """Upper end of the band, Hz."""
        return self.high_frequency

    def _steady(self, t: Array) -> Array:
        frequencies = self.frequencies
        amplitudes = np.full(frequencies.size, self.rms * np.sqrt(2.0 / frequencies.size))
        phases = _low_crest_phases(tuple(frequencies.tolist()), self.period, self.seed)
        return sum_of_lines(t, frequencies, amplitudes, np.array(phases, dtype=np.float64))


class MachineOrders(Excitation):
    """Orders of a machine: harmonics of a shaft whose speed changes, on top of stationary broadband.

    Attributes:
        speed_profile: points (time s, shaft speed rpm), linear in between, held before and after.
        orders: points (order, peak amplitude m/s^2); order 2 turns twice per revolution.
        broadband_rms: m/s^2.
        broadband_low, broadband_high: band, Hz.
        broadband_lines: sines with drawn frequencies and phases that make the broadband.
        seed: of the broadband and of the orders' phases.
    """

    kind: Literal["machine_orders"] = "machine_orders"
    speed_profile: Annotated[tuple[tuple[Number, NotNegative], ...], Field(min_length=1, max_length=10_000)]
    orders: Annotated[tuple[tuple[Positive, NotNegative], ...], Field(max_length=200)]
    broadband_rms: NotNegative = 0.0
    broadband_low: Positive = 8.0
    broadband_high: Positive = 120.0
    broadband_lines: Annotated[int, Field(ge=1, le=1000)] = 120
    seed: Annotated[int, Field(ge=0)] = 0
    soft_start: NotNegative = 0.2

    @model_validator(mode="after")
    def _in_order(self) -> MachineOrders:
        times = [time for time, _ in self.speed_profile]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("times of speed_profile must rise from point to point")
        if self.broadband_high < self.broadband_low:
            raise ValueError("broadband_high is below broadband_low")
        return self

    @property
    def highest_frequency(self) -> float:
        """Highest order at the highest speed, or the upper end of the broadband, Hz."""
        fastest = max(speed for _, speed in self.speed_profile) / 60.0
        orders = max((order for order, amplitude in self.orders if amplitude > 0.0), default=0.0) * fastest
        return max(orders, self.broadband_high if self.broadband_rms > 0.0 else 0.0)

    def revolutions(self, t: Array) -> Array:
        """Return the shaft's revolutions since t = 0: the exact integral of the speed."""
        return self._integral(t) - self._integral(np.zeros(1))

    def _integral(self, t: Array) -> Array:
        times = np.array([time for time, _ in self.speed_profile])
        speeds = np.array([speed for _, speed in self.speed_profile]) / 60.0
        whole = np.concatenate(([0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times))))
        slopes = np.concatenate((np.diff(speeds) / np.diff(times), [0.0]))
        index = np.clip(np.searchsorted(times, t, side="right") - 1, 0, times.size - 1)
        local = t - times[index]
        before = local < 0.0
        return np.asarray(
            whole[index] + local * (speeds[index] + 0.5 * np.where(before, 0.0, slopes[index]) * local)
        )

    def _steady(self, t: Array) -> Array:
        generator = np.random.default_rng(self.seed)
        order_phases = generator.random(len(self.orders))
        revolutions = self.revolutions(t)
        total = np.zeros(t.shape)
        for (order, amplitude), phase in zip(self.orders, order_phases, strict=True):
            total += amplitude * turns_to_sine(order * revolutions + phase)
        if self.broadband_rms > 0.0:
            # One line per stretch of the band, placed at random in it: no common period for hours.
            count = self.broadband_lines
            places = (np.arange(count) + generator.random(count)) / count
            band = self.broadband_high - self.broadband_low
            frequencies = np.asarray(self.broadband_low + band * places, dtype=np.float64)
            amplitudes = np.full(count, self.broadband_rms * np.sqrt(2.0 / count))
            total += sum_of_lines(t, frequencies, amplitudes, generator.random(count))
        return total


@lru_cache(maxsize=64)
def _low_crest_phases(frequencies: tuple[float, ...], period: float, seed: int) -> tuple[float, ...]:
    """Return phases (turns) of a low crest factor: from Schroeder's and drawn ones, by clipping peaks."""
    count = len(frequencies)
    number = np.rint(np.array(frequencies) * period).astype(np.int64)
    samples = int(2 ** np.ceil(np.log2(8 * number[-1])))
    generator = np.random.default_rng(seed)
    line = np.arange(count)
    best_peak = np.inf
    best: Array = np.zeros(count)
    for start in (generator.random() - line * (line + 1) / (2.0 * count), generator.random(count)):
        phases: Array = np.asarray(start, dtype=np.float64)
        for _ in range(40):
            spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
            spectrum[number] = np.exp(2j * np.pi * (phases - 0.25))
            signal = np.fft.irfft(spectrum)
            peak = float(np.abs(signal).max())
            if peak < best_peak:
                best_peak, best = peak, phases
            clipped = np.fft.rfft(np.clip(signal, -0.8 * peak, 0.8 * peak))
            turns = np.angle(clipped[number]) / (2.0 * np.pi)
            phases = np.asarray(turns + 0.25, dtype=np.float64)
    return tuple(np.mod(best, 1.0).tolist())
