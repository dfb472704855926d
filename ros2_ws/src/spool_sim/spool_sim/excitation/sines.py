"""Excitations made of one sine: steady, stepped, swept; and none at all."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from spool_sim.files.validation import NotNegative, Number, Positive

from .base import Array, Excitation, turns_to_sine


class Standstill(Excitation):
    """Standstill of the body."""

    kind: Literal["standstill"] = "standstill"

    @property
    def highest_frequency(self) -> float:
        """0 Hz."""
        return 0.0

    def _steady(self, t: Array) -> Array:
        return np.zeros(t.shape)


class SteadySine(Excitation):
    """Steady sine.

    Attributes:
        frequency: Hz.
        amplitude: peak, m/s^2.
        phase: rad at t = 0.
    """

    kind: Literal["steady_sine"] = "steady_sine"
    frequency: Positive
    amplitude: NotNegative
    phase: Number = 0.0
    soft_start: NotNegative = 0.2

    @property
    def highest_frequency(self) -> float:
        """The sine's frequency, Hz."""
        return self.frequency

    def _steady(self, t: Array) -> Array:
        return self.amplitude * turns_to_sine(self.frequency * t + self.phase / (2.0 * math.pi))


class SteppedSine(Excitation):
    """Stepped sine: it dwells on one frequency after the other, then starts over; the phase never jumps.

    Either ``frequencies``, or ``start_frequency``, ``stop_frequency`` and ``frequency_step``.

    Attributes:
        frequencies: Hz, in the order of the steps.
        start_frequency, stop_frequency, frequency_step: Hz, the same list as a range.
        dwell: s on each frequency.
        amplitude: peak, m/s^2.
    """

    kind: Literal["stepped_sine"] = "stepped_sine"
    frequencies: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=10_000)] | None = None
    start_frequency: Positive | None = None
    stop_frequency: Positive | None = None
    frequency_step: Positive | None = None
    dwell: Positive
    amplitude: NotNegative
    soft_start: NotNegative = 0.2

    @model_validator(mode="after")
    def _one_list(self) -> SteppedSine:
        ends = (self.start_frequency, self.stop_frequency, self.frequency_step)
        if (self.frequencies is None) == any(end is None for end in ends):
            raise ValueError(
                "give either frequencies, or all of start_frequency, stop_frequency, frequency_step"
            )
        if self.frequencies is not None and any(end is not None for end in ends):
            raise ValueError("give frequencies or a range, not both")
        if self.steps.size > 10_000:
            raise ValueError("more than 10000 steps, raise frequency_step")
        return self

    @property
    def steps(self) -> Array:
        """Frequencies of the steps, Hz, shape (steps,)."""
        if self.frequencies is not None:
            return np.array(self.frequencies)
        if self.start_frequency is None or self.stop_frequency is None or self.frequency_step is None:
            return np.empty(0)
        distance = self.stop_frequency - self.start_frequency
        count = 1 + math.floor(abs(distance) / self.frequency_step + 1e-9)
        step = math.copysign(self.frequency_step, distance)
        return np.asarray(self.start_frequency + step * np.arange(count), dtype=np.float64)

    @property
    def highest_frequency(self) -> float:
        """Highest frequency of the list, Hz."""
        return float(self.steps.max())

    def _steady(self, t: Array) -> Array:
        steps = self.steps
        turns_before = np.concatenate(([0.0], np.cumsum(steps * self.dwell)))
        cycle_time = steps.size * self.dwell
        cycle = np.floor(t / cycle_time)
        local = t - cycle * cycle_time
        index = np.minimum((local / self.dwell).astype(np.int64), steps.size - 1)
        turns = cycle * turns_before[-1] + turns_before[index] + steps[index] * (local - index * self.dwell)
        return self.amplitude * turns_to_sine(turns)


class SweptSine(Excitation):
    """Swept sine: its frequency runs between two values, again and again; the phase never jumps.

    Attributes:
        start_frequency, stop_frequency: Hz.
        duration: s for one run from start to stop.
        amplitude: peak, m/s^2.
        scale: "linear" (same time per Hz) or "logarithmic" (same time per octave).
        repeat: "up_down" runs back the same way, "restart" begins anew, "hold" stays at the stop frequency.
    """

    kind: Literal["swept_sine"] = "swept_sine"
    start_frequency: Positive
    stop_frequency: Positive
    duration: Positive
    amplitude: NotNegative
    scale: Literal["linear", "logarithmic"] = "linear"
    repeat: Literal["up_down", "restart", "hold"] = "up_down"
    soft_start: NotNegative = 0.2

    @property
    def highest_frequency(self) -> float:
        """The higher end of the sweep, Hz."""
        return max(self.start_frequency, self.stop_frequency)

    def _turns(self, local: Array) -> Array:
        """Return the turns made ``local`` seconds after the start of a run."""
        if self.scale == "linear" or self.start_frequency == self.stop_frequency:
            slope = (self.stop_frequency - self.start_frequency) / self.duration
            return local * (self.start_frequency + 0.5 * slope * local)
        growth = math.log(self.stop_frequency / self.start_frequency) / self.duration
        return np.asarray(self.start_frequency / growth * np.expm1(growth * local))

    def _steady(self, t: Array) -> Array:
        total = float(self._turns(np.array(self.duration)))
        if self.repeat == "hold":
            inside = np.clip(t, 0.0, self.duration)
            beyond = t - inside
            ends = np.where(beyond > 0.0, self.stop_frequency, self.start_frequency)
            return self.amplitude * turns_to_sine(self._turns(inside) + ends * beyond)
        run = np.floor(t / self.duration)
        local = t - run * self.duration
        if self.repeat == "restart":
            turns = run * total + self._turns(local)
        else:
            back = np.mod(run, 2.0) == 1.0
            turns = (run + back) * total + np.where(back, -1.0, 1.0) * self._turns(
                np.where(back, self.duration - local, local)
            )
        return self.amplitude * turns_to_sine(turns)
